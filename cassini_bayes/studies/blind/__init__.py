"""The blind campaign: effects hidden in simulated telemetry, to be named."""
