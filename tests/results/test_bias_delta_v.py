"""Measured velocity change of a wheel bias: a datum of the joint model; one computed is none."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from event_cases import document, priors

from cassini_bayes.computing.arrays import Array
from cassini_bayes.model import (
    Model,
    ReducedEvent,
    build_model,
    log_likelihood,
    observability,
    reduce_event,
)
from cassini_bayes.simulation import scenario_of
from cassini_bayes.studies.scenario import simulate_file, write_simulation

NOISE_M_S = 3.0e-5


@cache
def flown(source: str) -> tuple[ReducedEvent, dict[str, float]]:
    """A bias with a velocity change of some source, and the true parameters."""
    content = document()
    content["event"] = content["event"][:1]
    content["telemetry"] |= {"delta_v": source, "delta_v_noise_m_s": NOISE_M_S}
    with TemporaryDirectory() as folder:
        simulation = simulate_file(scenario_of(content), 7)
        write_simulation(simulation, Path(folder))
        reduced = reduce_event(Path(folder) / "bias", priors(), "first_order")
        truth = json.loads((Path(folder) / "truth.json").read_text())["parameters"]
    # the mass that was flown: the scenario's times the factor that was drawn
    return reduced, truth | {"mass_kg": simulation.events[0].plan.parameters["mass_kg"]}


def model(factor: float = 1.0) -> Model:
    """The joint model of the bias with its measured velocity change, scaled by ``factor``."""
    event = flown("measured")[0]
    assert event.delta_v is not None
    own = event.delta_v
    scaled = replace(own, cross=factor * own.cross, square=factor**2 * own.square)
    return build_model([replace(event, delta_v=scaled)], priors())


def known_mass() -> Model:
    """The same model with the true mass known."""
    event = flown("measured")[0]
    assert event.delta_v is not None
    known = priors().with_fixed("mass_kg", flown("measured")[1]["mass_kg"])
    return build_model([event], known)


def without() -> Model:
    """The same model without the velocity change."""
    event = flown("measured")[0]
    return build_model([replace(event, delta_v=None)], priors())


def at_truth(joint: Model) -> Array:
    """Walked coordinates (1, d) of the true parameters."""
    truth = flown("measured")[1] | {
        "delta_v_noise_m_s": NOISE_M_S,
        "close_pulse_share": 0.3,
        "close_pulse_factor": 0.5,
    }
    return joint.space.to_standard({name: np.array([truth[name]]) for name in joint.space.names})


def test_a_measured_change_is_a_datum_and_a_computed_one_is_not() -> None:
    """The reduction holds the one and leaves the other out."""
    assert flown("measured")[0].delta_v is not None
    assert flown("computed")[0].delta_v is None
    assert model().telemetry[0].event.delta_v is not None
    assert {"mass_kg", "delta_v_noise_m_s"} <= set(model().space.names)
    assert "mass_kg" not in without().space.names


def masses(factor: float = 1.0) -> tuple[float, float]:
    """Mean and sd of the mass (flat prior), kg, all else being true."""
    joint, kg = model(factor), np.arange(2100.0, 2700.0, 2.0)
    z = np.repeat(at_truth(joint), len(kg), axis=0)
    place = joint.space.names.index("mass_kg")
    z[:, place] = joint.space.to_standard({**_values(joint, z), "mass_kg": kg})[:, place]
    value = log_likelihood(joint, z)
    weight = np.exp(value - value.max())
    mean = float((weight * kg).sum() / weight.sum())
    sd = float(np.sqrt((weight * (kg - mean) ** 2).sum() / weight.sum()))
    return mean, sd


def _values(joint: Model, z: Array) -> dict[str, Array]:
    values = joint.space.to_parameters(z)
    return {name: np.broadcast_to(values[name], (len(z),)) for name in joint.space.names}


def test_momentum_and_velocity_together_weigh_the_spacecraft() -> None:
    """All else known, thrust is what momentum needs, and the mass what the velocity makes of it."""
    mean, sd = masses()
    assert sd < 30.0
    assert abs(mean - flown("measured")[1]["mass_kg"]) < 3.0 * sd


def test_a_change_of_another_size_gives_another_mass() -> None:
    """Negative control: a velocity change a twentieth too large is a mass as much too small."""
    true = flown("measured")[1]["mass_kg"]
    mean, sd = masses(1.05)
    assert mean == pytest.approx(true / 1.05, abs=3.0 * sd)
    assert abs(mean - true) > 3.0 * sd


def test_the_mass_is_seen_and_thrusts_hardly_gain() -> None:
    """Expected widths: mass less than its prior; thrusts less than without, least at known mass."""
    widths = []
    for joint in (without(), model(), known_mass()):
        table = observability(joint).table
        thrusts = table[table["quantity"].str.startswith("thrust[bias,z")]
        assert len(thrusts) == 4
        widths.append(float(thrusts["expected_sd"].mean()))
    assert widths[0] > widths[1] > widths[2] > 0.97 * widths[0]
    seen = observability(model()).table.set_index("quantity")
    assert seen.loc["mass_kg", "ratio"] < 0.8
