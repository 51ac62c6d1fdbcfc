"""What is believed of thrusts that were printed without telemetry, before they are read.

An estimate is F R(τ_f) k (1 + ε): F the thrust, R the ratio of delivered to commanded impulse of
its pulses, 1 where tails were corrected for, k what all estimates share. Widths are of normal
priors (1 σ). A cause widens one of them, as the catalogue widens those of the baseline.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

FACTOR: Final = 5.0
"""Width of a doubted prior over the baseline's, as ``times_prior`` of the catalogue's tables."""


@dataclass(frozen=True)
class Printed:
    """Widths of what estimates depend on.

    ``thrust_sd`` and ``scale_sd`` (geometry and inertia) are fractions, ``fall_sd_s`` is that of
    the tail-off, ``offset_sd_s`` of an on-time per pulse that the closed form lacks.
    ``thrusters`` are those that estimates name, ``is_pulsed`` whether any is of uncorrected pulses.
    ``deficit_sd`` is that of the share that the ``degraded`` thrusters lack.
    """

    thrust_sd: float
    fall_sd_s: float
    scale_sd: float
    thrusters: tuple[str, ...] = ()
    is_pulsed: bool = True
    offset_sd_s: float = 0.0
    degraded: tuple[str, ...] = ()
    deficit_sd: float = 0.0
