"""Something outside the catalogue, of at least a size in σ, for the blind trials."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from cassini_bayes.diagnosis.events import Events
from cassini_bayes.errors import InputError
from cassini_bayes.studies.blind.flights import Hidden
from cassini_bayes.studies.blind.shift import changed_size
from cassini_bayes.studies.blind.sizes import MOST_FLIGHTS, Stage

LEAST_SIGMA: Final = 5.0
KINDS: Final = ("atmospheric_torque", "pressure_surge", "tachometer_scale", "plume_impingement")
WITHOUT_THRUSTERS: Final = ("atmospheric_torque", "tachometer_scale")


@dataclass(frozen=True)
class UncataloguedKind:
    """A kind outside the catalogue: parameters of unit size, those that do not grow, log10 span."""

    name: str
    direction: Mapping[str, float]
    constant: Mapping[str, float]
    span: tuple[float, float]

    def hidden(self, size: float) -> Hidden:
        """The effect at a size."""
        grown = {key: size * value for key, value in self.direction.items()}
        return Hidden(self.name, {**grown, **self.constant}, float("nan"))


def draw_kind(events: Events, rng: np.random.Generator) -> UncataloguedKind:
    """An atmospheric torque, a pressure surge, a tachometer scale or plume impingement.

    Where no thruster fires, one that needs none.
    """
    event = next((event for event in events.telemetry if event.fires), events.telemetry[0])
    kind = str(rng.choice(KINDS if event.fires else WITHOUT_THRUSTERS))
    if kind == "atmospheric_torque":
        peak = rng.standard_normal(3)
        direction = {f"peak_{a}_n_m": float(v) for a, v in zip("xyz", peak, strict=True)}
        when = {
            "centre_s": float(rng.uniform(0.2, 0.8) * event.sampling.duration_s),
            "width_s": float(rng.uniform(50.0, 250.0)),
        }
        return UncataloguedKind(kind, direction, when, (-4.7, -3.3))
    if kind == "pressure_surge":
        when = {
            "start_s": float(rng.uniform(0.1, 0.6) * event.sampling.duration_s),
            "decay_s": float(rng.uniform(100.0, 500.0)),
        }
        return UncataloguedKind(kind, {"thrust_fraction": 1.0}, when, (-1.5, -0.5))
    if kind == "tachometer_scale":
        sign = float(rng.choice([-1.0, 1.0]))
        return UncataloguedKind(kind, {"slope_per_rpm": sign}, {}, (-6.0, -4.5))
    thruster = str(rng.choice(event.thrusters))
    return UncataloguedKind(f"{kind}:{thruster}", {"lever_m": 1.0}, {}, (-1.5, -0.3))


def draw_uncatalogued(stage: Stage, rng: np.random.Generator) -> Hidden | None:
    """An uncatalogued effect, log-uniform over its span as far as it is at least 5 σ.

    None where even the largest of its kind is smaller on this flight.
    """
    kind = draw_kind(stage.events, rng)
    low, high = kind.span
    top = _measured(stage, kind.hidden(10.0**high))
    if top is None or top.sigma < LEAST_SIGMA:
        return None
    low = max(low, high - float(np.log10(top.sigma / LEAST_SIGMA)))
    for _ in range(MOST_FLIGHTS):
        measured = _measured(stage, kind.hidden(10.0 ** float(rng.uniform(low, high))))
        if measured is not None and measured.sigma >= LEAST_SIGMA:
            return measured
    return top


def _measured(stage: Stage, hidden: Hidden) -> Hidden | None:
    try:
        return replace(hidden, sigma=changed_size(stage.view(hidden), stage.plain))
    except InputError:
        return None  # the simulation refuses it
