"""What a simulation gets wrong: symptoms, named causes, extended models, the gain."""
