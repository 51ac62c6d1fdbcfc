"""Cores, compiled code and heavy imports: how this package uses the machine."""
