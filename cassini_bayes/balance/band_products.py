"""Inner products of columns in every band of a telemetry event, of those columns that are wanted.

Of all that a catalogue may need they take a hundred megabytes an event, and a model needs few of
them. So they are made of the columns' coordinates on the bands' modes when a model asks.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from cassini_bayes.computing.arrays import Array, Places


@dataclass(frozen=True)
class BandProducts:
    """Inner products (3, 3, A, A) of A columns about three axes, band by band.

    First come bands with modes; then, where ``whole`` is given, what it has beyond all modes, those
    of no band included; then ``others`` as they are.
    """

    slower: Array  # (3, A, m) coordinates on modes of no band
    modes: tuple[Array, ...]  # (3, A, m) of every band
    whole: Array | None  # (3, 3, A, A)
    others: tuple[Array, ...] = ()  # (3, 3, A, A) each

    def of(self, columns: Places) -> Array:
        """Those (T, 3, 3, B, B) of some B columns, in their order."""
        count, both = len(columns), (columns[:, None], columns)
        grams = [_gram_of(own[:, columns]) for own in self.modes]
        if self.whole is not None:
            rest = self.whole[..., *both] - _gram_of(self.slower[:, columns])
            for gram in grams:
                rest -= gram
            grams.append(rest)
        grams += [other[..., *both] for other in self.others]
        return np.array(grams).reshape(len(grams), 3, 3, count, count)

    def as_one(self) -> BandProducts:
        """The same with all bands but the others as one."""
        if self.whole is not None:
            return replace(self, modes=())
        return replace(self, modes=(np.concatenate(self.modes, axis=-1),))


def _gram_of(modes: Array) -> Array:
    """Inner products (3, 3, B, B) of columns that have coordinates (3, B, m) on modes."""
    return np.asarray(modes[:, None] @ modes.transpose(0, 2, 1)[None])
