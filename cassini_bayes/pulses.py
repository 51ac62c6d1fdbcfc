"""What a thruster pulse delivers: interchangeable pulse shapes with their thrust curves.

A pulse is commanded on at t = 0 and off at t = Δ. Valve and propellant delay it by τ_d, the thrust
rises with time constant τ_r and tails off with τ_f. The *effective time* of a pulse is its impulse
over the steady thrust [s]. The papers read the same sentence in different ways, so each reading is
a shape of its own, with the thrust curve that it integrates. All functions broadcast.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
EffectiveTime = Callable[[Array, Array, Array, Array], Array]
ThrustFraction = Callable[[Array, Array, Array, Array, Array], Array]


@dataclass(frozen=True)
class PulseShape:
    """A pulse shape: its effective time and the thrust curve that integrates to it."""

    name: str
    source: str
    _effective: EffectiveTime
    _fraction: ThrustFraction

    def effective_time(
        self,
        width_s: ArrayLike,
        tau_delay_s: ArrayLike,
        tau_rise_s: ArrayLike,
        tau_fall_s: ArrayLike,
    ) -> Array:
        """Impulse of one pulse of commanded width over the steady thrust, in s."""
        return self._effective(*_floats(width_s, tau_delay_s, tau_rise_s, tau_fall_s))

    def thrust_fraction(
        self,
        time_s: ArrayLike,
        width_s: ArrayLike,
        tau_delay_s: ArrayLike,
        tau_rise_s: ArrayLike,
        tau_fall_s: ArrayLike,
    ) -> Array:
        """Thrust over steady thrust at a time after the on command."""
        return self._fraction(*_floats(time_s, width_s, tau_delay_s, tau_rise_s, tau_fall_s))


def _floats(*values: ArrayLike) -> tuple[Array, ...]:
    return tuple(np.asarray(value, dtype=np.float64) for value in values)


def _decay(time: Array, tau: Array) -> Array:
    """exp(−t/τ) for t ≥ 0, with its limit 0 at τ = 0 (1 at t = 0)."""
    safe = np.where(tau > 0, tau, 1.0)
    return np.where(tau > 0, np.exp(-np.maximum(time, 0.0) / safe), time <= 0)


def _rectangular_time(width: Array, delay: Array, rise: Array, fall: Array) -> Array:
    return width + 0.0 * (delay + rise + fall)


def _rectangular(time: Array, width: Array, delay: Array, rise: Array, fall: Array) -> Array:
    return np.where((time >= 0) & (time < width), 1.0, 0.0) + 0.0 * (delay + rise + fall)


def _first_order_time(width: Array, delay: Array, rise: Array, fall: Array) -> Array:
    return width + (fall - rise) * (1.0 - _decay(width, rise)) + 0.0 * delay


def _first_order(time: Array, width: Array, delay: Array, rise: Array, fall: Array) -> Array:
    since_on, since_off = time - delay, time - delay - width
    rising = 1.0 - _decay(since_on, rise)
    falling = (1.0 - _decay(width, rise)) * _decay(since_off, fall)
    return np.where(since_on < 0, 0.0, np.where(since_off < 0, rising, falling))


def _first_order_held_time(width: Array, delay: Array, rise: Array, fall: Array) -> Array:
    on = np.maximum(width - delay, 0.0)
    reached = 1.0 - _decay(on, rise)
    return on - rise * reached + (delay + fall) * reached


def _first_order_held(time: Array, width: Array, delay: Array, rise: Array, fall: Array) -> Array:
    reached = 1.0 - _decay(np.maximum(width - delay, 0.0), rise)
    rising = 1.0 - _decay(time - delay, rise)
    after = np.where(time < width + delay, reached, reached * _decay(time - width - delay, fall))
    return np.where(time < np.minimum(delay, width), 0.0, np.where(time < width, rising, after))


def _published_2005_time(width: Array, delay: Array, rise: Array, fall: Array) -> Array:
    at_off, at_delay = _decay(width, rise), _decay(delay, rise)
    return (width + fall) + rise * (at_off - at_delay) - (fall + delay) * at_off


def _published_2005(time: Array, width: Array, delay: Array, rise: Array, fall: Array) -> Array:
    reached = 1.0 - _decay(width, rise)
    rising = 1.0 - _decay(time, rise)
    after = np.where(time < width + delay, reached, reached * _decay(time - width - delay, fall))
    return np.where(time < delay, 0.0, np.where(time < width, rising, after))


def _published_2012_time(width: Array, delay: Array, rise: Array, fall: Array) -> Array:
    return width - rise + fall + 0.0 * delay


def _published_2012(time: Array, width: Array, delay: Array, rise: Array, fall: Array) -> Array:
    # the impulse lost in the rise is taken as F τ_r: full thrust from τ_r after the valve delay
    falling = _decay(time - delay - width, fall)
    return np.where(time < delay + rise, 0.0, np.where(time < delay + width, 1.0, falling))


PULSE_SHAPES: Final[Mapping[str, PulseShape]] = {
    shape.name: shape
    for shape in (
        PulseShape("rectangular", "instantaneous thrust", _rectangular_time, _rectangular),
        PulseShape(
            "first_order",
            "paper 000 §V, read as a pure transport delay of both edges",
            _first_order_time,
            _first_order,
        ),
        PulseShape(
            "first_order_held",
            "paper 000 §V, read literally: the thrust reached at the off command is held for τ_d",
            _first_order_held_time,
            _first_order_held,
        ),
        PulseShape(
            "published_2005",
            "paper 000 §V, closed form (rise timed from the command, so thrust jumps at τ_d)",
            _published_2005_time,
            _published_2005,
        ),
        PulseShape(
            "published_2012",
            "paper 003 eq. (7): τ_r lost, τ_f gained, whatever the width",
            _published_2012_time,
            _published_2012,
        ),
    )
}


def effective_on_time(
    shape: PulseShape,
    on_time_s: ArrayLike,
    pulses: ArrayLike,
    tau_delay_s: ArrayLike,
    tau_rise_s: ArrayLike,
    tau_fall_s: ArrayLike,
) -> Array:
    """Effective on-time of pulses of equal width: n eff(u/n), and 0 where there was no pulse.

    Adjacent firings merge (a 250 ms firing is one pulse), so ``pulses`` counts tail-offs.
    """
    on_time, count = _floats(on_time_s, pulses)
    fired = count > 0
    width = np.where(fired, on_time / np.where(fired, count, 1.0), 1.0)
    each = shape.effective_time(width, tau_delay_s, tau_rise_s, tau_fall_s)
    return np.where(fired, count * each, 0.0)
