"""A mission's posterior: its draws, what they say of thrusts and health, its record in files."""
