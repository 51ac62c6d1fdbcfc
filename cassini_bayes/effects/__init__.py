"""Causes beyond the standard physics: what each changes, its columns, the prior of its size."""
