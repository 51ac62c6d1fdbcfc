"""Files in and out: atomic writes, checkpoints, CSV cells, digests, checks at the door."""
