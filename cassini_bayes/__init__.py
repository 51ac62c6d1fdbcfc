"""Bayesian posteriors of spacecraft thrust and inertia from attitude telemetry, with emcee."""

__version__ = "0.1.0"
