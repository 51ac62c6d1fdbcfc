"""Parts of ``telemetry_speed.py``: the problem, own times, other samplers, the page."""
