"""Parts of a blind campaign: how many trials each has, what it hides, and how large."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Final


@dataclass(frozen=True)
class Stratum:
    """A part of a campaign: its trials in a full one, sizes in σ, and the kind of effect.

    Without ``sigmas`` sizes follow from the part itself, without ``kind`` any effect may be hidden.
    """

    name: str
    trials: int
    sigmas: tuple[float, float] | None = None
    kind: str | None = None


STRATA: Final = (
    Stratum("prior", 150),
    Stratum("null", 100),
    Stratum("clear", 80, (5.0, 10.0)),
    Stratum("faint", 60, (2.0, 3.0)),
    Stratum("uncatalogued", 40),
    Stratum("two", 40, (5.0, 10.0)),
)
OVER_CONDITIONS: Final = (
    Stratum("null", 750),
    Stratum("clear", 750, (5.0, 10.0)),
    Stratum("prior", 150),
    Stratum("faint", 150, (2.0, 3.0)),
    Stratum("uncatalogued", 100),
    Stratum("two", 100, (5.0, 10.0)),
)
"""Over conditions: 150 of `null` and of `clear` for each of five kinds of events."""
TWO_WHEELS: Final = (
    Stratum("null", 20),
    Stratum("articulation", 20, (5.0, 10.0), "wheel_articulation"),
    Stratum("leak", 20, (5.0, 10.0), "thruster_leak"),
)
"""Where two wheels steer with the thrusters: what paper 004 adds to the causes, and a leak."""


def stratum_of(strata: Sequence[Stratum], index: int) -> Stratum:
    """Stratum of a trial: any first part of the campaign holds all strata in proportion."""
    order = _in_order(tuple(strata))
    return order[index % len(order)]


@lru_cache
def _in_order(strata: tuple[Stratum, ...]) -> tuple[Stratum, ...]:
    """The stratum of every trial of a full campaign."""
    slots = [
        ((i + 0.5) / stratum.trials, stratum.name, stratum)
        for stratum in strata
        for i in range(stratum.trials)
    ]
    return tuple(stratum for *_, stratum in sorted(slots, key=lambda slot: slot[:2]))


def planned(strata: Sequence[Stratum]) -> int:
    """Trials of a full campaign."""
    return sum(stratum.trials for stratum in strata)
