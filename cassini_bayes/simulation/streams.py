"""Random streams by label: one seed, and a child of its own for every use.

A stream depends on the seed and its labels only, so that an effect, another channel or another
event never changes what a stream draws.
"""

from __future__ import annotations

import zlib

import numpy as np
from numpy.random import Generator


def stream(seed: int, *labels: str) -> Generator:
    """The generator of a use, e.g. ``stream(seed, event.id, "rate noise")``."""
    key = [zlib.crc32(label.encode()) for label in labels]
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))
