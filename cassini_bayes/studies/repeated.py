"""What a study repeats: its inputs, settings and random streams; nothing of judgement or pages.

Finished repetitions depend on this and on what a repetition imports, so no page makes them stale.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from cassini_bayes.files.code import PACKAGE, identity


@dataclass(frozen=True)
class Repeated(ABC):
    """What is repeated: one variant, control or reading of a study; sent to the workers.

    Fields that are paths name the files a repetition reads, all others are its settings; the module
    of the class is the one whose code, with all that it imports, it runs through.
    """

    seed: int = field(kw_only=True)
    per_file: ClassVar[int] = 5
    """Repetitions that one file keeps: a minute's work or so."""

    def inputs(self) -> Sequence[Path]:
        """Files that a repetition reads."""
        values = (getattr(self, own.name) for own in fields(self))
        return [value for value in values if isinstance(value, Path)]

    def identity(self) -> str:
        """Hash of all that a repetition depends on: :func:`cassini_bayes.files.code.identity`."""
        own = {name: value for name, value in asdict(self).items() if not isinstance(value, Path)}
        modules = (kind.__module__ for kind in type(self).__mro__)
        code = next(name for name in modules if name.startswith(PACKAGE))
        settings = [type(self).__name__, own]
        return identity(settings, self.inputs(), code.removeprefix(f"{PACKAGE}."))

    def stream(self, *labels: int) -> np.random.Generator:
        """All that is random in a repetition: it depends on the seed and the labels alone."""
        return np.random.default_rng((self.seed, *labels))

    @abstractmethod
    def repetition(self, index: int) -> Mapping[str, NDArray[Any] | float | bool]:
        """One repetition, its random stream given by its number: arrays by name."""
