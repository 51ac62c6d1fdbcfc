"""Pulses that are still being delivered in a row.

Counters show a pulse when it starts; thrust builds up and decays for another tenth of a second or
two. Rows in which something is late are left out as long as others are left. A controller that
fires in every interval between two readings leaves none. Then rows at readings are averaged over
blocks. What is late in a row is at most a pulse, does not add up, and is noise of its own: that of
pulses at any time, times a factor that is inferred (docs/topics/telemetry-likelihood.md §4).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.integrate import cumulative_trapezoid, trapezoid

from cassini_bayes.computing.arrays import Array
from cassini_bayes.spacecraft.pulses import PulseShape

AGES_OF_SHARE: Final = 4001  # of a pulse, to a tenth of a millisecond
LEAST_LATE: Final = 0.01  # of a pulse, for what is late to have a share
AGES: Final = 251  # of a running pulse that moments are integrated over, and of a tail
TAIL: Final = 8.0  # time constants after which nothing is left of a tail: right to 1e-3
# Multiples of the reference time constants at which moments are fitted, and their powers: what
# priors allow, right to half a percent, and of tails what a doubted one may be. (Moments of an
# exponential tail are such powers of its time constant.)
_RISES: Final = np.linspace(0.6, 1.4, 5)
_FALLS: Final = np.linspace(0.2, 6.0, 7)
_POWERS: Final = [(i, j) for i in range(3) for j in range(4)]


@dataclass(frozen=True)
class LatePulses:
    """What pulses have still to deliver at a time that owes nothing to them.

    ``coefficients`` (2, 12) are those of polynomials for ∫ ℓ da, s², and ∫ ℓ² da, s³, over the time
    since a pulse began, ℓ the on-time that it has still to deliver, in τ_rise and τ_fall over their
    values ``reference_s``. ``rate_hz`` (G,) are the pulses of every couple per second, ``width_s``
    is their mean width.
    """

    coefficients: Array
    reference_s: tuple[float, float]
    rate_hz: Array
    width_s: float

    def variance_s2(self, rise_s: Array, fall_s: Array, offset_s: Array | float = 0.0) -> Array:
        """Variance (n, G), s², of what is late of every couple, at time constants (n,).

        Of pulses that begin at any time, λ per second, λ ∫ℓ da is late on average, and its square
        λ ∫ℓ² da (two pulses of a couple are not late at once). A pulse of width w that goes on for
        longer, by an offset o (n,), is late by o + τ_f until it should have ended, and by less
        then: that adds o w + o²/2 + o τ_f, and w ((o + τ_f)² − τ_f²) + ((o + τ_f)³ − τ_f³)/3.
        """
        rise, fall = self.reference_s
        basis = _basis(
            np.clip(_relative(rise_s, rise), _RISES[0], _RISES[-1]),
            np.clip(_relative(fall_s, fall), _FALLS[0], _FALLS[-1]),
        )
        longer = np.maximum(offset_s, 0.0)
        whole = longer + fall_s
        added = (
            longer * (self.width_s + 0.5 * longer + fall_s),
            self.width_s * (whole**2 - fall_s**2) + (whole**3 - fall_s**3) / 3.0,
        )
        mean, square = (
            np.multiply.outer(basis @ each + more, self.rate_hz)
            for each, more in zip(self.coefficients, added, strict=True)
        )
        return np.asarray(np.maximum(square - mean**2, 0.0))


def late_pulses(
    shape: PulseShape, tau_s: tuple[float, float, float], width_s: float, rate_hz: Array
) -> LatePulses:
    """Moments of what is late, of pulses of their mean width.

    A pulse is counted when it begins, its on-time as it goes on: at age a it is credited with
    min(a, w) of the effective time g(w) and with all that g(w) is beyond w, and has delivered the
    integral of its thrust until then.

    Parameters
    ----------
    shape, tau_s
        Pulse shape and τ_delay, τ_rise, τ_fall of the reference.
    width_s, rate_hz
        Mean width of pulses, and how many every couple (G,) begins per second.
    """
    delay, rise, fall = tau_s
    rises, falls = (each.ravel() for each in np.meshgrid(rise * _RISES, fall * _FALLS))
    taus = delay, rises[:, None], falls[:, None]
    running = np.broadcast_to(np.linspace(0.0, width_s + delay, AGES), (len(falls), AGES))
    tail = width_s + delay + falls[:, None] * np.linspace(0.0, TAIL, AGES)[1:]
    age = np.concatenate([running, tail], axis=1)
    thrust = shape.thrust_fraction(age, width_s, *taus)
    delivered = cumulative_trapezoid(thrust, age, axis=1, initial=0.0)
    late = _due(age, width_s, shape.effective_time(width_s, *taus), delivered)
    moments = np.stack([trapezoid(late, age), trapezoid(late**2, age)], axis=1)
    basis = _basis(_relative(rises, rise), _relative(falls, fall))
    fitted = np.linalg.lstsq(basis, moments, rcond=None)[0]
    return LatePulses(np.ascontiguousarray(fitted.T), (rise, fall), rate_hz, width_s)


def body_share(
    shape: PulseShape,
    tau_s: tuple[float, float, float],
    width_s: float,
    first_s: float,
    every_s: float,
) -> float:
    """Share of what is late that the body has, with the other sign: −E[h ℓ]/E[ℓ²].

    Before a pulse the body has on average half of its momentum g with the other sign, and D − g/2
    when D is delivered. Of a pulse that stands alone, over the ages at which readings find it,

        κ = Σ (g/2 − D) ℓ / Σ ℓ²

    per newton and lever arm. Long tails have up to 0.3, short ones less than nothing; of a valve
    without delays nothing is late.

    Parameters
    ----------
    shape, tau_s, width_s
        Pulse shape, τ_delay, τ_rise, τ_fall and mean width of pulses.
    first_s, every_s
        Readings find a pulse at ages ``first_s``, ``first_s + every_s``, …; at any with 0.
    """
    delay, _, fall = tau_s
    end = width_s + delay + TAIL * fall
    age = np.linspace(0.0, end, AGES_OF_SHARE)
    delivered = cumulative_trapezoid(shape.thrust_fraction(age, width_s, *tau_s), age, initial=0.0)
    found = np.arange(first_s, end, every_s) if every_s > 0.0 else age
    whole = float(shape.effective_time(width_s, *tau_s))
    brought = np.interp(found, age, delivered)
    late = _due(found, width_s, whole, brought)
    square = float(np.mean(late**2))
    if square < (LEAST_LATE * whole) ** 2:
        return 0.0
    return float(np.mean((0.5 * whole - brought) * late)) / square


def _due(age_s: Array, width_s: float, whole_s: Array | float, delivered_s: Array) -> Array:
    """What a pulse is credited with at some age, and has not delivered yet, s."""
    return np.asarray(np.minimum(age_s - width_s, 0.0) + whole_s - delivered_s)


def _relative(constant_s: Array, reference_s: float) -> Array:
    """Time constants over that of the reference; one that is fixed at 0 has no others."""
    if reference_s == 0.0:
        return np.ones_like(constant_s)
    return np.asarray(constant_s / reference_s)


def _basis(rise: Array, fall: Array) -> Array:
    """Powers (n, 12) of relative time constants (n,)."""
    return np.stack([rise**i * fall**j for i, j in _POWERS], axis=-1)
