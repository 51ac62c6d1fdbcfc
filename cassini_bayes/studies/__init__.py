"""Campaigns that put the package to the test, and the pages of their results."""
