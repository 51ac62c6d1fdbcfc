"""What a longer pulse delivers is the same in totals rows, in columns of telemetry, in measured
velocity changes, in the means of a fit and in printed thrusts: g(w + o).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from event_cases import events, model, priors

from cassini_bayes.balance.measured_delta_v import on_time_weights
from cassini_bayes.balance.physics import Physics, effective_on_times
from cassini_bayes.balance.statistics.pulse_columns import PulseBasis
from cassini_bayes.computing.arrays import Array
from cassini_bayes.diagnosis.estimates import DELAY_S, pulse_ratio
from cassini_bayes.effects.catalogue import named_effects
from cassini_bayes.model.event_reduction import sampling_of
from cassini_bayes.model.posterior import build_model
from cassini_bayes.spacecraft.pulses import PULSE_SHAPES

SHAPE = PULSE_SHAPES["first_order"]
TAU = (0.005, 0.02, 0.044)
WIDTH_S, PULSES = 0.016, 50.0
OFFSETS = [0.04, -0.006, -0.02]


def delivered(offset_s: float) -> float:
    """On-time g(w + o) of one pulse, s; nothing of one that ends before it began."""
    return float(SHAPE.effective_time(max(WIDTH_S + offset_s, 0.0), *TAU))


def physics_at(offset_s: float) -> Physics:
    """Only what pulses depend on."""
    tau = tuple(np.array([value]) for value in TAU)
    nothing = np.zeros((1, 3, 3))
    return Physics(
        nothing,
        nothing,
        np.zeros((1, 3)),
        np.zeros((1, 3, 8)),
        (tau[0], tau[1], tau[2]),
        impulse_offset_s=np.full((1, 8), offset_s),
    )


@pytest.mark.parametrize("offset_s", OFFSETS)
def test_an_offset_makes_every_pulse_longer_everywhere(offset_s: float) -> None:
    """Short pulses rise on: half as much again as an offset added to what they deliver."""
    physics, wanted = physics_at(offset_s), delivered(offset_s)
    pulses = np.full((1, 8), PULSES)
    of_totals = effective_on_times(SHAPE, physics, WIDTH_S * pulses, pulses)
    assert of_totals == pytest.approx(np.full((1, 1, 8), PULSES * wanted), abs=1e-12)
    basis = PulseBasis(SHAPE, (0.005, 0.021, 0.03), (WIDTH_S,) * 8)
    taus = tuple(np.array([value]) for value in TAU)
    columns = basis.columns(np.array([WIDTH_S]))
    of_telemetry = basis.of_thrusters(taus, np.array([[offset_s]]))[0, 0] @ columns[0]
    assert of_telemetry == pytest.approx(wanted, abs=1e-5)
    names = priors().spacecraft.thruster_names("B")
    sampling = replace(sampling_of(priors(), names, 60.0, "first_order"), widths_s=(WIDTH_S,) * 8)
    own = sampling.pulses.columns(np.array([WIDTH_S]))[0]
    of_delta_v = on_time_weights(sampling, physics, 1, 8)[0] @ np.tile(own, 8)
    assert of_delta_v == pytest.approx(np.full(8, wanted), abs=1e-5)
    printed = pulse_ratio(
        SHAPE,
        np.array([WIDTH_S]),
        np.array([PULSES]),
        TAU[1],
        np.array([TAU[2]]),
        np.array([offset_s]),
    )
    exact = SHAPE.effective_time(max(WIDTH_S + offset_s, 0.0), DELAY_S, *TAU[1:]) / WIDTH_S
    assert printed[0] == pytest.approx(float(exact), rel=1e-12)
    added = float(SHAPE.effective_time(WIDTH_S, *TAU)) + offset_s
    assert abs(wanted - added) > 0.1 * abs(offset_s)  # the negative control


def test_impulse_per_on_time_of_a_fit_has_the_offset() -> None:
    """The stretch of a bias with 40 ms more a pulse: n g(u/n + o)/u."""
    flown = events("bias")
    (effect,) = named_effects(["pulse_shape"], priors(), (1, 2, 4), ["telemetry"])
    longer = build_model(flown, priors(), effects=[effect])

    def stretch(offset_s: float) -> Array:
        """Of every thruster, (K,)."""
        z = np.zeros((1, longer.space.dimension))
        parameter = effect.parameters[0]
        place = longer.space.names.index(parameter.name)
        z[0, place] = offset_s / parameter.distribution.sd()  # a normal about zero
        return np.asarray(longer.telemetry[0].at(longer.points(z)).stretch[0, 0])

    reading = flown[0].reading
    on_time, pulses = np.array(reading.on_time_s), np.array(reading.pulses)
    plain = model("bias")
    taus = plain.telemetry[0].at(plain.points(np.zeros((1, plain.space.dimension)))).physics.tau_s
    assert (pulses > 0).all()
    wanted = pulses * SHAPE.effective_time(on_time / pulses + 0.04, *(t[0] for t in taus))
    assert stretch(0.04) == pytest.approx(wanted / on_time, rel=1e-9)
    assert (stretch(0.04) > 1.1 * stretch(0.0)).all()
