"""Rates and wheel speeds as measured and as the balance has them, before and after.

A row's balance has one momentum for rates ω and wheel speeds ρ, H = J ω + A diag(I) ρ. With r what
a model leaves of it, measured less modelled, rates that go with the measured wheel speeds are
ω − J⁻¹ r, and wheel speeds that go with the measured rates ρ − (A diag(I))⁺ r. What a cause adds is
the same of the extended model's momentum with the cause less without it, all else as the extended
model has it. The fit of a channel is the normalised root mean square error of MATLAB's ``compare``,

    fit = 100 (1 − ‖y − ŷ‖ / ‖y − mean(y)‖) per cent.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from cassini_bayes.balance.linearised import InnovationRows, Linear
from cassini_bayes.computing.arrays import Array
from cassini_bayes.diagnosis.case import Weighed
from cassini_bayes.diagnosis.events import Events
from cassini_bayes.diagnosis.hypotheses import Hypothesis, compact, none_hypothesis
from cassini_bayes.diagnosis.innovations import linearise
from cassini_bayes.effects.effect import Remainder
from cassini_bayes.spacecraft.units import RPM_PER_RAD_S

MRAD: Final = 1e3
AXES: Final = "XYZ"


@dataclass(frozen=True)
class Channel:
    """One channel of an event: measured and modelled, and what the cause adds, each (n,)."""

    name: str
    unit: str
    measured: Array
    baseline: Array
    extended: Array | None = None
    cause: Array | None = None

    @property
    def fit(self) -> tuple[float, float | None]:
        """Per cent, before and after."""
        after = None if self.extended is None else fit_percent(self.measured, self.extended)
        return fit_percent(self.measured, self.baseline), after


@dataclass(frozen=True)
class Overlay:
    """The channels of one event against time (n,): rates first, then wheels."""

    event: str
    time_s: Array
    channels: tuple[Channel, ...]

    @property
    def record(self) -> list[dict[str, Any]]:
        """The fit of every channel."""
        return [
            {
                "event": self.event,
                "channel": channel.name,
                "baseline_percent": channel.fit[0],
                "extended_percent": channel.fit[1],
            }
            for channel in self.channels
        ]


def fit_percent(measured: Array, modelled: Array) -> float:
    """100 (1 − ‖y − ŷ‖/‖y − mean(y)‖); NaN where the channel does not change."""
    spread = float(np.linalg.norm(measured - measured.mean()))
    if spread == 0.0:
        return float("nan")
    return 100.0 * (1.0 - float(np.linalg.norm(measured - modelled)) / spread)


def overlays(
    events: Events,
    before: Weighed[Hypothesis],
    after: Weighed[Hypothesis] | None,
) -> tuple[Overlay, ...]:
    """Every event's channels, by the baseline and where there is one by the extended model.

    Both with what they leave of telemetry.
    """
    assert before.remainder is not None
    extended = None if after is None else after.remainder
    added = None if after is None or not after.is_cause else cause_part(events, after)
    return tuple(
        _overlay(
            before,
            place,
            rows,
            None if extended is None else extended.rows[place].residual_n_m_s,
            None if added is None else added[place],
        )
        for place, rows in enumerate(before.remainder.rows)
    )


def cause_part(events: Events, weighed: Weighed[Hypothesis]) -> list[Array]:
    """Momentum (n, 3), N m s, of every event's rows that a cause adds at its mode."""
    left: Remainder | None = weighed.remainder
    assert left is not None
    hypothesis = weighed.hypothesis
    without = compact(none_hypothesis(events.with_columns_of(hypothesis.effects)))
    shared = without.part_of(hypothesis, weighed.mode.point)
    linear, factors = linearise(hypothesis, weighed.mode.point)
    plain, plain_factors = linearise(without, shared)
    seen = left.linear.columns.along(left.target)
    fitted = np.asarray(np.linalg.solve(left.linear.gram(), seen), dtype=np.float64)
    # slopes stand first, and are those of one model alone; all other unknowns are both models'
    unknowns = fitted[len(weighed.mode.point) : linear.columns.width]
    missing = _left(plain, unknowns, len(shared), plain_factors)
    present = _left(linear, unknowns, len(weighed.mode.point), factors)
    return [without_it - with_it for without_it, with_it in zip(missing, present, strict=True)]


def _left(linear: Linear, unknowns: Array, slopes: int, factors: Sequence[Array]) -> list[Array]:
    """Measured less predicted momentum (n, 3) of every event with some values of the unknowns."""
    white = linear.target - linear.columns @ np.concatenate([np.zeros(slopes), unknowns])
    return [
        white[part].reshape(-1, 3) @ factor.T
        for part, factor in zip(linear.parts, factors, strict=True)
    ]


def _overlay(
    before: Weighed[Hypothesis],
    place: int,
    rows: InnovationRows,
    extended_n_m_s: Array | None,
    cause_n_m_s: Array | None,
) -> Overlay:
    model = before.hypothesis.model
    physics = model.telemetry[place].physics(model.points(before.mode.point[None]))
    per_rate = physics.momentum_per_rate.reshape(-1, 3, 3)[0]
    numbers = [wheel.number for wheel in model.spacecraft.wheels]
    used = [numbers.index(number) for number in rows.wheels]
    per_wheel = physics.wheel_weights.reshape(-1, 3, len(numbers))[0][:, used]
    wheels = [f"wheel {number}" for number in rows.wheels]
    kinds = (
        (np.linalg.inv(per_rate), MRAD, rows.rate_rad_s, "mrad/s", [f"rate {a}" for a in AXES]),
        (np.linalg.pinv(per_wheel), RPM_PER_RAD_S, rows.wheel_rad_s, "rpm", wheels),
    )
    channels = []
    for inverse, factor, measured, unit, names in kinds:
        to_channel = factor * inverse
        for c, name in enumerate(names):
            value = factor * measured[:, c]
            after = None if extended_n_m_s is None else value - extended_n_m_s @ to_channel[c]
            part = None if cause_n_m_s is None else cause_n_m_s @ to_channel[c]
            corrected = value - rows.residual_n_m_s @ to_channel[c]
            channels.append(Channel(name, unit, value, corrected, after, part))
    return Overlay(rows.event, rows.time_s, tuple(channels))
