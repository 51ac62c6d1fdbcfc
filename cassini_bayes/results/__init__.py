"""The frozen record of a fit, and its tables."""
