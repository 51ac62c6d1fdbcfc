"""Predictions from fits with effects: what these do to the fit they do to the planned bias."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import tomli_w
from prediction_cases import SIZE, beliefs, flights, physics
from totals_cases import B_BRANCH, FLIGHT

import cassini_bayes as cb
from cassini_bayes.computing.arrays import Array
from cassini_bayes.effects.registry import standard
from cassini_bayes.errors import InputError
from cassini_bayes.files.storage import digest
from cassini_bayes.model import Model, build_model
from cassini_bayes.pipeline.predictions import PlanResult
from cassini_bayes.prediction.learning import Learned, learn
from cassini_bayes.prediction.predict import Prediction, predict
from cassini_bayes.prediction.requests import request_of
from cassini_bayes.prediction.sources import fitted_effects, read_sources
from cassini_bayes.results.groups import build_fit
from cassini_bayes.results.record import save_fit
from cassini_bayes.spacecraft import lever_arms, wheel_axes, wheel_inertias
from cassini_bayes.spacecraft.pulses import effective_on_time
from cassini_bayes.spacecraft.units import RAD_S_PER_RPM
from cassini_bayes.studies.closed_loop import simulate_request

BIAS = "rwa1: -1118 -> 626, rwa2: 1290 -> 1300, rwa4: 330 -> -729"
PULSES = ("tau_delay_s", "tau_rise_s", "tau_fall_s")
WHEELS = (1, 2, 4)
LEAK, FACTOR = "thruster_leak_z3_leak_n", "thruster_degraded_z4_thrust_factor"
STILL = frozenset({"rates at the ends", "thrust of the event"})


def model_with(*names: str) -> Model:
    """The totals model of the eight events with some effects."""
    events, priors = flights()
    return build_model(events, priors, effects=fitted_effects(names, priors, WHEELS, standard()))


def learned_with(sizes: Mapping[str, float], *names: str) -> Learned:
    """What the eight events teach where effects are known to have these sizes, by parameter."""
    events, _ = flights()
    model, known = model_with(*names), physics()
    sized = {**known.parameters, **{key: np.full(SIZE, value) for key, value in sizes.items()}}
    assert set(model.space.names) <= set(sized)
    drawn = replace(known, parameters=sized)
    return learn(model, events, drawn, beliefs(), np.random.default_rng(4), SIZE)


def predicted(learned: Learned) -> Prediction:
    """The first event's bias with nothing drawn at its ends and no departure of thrust."""
    return predict(learned, request_of(flights()[0][0]), np.random.default_rng(7), STILL)


def balance(learned: Learned, found: Prediction) -> tuple[Array, Array, Array]:
    """Lever arms (n, 3, K), thrust and on-time (n, K), what the wheels ask (n, 3), by hand."""
    event, drawn, craft = flights()[0][0], learned.physics, learned.model.spacecraft
    values = {k: np.broadcast_to(v, (SIZE,)) for k, v in drawn.parameters.items()}
    rate = learned.pulses.coefficients[:, :1]
    times = (values[name][:, None] for name in PULSES)
    shape = learned.model.totals_rows.pulse_shape
    effective = effective_on_time(shape, found.on_time_s, found.on_time_s * rate, *times)
    trend = learned.thrust_trend
    moved = float((trend.at(event.epoch) - trend.centre).mean())
    weights = wheel_axes(craft, values) * wheel_inertias(craft, values)[:, None, :]
    places = [[w.number for w in craft.wheels].index(n) for n in event.wheels]
    change = (event.rwa_end_rpm - event.rwa_start_rpm) * RAD_S_PER_RPM
    arms = lever_arms(craft, learned.model.branch, values)
    return arms, drawn.level_n + moved, effective, weights[:, :, places] @ change


def test_thrusters_make_up_for_a_leak() -> None:
    """Σ q F s + q_z3 F_leak D = ΔH: without the leak's part the balance is off by newton metres."""
    known = learned_with({LEAK: 5e-3}, "thruster_leak:z3")
    found = predicted(known)
    arms, thrust, effective, wanted = balance(known, found)
    given = (arms @ (thrust * effective)[..., None])[..., 0]
    leaked = 5e-3 * arms[:, :, known.model.thrusters.index("z3")] * found.duration_s[:, None]
    np.testing.assert_allclose(given + leaked, wanted, atol=1e-6)
    assert np.abs(given - wanted).max() > 1.0


def test_a_weak_thruster_fires_longer() -> None:
    """Its level counts by its factor: the balance closes with it and not without."""
    known = learned_with({FACTOR: 0.75}, "thruster_degraded:z4")
    found = predicted(known)
    arms, thrust, effective, wanted = balance(known, found)
    lost = np.where(np.array(known.model.thrusters) == "z4", 0.25, 0.0) * known.physics.level_n
    given = (arms @ ((thrust - lost) * effective)[..., None])[..., 0]
    np.testing.assert_allclose(given, wanted, atol=1e-6)
    assert np.abs((arms @ (thrust * effective)[..., None])[..., 0] - wanted).max() > 0.1


