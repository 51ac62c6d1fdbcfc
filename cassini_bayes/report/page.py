"""What the page of a run is made of: chapters, their sections, and the blocks of a section."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING, ClassVar

import pandas as pd

from cassini_bayes.report.cells import Table
from cassini_bayes.report.plots.quantities import interval, plus_minus

if TYPE_CHECKING:
    from cassini_bayes.report.plots import Figure


class Chapter(Enum):
    """Headings of the page in its order, each with its address."""

    OBSERVABILITY = ("seen", "What these events can see")
    INERTIA = ("inertia", "Inertia")
    THRUSTS = ("thrusts", "Thrust of every thruster in every bias")
    NUMBERS = ("numbers", "Bias by bias")
    JOINT = ("joint", "What trades against what")
    PRIORS = ("priors", "Had the priors been wider or narrower")
    NUISANCES = ("nuisances", "Nuisances: prior against posterior")
    BUDGET = ("budget", "Error budget")
    CHECKS = ("checks", "Model against measurement")
    DELTA_V = ("delta-v", "ΔV")
    CONVERGENCE = ("convergence", "Convergence")

    def __init__(self, anchor: str, title: str) -> None:
        self.anchor, self.title = anchor, title


@dataclass(frozen=True)
class Paragraph:
    """A paragraph; markup in it is that of a ``Markup``, anything else is escaped."""

    kind: ClassVar[str] = "paragraph"
    text: str


@dataclass(frozen=True)
class Bullets:
    """Sentences one under another."""

    kind: ClassVar[str] = "bullets"
    items: tuple[str, ...]


@dataclass(frozen=True)
class TableBlock:
    """A table; with ``fold`` it is behind that line until asked for, unless it is ``open``."""

    kind: ClassVar[str] = "shown"
    table: Table
    style: str = ""
    fold: str = ""
    open: bool = False


@dataclass(frozen=True)
class Drawing:
    """A figure, drawn when asked for; nothing where there is nothing to draw.

    With ``fold`` it is behind that line until asked for.
    """

    kind: ClassVar[str] = "drawing"
    name: str
    alt: str
    caption: str
    draw: Callable[[], Figure | None]
    portrait: bool = False
    fold: str = ""


@dataclass(frozen=True)
class Card:
    """What is known of one item: its table, what is said of it, and the same in a line."""

    title: str
    line: str
    table: Table
    said: str = ""


@dataclass(frozen=True)
class Cards:
    """Cards beside one another, folded."""

    kind: ClassVar[str] = "cards"
    items: tuple[Card, ...]


@dataclass(frozen=True)
class SliderRow:
    """A quantity under one prior: its texts, and its bar in percent of the axis."""

    value: str
    interval: str
    left: float
    width: float

    @classmethod
    def of(
        cls, mean: float, sd: float, ends: tuple[float, float], axis: tuple[float, float]
    ) -> SliderRow:
        """A mean with its interval on an axis between two values."""
        low, high = axis
        left, right = (round(100.0 * (end - low) / (high - low), 1) for end in ends)
        return cls(plus_minus(mean, sd), interval(*ends), left, round(right - left, 1))


@dataclass(frozen=True)
class SliderPrior:
    """A prior at every width: what is said of it, and its rows (none where not trusted)."""

    name: str
    notes: tuple[str, ...]
    trusted: tuple[bool, ...]
    rows: tuple[tuple[SliderRow | None, ...], ...]


@dataclass(frozen=True)
class Slider:
    """Quantities that move with the width of a prior; ``start`` is the width as fitted.

    ``shown`` says what a quantity's value is, ``numbers`` where they all are.
    """

    kind: ClassVar[str] = "slider"
    quantities: tuple[str, ...]
    units: tuple[str, ...]
    widths: tuple[str, ...]
    start: int
    priors: tuple[SliderPrior, ...]
    shown: str = "mean ± sd"
    numbers: str = "tables/prior_widths.csv"

    @property
    def data(self) -> dict[str, object]:
        """What the page's script needs, as plain lists."""
        return {
            "widths": self.widths,
            "start": self.start,
            "priors": [
                {
                    "notes": prior.notes,
                    "rows": [
                        [(row.value, row.interval, row.left, row.width) for row in rows if row]
                        for rows in prior.rows
                    ],
                }
                for prior in self.priors
            ],
        }


Block = Paragraph | Bullets | TableBlock | Drawing | Cards | Slider


@dataclass(frozen=True)
class Section:
    """One table of a run: its file, and what the page says and draws of it.

    ``frame`` is written as ``tables/<name>.csv``; a section without one has nothing to keep.
    """

    chapter: Chapter
    blocks: tuple[Block, ...]
    title: str = ""
    name: str = ""
    frame: pd.DataFrame | None = None

    @property
    def drawings(self) -> Iterator[Drawing]:
        """Its figures."""
        return (block for block in self.blocks if isinstance(block, Drawing))
