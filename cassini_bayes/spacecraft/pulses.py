"""What a thruster pulse delivers: interchangeable pulse shapes with their thrust curves.

A pulse is commanded on at t = 0 and off at t = Δ. Valve and propellant delay it by τ_d, the thrust
rises with time constant τ_r and tails off with τ_f. The *effective time* of a pulse is its impulse
over the steady thrust, in s. The papers read the same sentence in different ways, so each reading
is a shape of its own, with the thrust curve that it integrates; docs/topics/geometry-and-pulses.md
has the comparison. All functions broadcast. Widths and time constants are not negative; a time
constant of 0 is an edge without rise or tail.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from cassini_bayes.computing.arrays import Array
from cassini_bayes.errors import InputError
from cassini_bayes.files.checks import choose

EffectiveTime = Callable[[Array, Array, Array, Array], Array]
ThrustFraction = Callable[[Array, Array, Array, Array, Array], Array]


@dataclass(frozen=True)
class PulseShape:
    """A pulse shape: its effective time and the thrust curve that integrates to it.

    ``name`` is the key of :data:`PULSE_SHAPES`, ``source`` says whose reading it is.
    """

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
        """Impulse of one pulse of commanded width over the steady thrust, in s.

        The arguments broadcast against each other; the result has their common shape.
        """
        return self._effective(*_floats(width_s, tau_delay_s, tau_rise_s, tau_fall_s))

    def thrust_fraction(
        self,
        time_s: ArrayLike,
        width_s: ArrayLike,
        tau_delay_s: ArrayLike,
        tau_rise_s: ArrayLike,
        tau_fall_s: ArrayLike,
    ) -> Array:
        """Thrust over steady thrust at a time after the on command of one pulse.

        The arguments broadcast against each other; the result has their common shape.
        """
        return self._fraction(*_floats(time_s, width_s, tau_delay_s, tau_rise_s, tau_fall_s))

    def longer_time(
        self,
        width_s: ArrayLike,
        offset_s: ArrayLike,
        tau_delay_s: ArrayLike,
        tau_rise_s: ArrayLike,
        tau_fall_s: ArrayLike,
    ) -> Array:
        """Effective time, s, of a pulse that lasts longer than commanded by an offset.

        A negative offset leaves nothing of a pulse that is shorter. The arguments broadcast.
        """
        lasts = np.maximum(np.asarray(width_s) + np.asarray(offset_s), 0.0)
        return self.effective_time(lasts, tau_delay_s, tau_rise_s, tau_fall_s)

    def tail_s(self, tau_delay_s: ArrayLike, tau_rise_s: ArrayLike, tau_fall_s: ArrayLike) -> Array:
        """On-time that a long pulse delivers beyond its width, in s: what an early command cuts."""
        return self.effective_time(STEADY_S, tau_delay_s, tau_rise_s, tau_fall_s) - STEADY_S

    def reached(
        self,
        width_s: ArrayLike,
        tau_delay_s: ArrayLike,
        tau_rise_s: ArrayLike,
        tau_fall_s: ArrayLike,
    ) -> Array:
        """Thrust over steady thrust as the tail of a pulse begins: 1 − exp(−Δ/τ_r) of first order.

        0 of a rectangular one, which has no tail. The arguments broadcast against each other; the
        result has their common shape.
        """
        begins = np.asarray(width_s) + np.asarray(tau_delay_s)
        return self.thrust_fraction(begins, width_s, tau_delay_s, tau_rise_s, tau_fall_s)


def _floats(*values: ArrayLike) -> tuple[Array, ...]:
    return tuple(np.asarray(value, dtype=np.float64) for value in values)


STEADY_S: Final = 60.0
"""Width of a pulse whose thrust is steady, whatever the time constants."""
# Below any time constant that means something, above what would overflow a quotient.
_NO_TIME_S: Final = 1e-200


def _decay(time: Array, tau: Array) -> Array:
    """exp(−t/τ) for t ≥ 0, 1 before, with its limit 0 at τ = 0 (1 at t = 0)."""
    return np.exp(-np.maximum(time, 0.0) / np.maximum(tau, _NO_TIME_S))


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
    # the printed closed form where the thrust begins before the off command (τ_d ≤ Δ); a shorter
    # pulse has no rise, only the hold, from τ_d to Δ + τ_d
    late = np.minimum(width, delay)
    at_off, at_begin = _decay(width, rise), _decay(late, rise)
    return width + fall + rise * (at_off - at_begin) - (fall + late) * at_off


def _published_2005(time: Array, width: Array, delay: Array, rise: Array, fall: Array) -> Array:
    reached = 1.0 - _decay(width, rise)
    rising = 1.0 - _decay(time, rise)
    after = np.where(time < width + delay, reached, reached * _decay(time - width - delay, fall))
    return np.where(time < delay, 0.0, np.where(time < width, rising, after))


def _published_2012_time(width: Array, delay: Array, rise: Array, fall: Array) -> Array:
    return width - rise + fall + 0.0 * delay


def _published_2012(time: Array, width: Array, delay: Array, rise: Array, fall: Array) -> Array:
    # A full tail, and the deficit of the rise left to run on after the off command: continuous,
    # and its integral is eq. (7) at every width.
    since_on = time - delay
    full = _decay(since_on - width, fall)
    return np.where(since_on < 0, 0.0, full - _decay(since_on, rise))


_SHAPES: Final = (
    PulseShape("rectangular", "instantaneous thrust", _rectangular_time, _rectangular),
    PulseShape(
        "first_order",
        "paper 000 section V, read as a pure transport delay of both edges",
        _first_order_time,
        _first_order,
    ),
    PulseShape(
        "first_order_held",
        "paper 000 section V, read literally: the thrust reached at the off command stays for τ_d",
        _first_order_held_time,
        _first_order_held,
    ),
    PulseShape(
        "published_2005",
        "paper 000 section V, closed form: the rise is timed from the command and starts at τ_d",
        _published_2005_time,
        _published_2005,
    ),
    PulseShape(
        "published_2012",
        "paper 003 eq. (7): τ_r lost and τ_f gained, whatever the width",
        _published_2012_time,
        _published_2012,
    ),
)

PULSE_SHAPES: Final[Mapping[str, PulseShape]] = MappingProxyType({s.name: s for s in _SHAPES})
"""Every pulse shape by its name.

