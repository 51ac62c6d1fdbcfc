"""Parts of ``basilisk_closed_loop.py``: an independent flight, and what a diagnosis says of it.

Nothing here imports the package: geometry, valves, controllers and telemetry are written anew from
the description of the formats, the equations of motion are Basilisk's.
"""
