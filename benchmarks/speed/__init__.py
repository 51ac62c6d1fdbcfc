"""Parts of ``telemetry_speed.py``: the problem, the plain likelihood, other samplers, the page."""
