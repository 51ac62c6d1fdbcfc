"""Types of arrays, cores, compiled code and heavy imports: how this package computes."""
