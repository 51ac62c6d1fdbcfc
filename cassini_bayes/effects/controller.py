"""How an attitude controller responds to a wheel bias: the input of an effect on its firings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

from cassini_bayes.computing.arrays import Array


class Controller(Protocol):
    """The ideal calculation at n points for E events of K thrusters, and what it could be.

    All on-times are in s, (n, E, K). Opposing firings are those of both sides of an axis against
    each other, (n, E, 2) of the ring and of the couple axis (docs/topics/prediction.md §2).
    """

    def expected_opposing(self, values: Mapping[str, Array]) -> Array:
        """Mean opposing firings at the firing model's parameters (n,)."""

    def opposing(self, each_s: Array) -> Array:
        """On-times of opposing firings."""

    def rest(self, opposing_s: Array) -> Array:
        """Momentum steps (n, E, S, 3), N m s, that opposing firings leave to be turned."""

    def singles(self, steps_n_m_s: Array) -> Array:
        """On-times of the single thrusters that need least for momentum steps."""

    def pairs(self, steps_n_m_s: Array) -> Array:
        """On-times of the pairs that push the right way for momentum steps."""

    def common_s(self) -> Array:
        """What the thruster that both axes of the ring demand has to fire alone, (n, E)."""


@dataclass(frozen=True)
class Fired:
    """On-times (n, E, K) and what their chance acts on.

    ``opposing_s`` (n, E, 2) are expected opposing firings, ``common_s`` (n, E) what the common
    thruster is expected to fire alone, ``alone`` (n, E, K) the change of the on-times per second of
    that.
    """

    on_time_s: Array
    opposing_s: Array
    common_s: Array
    alone: Array
