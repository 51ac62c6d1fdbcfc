"""Modes, importance draws and emcee ensembles of a log density."""
