"""A mission's posterior: its draws, thrusts and health from them, its record in files."""