With reached(t) = 1 − exp(−t/τ_r), the effective times are

* ``rectangular``: Δ
* ``first_order``: Δ + (τ_f − τ_r) reached(Δ)
* ``first_order_held``: u − τ_r reached(u) + (τ_d + τ_f) reached(u), u = max(Δ − τ_d, 0)
* ``published_2005``: Δ + τ_f + τ_r (exp(−Δ/τ_r) − exp(−τ_d/τ_r)) − (τ_f + τ_d) exp(−Δ/τ_r) for
  Δ ≥ τ_d, and (Δ + τ_f) reached(Δ) below
* ``published_2012``: Δ − τ_r + τ_f
"""


def shape_named(name: str, where: str) -> PulseShape:
    """The pulse shape of a name.

    Raises
    ------
    InputError
        There is none; ``where`` is what gave the name.
    """
    if name not in PULSE_SHAPES:
        expected = f"one of {', '.join(PULSE_SHAPES)}"
        raise InputError(where, expected, repr(name), choose(name, PULSE_SHAPES))
    return PULSE_SHAPES[name]


def effective_on_time(
    shape: PulseShape,
    on_time_s: ArrayLike,
    pulses: ArrayLike,
    tau_delay_s: ArrayLike,
    tau_rise_s: ArrayLike,
    tau_fall_s: ArrayLike,
) -> Array:
    """Effective on-time of a number of pulses: n · effective_time(u/n), and 0 without a pulse.

    The pulses are taken as equally wide. Adjacent firings merge (two of 125 ms in a row are one
    pulse of 250 ms), so ``pulses`` counts tail-offs, not control cycles.

    Parameters
    ----------
    shape
        Pulse shape, e.g. ``PULSE_SHAPES["first_order"]``.
    on_time_s
        Commanded on-time of all pulses together, u.
    pulses
        Number of pulses, n.
    tau_delay_s, tau_rise_s, tau_fall_s
        Time constants; all arguments broadcast.

    Returns
    -------
    Impulse over steady thrust, s, in the arguments' common shape.
    """
    on_time, count = _floats(on_time_s, pulses)
    fired = count > 0
    width = np.where(fired, on_time / np.where(fired, count, 1.0), 1.0)
    each = shape.effective_time(width, tau_delay_s, tau_rise_s, tau_fall_s)
    return np.where(fired, count * each, 0.0)