def test_an_effect_of_no_size_changes_no_prediction() -> None:
    """A leak of zero and a factor of one: draws of the standard physics, to rounding."""
    none = learned_with({LEAK: 0.0, FACTOR: 1.0}, "thruster_leak:z3", "thruster_degraded:z4")
    standard = learned_with({})
    np.testing.assert_allclose(predicted(none).on_time_s, predicted(standard).on_time_s, atol=1e-9)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a run that has fitted a leak and a warm-up by name."""
    folder = tmp_path_factory.mktemp("run") / "leak"
    folder.mkdir()
    model = model_with("thruster_leak:z3", "thrust_warmup")
    rng = np.random.default_rng(6)
    z = 0.3 * rng.standard_normal((1, SIZE, model.space.dimension))
    save_fit(build_fit(model, z, np.zeros((1, SIZE)), rng, {"seed": 6}, 50), folder / "fit.nc")
    table = {
        "events": [str(FLIGHT)],
        "source": "flight",
        "priors": str(B_BRANCH),
        "model": {"effects": ["thruster_leak:z3", "thrust_warmup"]},
    }
    (folder / "resolved.toml").write_text(tomli_w.dumps(table))
    return folder


def test_a_run_with_effects_is_predicted_and_planned_from(run: Path) -> None:
    """Its effects are in the model, can be asked about, and what totals cannot have is said."""
    found = cb.predict(run, BIAS)
    assert [e.name for e in found.learned.model.effects] == ["thruster_leak:z3", "thrust_warmup"]
    assert any("predicted without thrust_warmup" in sentence for sentence in found.warnings)
    plan = cb.plan(run, "thruster_leak_z3_leak_n", levels=1, top=2)
    assert isinstance(plan, PlanResult)
    assert plan.plan.sd_before > 0.0
    assert "predicted without thrust_warmup" in plan.warnings[0]


def test_effects_that_nothing_has_are_named(run: Path, tmp_path: Path) -> None:
    """An own effect whose file was not given; the closed loop flies the standard physics only."""
    other = tmp_path / "run"
    other.mkdir()
    for name in ("fit.nc", "resolved.toml"):
        (other / name).write_bytes((run / name).read_bytes())
    text = (other / "resolved.toml").read_text().replace("thruster_leak:z3", "plume:z3")
    (other / "resolved.toml").write_text(text)
    with pytest.raises(InputError, match="'plume:z3'"):
        read_sources(other / "fit.nc")
    found = cb.predict(run, BIAS)
    with pytest.raises(InputError, match="one with thruster_leak:z3, thrust_warmup"):
        simulate_request(found.learned, found.predictions[0].request, 1, 1)


def write_diagnosis(folder: Path, *own_effects: Path) -> Path:
    """The folder of a diagnosis that names a leak, with files of effects in its record."""
    model, rng = model_with("thruster_leak:z3"), np.random.default_rng(6)
    z = 0.3 * rng.standard_normal((1, SIZE, model.space.dimension))
    own = {"seed": 6, "causes": "thruster_leak:z3"}
    (folder / "extended").mkdir()
    save_fit(build_fit(model, z, np.zeros((1, SIZE)), rng, own, 50), folder / "extended/fit.nc")
    table = {"events": [str(FLIGHT)], "priors": str(B_BRANCH), "source": "flight"}
    table |= {"own_effects": [str(path) for path in own_effects]} if own_effects else {}
    (folder / "resolved.toml").write_text(tomli_w.dumps(table))
    (folder / "diagnosis.json").write_text("{}")
    return folder / "extended" / "fit.nc"


def test_the_extended_fit_of_a_diagnosis_says_its_causes_itself(tmp_path: Path) -> None:
    """Events and priors are those of the diagnosis's folder, the causes an attribute of the fit."""
    write_diagnosis(tmp_path)
    found = cb.predict(tmp_path, BIAS)
    assert [effect.name for effect in found.learned.model.effects] == ["thruster_leak:z3"]
    same = cb.predict(tmp_path / "extended", BIAS)
    np.testing.assert_array_equal(same.predictions[0].on_time_s, found.predictions[0].on_time_s)


def test_no_code_runs_because_a_folder_names_it(tmp_path: Path) -> None:
    """A file of effects in a record is asked for and stays unread; given (control), it runs."""
    evil, marker = tmp_path / "evil.py", tmp_path / "marker"
    evil.write_text(f"open({str(marker)!r}, 'w').close()\n")
    fit = write_diagnosis(tmp_path, evil)
    with pytest.raises(InputError, match=r"look at what they do, and add --effects .*evil\.py"):
        read_sources(fit)
    with pytest.raises(InputError, match=r"none named evil\.py"):
        cb.predict(tmp_path, BIAS)
    assert not marker.exists()
    with pytest.raises(InputError, match="KIND"):
        read_sources(fit, effect_files=[evil])
    assert marker.exists()


def test_files_of_effects_are_those_of_the_fit(tmp_path: Path) -> None:
    """A table given again is taken, also from elsewhere; with other content it is refused."""
    table, moved = tmp_path / "own.toml", tmp_path / "moved" / "own.toml"
    moved.parent.mkdir()
    text = "[causes]\nnone = 0.8\ncatalogued = 0.15\nunknown = 0.05\n"
    for path in (table, moved):
        path.write_text(text)
    fit = write_diagnosis(tmp_path, table)
    record = {"sha256": {str(table): digest(table)}}
    (tmp_path / "provenance.json").write_text(json.dumps(record))
    sources = read_sources(fit, effect_files=[moved])
    assert [effect.name for effect in sources.model.effects] == ["thruster_leak:z3"]
    moved.write_text(text.replace("0.15", "0.10").replace("0.05", "0.10"))
    with pytest.raises(InputError, match=r"moved/own\.toml: expected the file as it was when"):
        read_sources(fit, effect_files=[moved])
