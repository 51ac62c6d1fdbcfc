"""From a scenario file to event folders: repeatable, complete, and strict at the door."""

from __future__ import annotations

import json
import subprocess
import sys
import tomllib
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from simulation_cases import EFFECT_CASES

from cassini_bayes.computing.arrays import Array
from cassini_bayes.errors import InputError
from cassini_bayes.events.totals import read_totals
from cassini_bayes.model.draws import draw
from cassini_bayes.model.event_reduction import ReducedEvent, reduce_event
from cassini_bayes.model.posterior import build_model, log_posterior
from cassini_bayes.priors.reader import Priors, read_priors
from cassini_bayes.sampling.warmstart import warm_start
from cassini_bayes.simulation import ScenarioFile, read_scenario, scenario_of
from cassini_bayes.spacecraft import load_spacecraft
from cassini_bayes.studies import scenario
from cassini_bayes.studies.scenario import draw_truth, simulate_file, simulate_scenario

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "runs" / "scenarios"
TEXT = """\
step_s = 0.005

[spacecraft]
name = "cassini"
branch = "B"
wheels = [1, 2, 4]

[truth]
draw_from = "PRIORS"
mass_kg = 2380.0
tau_fall_s = 0.05

[telemetry]
rate_noise_rad_s = 1e-6
wheel_noise_rpm = 0.2
delta_v = "measured"

[[event]]
id = "one"
kind = "bias"
epoch = 2010-05-01T00:00:00Z
from_rpm = [-300.0, 200.0, 100.0]
to_rpm = [100.0, -100.0, 50.0]

[[event]]
id = "two"
kind = "slew"
epoch = 2010-05-02T00:00:00Z
from_rpm = [100.0, -100.0, 50.0]
settle_s = 50.0

[[event.slew]]
start_s = 10.0
axis = [1.0, 0.0, 0.0]
angle_rad = 0.05
rate_rad_s = 1e-3
acceleration_rad_s2 = 1e-5
"""
NO_TILT = {"rwa4_tilt_u_rad": 0.0, "rwa4_tilt_v_rad": 0.0}
EFFECT = """
[[effect]]
name = "thruster_leak:z3"
parameters = { leak_n = 0.004 }
"""


def written(folder: Path, text: str = TEXT) -> Path:
    """A scenario file in a folder, with the real priors file behind it."""
    path = folder / "scenario.toml"
    priors = ROOT / "priors" / "cassini_b_branch_2010.toml"
    path.write_text(text.replace("PRIORS", priors.as_posix()), encoding="utf-8")
    return path


def files(folder: Path) -> dict[str, bytes]:
    """Content of every file below a folder."""
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def test_the_same_seed_gives_the_same_bytes(tmp_path: Path) -> None:
    """Twice the same scenario and seed; another seed differs."""
    path = written(tmp_path)
    for name, seed in (("a", 1), ("b", 1), ("c", 2)):
        simulate_scenario(path, tmp_path / name, seed)
    first, second, third = (files(tmp_path / name) for name in "abc")
    assert first == second
    assert set(first) == {
        "one/event.toml",
        "one/telemetry.csv",
        "two/event.toml",
        "two/telemetry.csv",
        "totals.csv",
        "truth.json",
    }
    assert first["one/telemetry.csv"] != third["one/telemetry.csv"]


def columns_of(document: dict[str, Any], folder: str, seed: int) -> dict[str, Array]:
    """Telemetry of the first event, simulated in memory; can run in a worker process."""
    file = scenario_of(document, folder)
    return dict(simulate_file(file, seed).events[0].telemetry.columns)


def test_a_scenario_in_memory_is_the_one_of_the_file(tmp_path: Path) -> None:
    """A mapping gives the file's arrays, here and in another process, and leaves no file behind."""
    path = written(tmp_path)
    document = tomllib.loads(path.read_text("utf-8"))
    expected = dict(simulate_file(read_scenario(path), 5).events[0].telemetry.columns)
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as workers:
        away = workers.submit(columns_of, document, str(tmp_path), 5).result()
    for found in (columns_of(document, str(tmp_path), 5), away):
        assert set(found) == set(expected)
        for name, values in expected.items():
            np.testing.assert_array_equal(found[name], values)
    assert [entry.name for entry in tmp_path.iterdir()] == ["scenario.toml"]


def test_the_example_of_the_documentation_runs() -> None:
    """The first Python block of docs/topics/simulation.md, as it stands there."""
    text = (ROOT / "docs" / "topics" / "simulation.md").read_text("utf-8")
    example = text.split("```python\n")[1].split("```")[0]
    check = "\nassert event.telemetry.columns['rwa4_rpm'].shape == event.telemetry.time_s.shape\n"
    done = subprocess.run(
        [sys.executable, "-c", example + check],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr


def test_a_truth_at_hand_is_used_and_checked(tmp_path: Path) -> None:
    """Given parameters are those simulated; a missing one, or a thrust below 0, is refused."""
    file = read_scenario(written(tmp_path))
    priors = read_priors(ROOT / "priors" / "cassini_b_branch_2010.toml")
    truth = draw_truth(file, 1, priors)
    assert truth == draw_truth(file, 1)
    moved = replace(truth, parameters={**truth.parameters, "cm_x_m": 0.2})
    simulation = simulate_file(file, 1, truth=moved)
    assert simulation.truth()["parameters"]["cm_x_m"] == 0.2
    without = {name: value for name, value in moved.parameters.items() if name != "cm_x_m"}
    with pytest.raises(InputError, match="cm_x_m"):
        simulate_file(file, 1, truth=replace(truth, parameters=without))
    weak = replace(truth, individual_n=dict.fromkeys(truth.individual_n, -1.0))
    with pytest.raises(InputError, match="above 0"):
        simulate_file(file, 1, truth=weak)


def test_priors_of_another_branch_are_refused(tmp_path: Path) -> None:
    """Negative control of the ``priors`` argument."""
    other = read_priors(ROOT / "priors" / "cassini_a_branch_2005.toml")
    with pytest.raises(InputError, match="another branch"):
        draw_truth(read_scenario(written(tmp_path)), 1, other)


def test_the_truth_is_told_beside_the_events_and_not_in_them(tmp_path: Path) -> None:
    """truth.json has format, seed, parameters and effects; no event folder names the effect."""
    simulation = simulate_scenario(written(tmp_path, TEXT + EFFECT), tmp_path / "out", 7)
    truth = json.loads((tmp_path / "out" / "truth.json").read_text())
    assert truth["format"] == 1
    assert truth["seed"] == 7
    assert truth["effects"] == [{"name": "thruster_leak:z3", "parameters": {"leak_n": 0.004}}]
    assert truth["parameters"]["tau_fall_s"] == 0.05
    plan = simulation.events[0].plan
    assert truth["events"]["one"]["thrust_n"] == dict(plan.thrust_n)
    assert truth["parameters"]["cm_x_m"] == plan.parameters["cm_x_m"]
    for name, content in files(tmp_path / "out").items():
        if name != "truth.json":
            assert b"leak" not in content


def test_an_effect_does_not_change_what_is_drawn(tmp_path: Path) -> None:
    """Truth, start and rate noise are the same with and without an effect."""
    plain = simulate_file(read_scenario(written(tmp_path)), 3)
    leaky = simulate_file(read_scenario(written(tmp_path, TEXT + EFFECT)), 3)
    for a, b in zip(plain.events, leaky.events, strict=True):
        assert a.plan.parameters == b.plan.parameters
        assert a.plan.thrust_n == b.plan.thrust_n
        np.testing.assert_array_equal(a.motion.attitude[0], b.motion.attitude[0])
        noise = [e.telemetry.columns["rate_x_rad_s"] - e.motion.rate_rad_s[:, 0] for e in (a, b)]
        np.testing.assert_allclose(noise[0], noise[1], atol=1e-15)
        assert np.std(noise[0]) > 5e-7


def test_an_effect_on_the_slowest_wheel_keeps_duration_and_knowledge(tmp_path: Path) -> None:
    """A heavier wheel takes longer to arrive, but rows stay; draws do not shift in time."""
    document = tomllib.loads(written(tmp_path).read_text("utf-8"))
    plain = simulate_file(scenario_of(document), 3)
    heavier = {"rwa1_inertia_kg_m2": 1.1 * plain.events[0].plan.parameters["rwa1_inertia_kg_m2"]}
    document["effect"] = [{"name": "wheel_inertia:1", "parameters": heavier}]
    changed = simulate_file(scenario_of(document), 3)
    for a, b in zip(plain.events, changed.events, strict=True):
        np.testing.assert_array_equal(a.telemetry.time_s, b.telemetry.time_s)
        noise = [e.telemetry.columns["rate_x_rad_s"] - e.motion.rate_rad_s[:, 0] for e in (a, b)]
        np.testing.assert_allclose(noise[0], noise[1], atol=1e-15)
    document["effect"] = []
    document["event"] = [{**document["event"][0], "duration_s": 100.0}]
    short = simulate_file(scenario_of(document), 3).events[0].motion
    whole = plain.events[0].motion
    np.testing.assert_array_equal(short.rate_rad_s, whole.rate_rad_s[: short.time_s.size])


def test_a_given_value_is_not_drawn_and_changes_no_other(tmp_path: Path) -> None:
    """Every parameter has its own stream; departures of thrust differ by thruster and event."""
    drawn = draw_truth(read_scenario(written(tmp_path)), 11)
    given = draw_truth(
        read_scenario(written(tmp_path, TEXT.replace("mass_kg", "cm_x_m = 0.2\nmass_kg"))), 11
    )
    assert given.parameters["cm_x_m"] == 0.2
    different = {
        name for name, value in drawn.parameters.items() if given.parameters[name] != value
    }
    assert different == {"cm_x_m"}
    assert len(set(drawn.individual_n.values())) == 8
    assert drawn.events["one"]["thrust_event_n"] != drawn.events["two"]["thrust_event_n"]
    assert drawn.jitter_n["one"]["z1"] != drawn.jitter_n["two"]["z1"]


def test_a_departure_of_all_events_that_is_given_is_not_drawn(tmp_path: Path) -> None:
    """``thrust_event_n`` of [truth] is what every event has, but one with its own; nothing else
    is drawn otherwise.
    """
    text = TEXT.replace("mass_kg", "thrust_event_n = 0.04\nmass_kg")
    own = text.replace('id = "two"', 'id = "two"\ntruth = { thrust_event_n = -0.02 }')
    drawn = draw_truth(read_scenario(written(tmp_path)), 11)
    for content, second in ((text, 0.04), (own, -0.02)):
        given = draw_truth(read_scenario(written(tmp_path, content)), 11)
        assert [given.of(event)["thrust_event_n"] for event in ("one", "two")] == [0.04, second]
        assert given.jitter_n == drawn.jitter_n
        assert given.individual_n == drawn.individual_n
        assert given.parameters == {**drawn.parameters, "thrust_event_n": 0.04}


def test_totals_can_be_read_back(tmp_path: Path) -> None:
    """totals.csv is a totals file of source ``simulation``, with the counters of telemetry."""
    simulation = simulate_scenario(written(tmp_path), tmp_path / "out", 1)
    (event,) = read_totals(
        tmp_path / "out" / "totals.csv", load_spacecraft("cassini"), source="simulation"
    )
    log = simulation.events[0].motion.pulses["z1"]
    assert event.id == "one"
    assert event.pulses is not None
    assert event.pulses[0] == log.width_s.size
    assert event.on_time_s[0] == pytest.approx(float(log.width_s.sum()), abs=0.006)


@pytest.mark.parametrize("name", list(EFFECT_CASES))
def test_every_effect_can_be_named_in_a_scenario(name: str, tmp_path: Path) -> None:
    """Telemetry differs; truth.json tells name, sizes, and the parameters as they were changed."""
    document = tomllib.loads(written(tmp_path).read_text("utf-8"))
    rates = {"from_rpm": [-1118.0, 1290.0, 330.0], "to_rpm": [626.0, 1300.0, -729.0]}
    document["event"] = [{**document["event"][0], **rates, "duration_s": 150.0}]
    plain = simulate_file(scenario_of(document), 3)
    values = dict(EFFECT_CASES[name])
    document["effect"] = [{"name": name, "parameters": values}]
    changed = simulate_file(scenario_of(document), 3)
    (told,) = changed.truth()["effects"]
    assert told["name"] == name
    assert {key: told["parameters"][key] for key in values} == values
    parameters = changed.truth()["parameters"]
    assert all(parameters[key] == value for key, value in values.items() if key in parameters)
    before, after = (s.events[0].telemetry.columns for s in (plain, changed))
    assert set(before) == set(after)
    assert any(not np.array_equal(before[key], after[key], equal_nan=True) for key in before)


SWING: dict[str, object] = {
    "name": "flexible_mode",
    "parameters": {
        "frequency_hz": 0.05,
        "damping": 0.01,
        "inertia_fraction": 0.02,
        "amplitude_rad_s": 2e-5,
        "axis": 2.0,
    },
}


def leak(name: str, start_s: float | None = None, *events: str) -> dict[str, object]:
    """A leak of a thruster; without a start it is there from the beginning, in all events."""
    start = {} if start_s is None else {"start_s": start_s}
    only = {"events": list(events)} if events else {}
    return {"name": f"thruster_leak:{name}", "parameters": {"leak_n": 0.004, **start}, **only}


@pytest.mark.parametrize(
    ("effects", "message"),
    [
        ([leak("z3"), leak("z3")], r"effect\.thruster_leak:z3: expected .* once .*again in one"),
        ([leak("z3", None, "two"), leak("z3")], "again in two"),
        (
            [leak("z3", 5.0), leak("z1")],
            r"effect\.thruster_leak:z1\.parameters\.start_s: expected 5, as of thruster_leak:z3",
        ),
        ([leak("z3", 5.0), leak("z1", 7.0, "two")], "leaks in two begin at once, got 7"),
    ],
)
def test_effects_that_would_take_each_others_place_are_refused(
    effects: list[dict[str, object]], message: str, tmp_path: Path
) -> None:
    """One name twice in an event, and leaks of two starts: truth.json told what was not flown."""
    document = tomllib.loads(written(tmp_path).read_text("utf-8"))
    with pytest.raises(InputError, match=message):
        scenario_of({**document, "effect": effects})


@pytest.mark.parametrize(
    "effects",
    [
        [leak("z3", 5.0, "one"), leak("z3", 7.0, "two")],
        [leak("z3", 5.0), leak("z1", 5.0)],
        [leak("z3"), leak("z1", 0.0)],
        [SWING, SWING],
    ],
)
def test_effects_that_act_as_they_are_told_are_taken(
    effects: list[dict[str, object]], tmp_path: Path
) -> None:
    """In different events, leaks that begin together, or two appendages."""
    document = tomllib.loads(written(tmp_path).read_text("utf-8"))
    assert len(scenario_of({**document, "effect": effects}).effects) == 2


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        ("accelerometer_scale_m_s", 0.0, "a number above 0"),
        ("accelerometer_scale_m_s", -1e-3, "a number above 0"),
        ("delta_v_resolution_m_s", -1.0, "0 or more"),
    ],
)
def test_a_truth_that_no_instrument_has_is_refused(
    name: str, value: float, expected: str, tmp_path: Path
) -> None:
    """Counts of a scale of zero are none, and no step is negative."""
    document = tomllib.loads(written(tmp_path).read_text("utf-8"))
    document["truth"][name] = value
    with pytest.raises(InputError, match=rf"truth\.{name}: expected {expected}"):
        scenario_of(document)


def test_a_platform_of_an_event_is_named_by_its_id(tmp_path: Path) -> None:
    """As every other key of an event is."""
    document = tomllib.loads(written(tmp_path).read_text("utf-8"))
    document["spacecraft"]["wheels"] = [1, 2, 3]
    document["event"][1]["truth"] = {"rwa4_articulation_rad": 0.5}
    with pytest.raises(InputError, match=r"scenario: event\.two\.truth\.rwa4_articulation_rad"):
        scenario_of(document)


def test_channels_each_at_its_own_rate(tmp_path: Path) -> None:
    """Rates and wheels each 4 s with on-times each 10 s; and 4 s throughout."""
    document = tomllib.loads(written(tmp_path).read_text("utf-8"))
    names = ("attitude_every_s", "rate_every_s", "wheel_every_s", "counter_every_s")
    for every in ((4.0, 4.0, 4.0, 10.0), (4.0, 4.0, 4.0, 4.0)):
        document["telemetry"].update(dict(zip(names, every, strict=True)), delta_v="none")
        seen = simulate_file(scenario_of(document), 1).events[0].telemetry
        time = seen.time_s
        for column, interval in zip(
            ("q1", "rate_x_rad_s", "rwa4_rpm", "pulses_z1"), every, strict=True
        ):
            sampled = time[~np.isnan(seen.columns[column])]
            np.testing.assert_allclose(np.diff(sampled), interval, atol=1e-9)
        assert set(np.unique(np.round(np.diff(time), 6))) == (
            {2.0, 4.0} if every[3] == 10.0 else {4.0}
        )


def wheel_scenario(folder: Path, wheels: tuple[int, ...], axis_of_wheel_4: int) -> ScenarioFile:
    """A bias with those wheels; wheel 4 parallel to wheel 1 (before 2003-07-11) or to wheel 3."""
    text = (ROOT / "cassini_bayes" / "spacecraft" / "cassini.toml").read_text("utf-8")
    blocks = text.split("[[wheel]]")
    axes = [next(x for x in block.splitlines() if x.startswith("axis")) for block in blocks[1:5]]
    blocks[4] = blocks[4].replace(axes[3], axes[axis_of_wheel_4 - 1])
    (folder / "craft.toml").write_text("[[wheel]]".join(blocks), encoding="utf-8")
    document = tomllib.loads(written(folder).read_text("utf-8"))
    document["spacecraft"] = {"branch": "B", "wheels": list(wheels), "file": "craft.toml"}
    document["truth"].update(rwa4_tilt_u_rad=0.0, rwa4_tilt_v_rad=0.0)
    document["event"] = [document["event"][0]]
    return scenario_of(document, folder)


@pytest.mark.parametrize("parallel", [1, 3])
@pytest.mark.parametrize("wheels", [(1, 2, 3), (1, 2, 4), (2, 3, 4), (4, 1, 3)])
def test_any_three_of_the_four_wheels(
    wheels: tuple[int, ...], parallel: int, tmp_path: Path
) -> None:
    """Columns in the order of the wheels; axes 120° apart, 54.7° from Z, wheel 4 where it is told
    to be; momentum kept.
    """
    truth = draw_truth(read_scenario(written(tmp_path)), 1)
    truth = replace(truth, parameters={**truth.parameters, **NO_TILT})
    file = wheel_scenario(tmp_path, wheels, parallel)
    (event,) = simulate_file(file, 1, truth=truth).events
    rpm = [name for name in event.telemetry.columns if name.startswith("rwa")]
    assert rpm == [f"rwa{n}_rpm" for n in wheels]
    azimuth = {1: 90.0, 2: 210.0, 3: 330.0}
    angles = np.radians([{**azimuth, 4: azimuth[parallel]}[n] for n in wheels])
    across = np.stack([np.cos(angles), np.sin(angles), np.full(3, np.sqrt(0.5))])
    np.testing.assert_allclose(event.motion.body.axes, np.sqrt(2.0 / 3.0) * across, atol=1e-6)
    momentum = event.motion.momentum_inertial_n_m_s()
    gain = momentum - momentum[0] - event.motion.angular_impulse_n_m_s
    assert np.abs(gain).max() < 1e-8
    assert np.ptp(event.motion.wheels_rpm, axis=0).min() > 40.0


BIAS_OF_2004 = """
[[event]]
id = "bias"
kind = "bias"
epoch = 2004-11-21T00:00:00Z
from_rpm = [-800.0, 600.0, 300.0]
to_rpm = [700.0, -500.0, 900.0]
settle_s = 100.0
"""


def test_a_burn_is_seen_by_the_accelerometer(tmp_path: Path) -> None:
    """delta_v: counters of the Z thrusters, and counts of the velocity within half a step."""
    simulation = simulate_scenario(FOLDER / "burn_2004.toml", tmp_path / "out", 2)
    (event,) = simulation.events
    toml = tomllib.loads((tmp_path / "out" / "burn" / "event.toml").read_text())
    assert toml["kind"] == "delta_v"
    assert "delta_v_source" not in toml
    columns = event.telemetry.columns
    time, counts = event.telemetry.time_s, columns["accelerometer_counts"]
    true = np.interp(time, event.motion.time_s, event.motion.delta_v_body_m_s[:, 2])
    seen = 2.0202e-3 * counts + 3e-5 * time  # appendix D: scale and bias
    assert np.nanmax(np.abs(seen - true)) <= 0.5001 * 2.0202e-3
    assert np.nanmax(np.abs(2.0202e-3 * counts - true)) > 0.02  # without the bias
    assert np.array_equal(np.unique(counts % 1.0)[:1], [0.0])
    assert np.nanmax(np.abs(counts[time < 290.0])) == 4.0  # the bias alone, before the burn
    assert true[-1] == pytest.approx(-0.15, rel=0.02)
    assert columns["on_time_z1_s"][-1] > 100.0
    assert np.nanmax(columns["tank_pressure_kpa"]) > np.nanmin(columns["tank_pressure_kpa"])
    assert not (tmp_path / "out" / "totals.csv").exists()


def fitted(events: Sequence[ReducedEvent], priors: Priors) -> tuple[Array, Array]:
    """Draws of the mean Z thrust of the first event, and of the accelerometer's bias."""
    model = build_model(events, priors)
    rng = np.random.default_rng(1)
    warm = warm_start(partial(log_posterior, model), model.space.dimension, rng, draws=1500)
    draws = draw(model, warm.draws.resample(rng, 1500), rng)
    bias = np.asarray(draws.parameters["accelerometer_bias_m_s2"])
    return draws.thrusts.thrust_n[:, 0, :4].mean(axis=1), bias


def test_accelerometer_and_momentum_give_thrust_and_bias(tmp_path: Path) -> None:
    """The burn from its folder: mean Z thrust and the bias come back, the bias to 2 µm/s².

    In one fit with a wheel bias the burn's thrust is known better, and still right.
    """
    path = tmp_path / "both.toml"
    path.write_text((FOLDER / "burn_2004.toml").read_text() + BIAS_OF_2004)
    simulate_scenario(path, tmp_path / "out", 1)
    priors = read_priors(FOLDER.parents[1] / "priors/cassini_a_branch_2004_burn.toml")
    events = [
        reduce_event(tmp_path / "out" / name, priors, "first_order") for name in ("burn", "bias")
    ]
    thrust, bias = fitted(events[:1], priors)
    assert bias.std() < 2.5e-6
    assert abs(bias.mean() - 3e-5) < 3.0 * bias.std()
    assert thrust.std() < 0.015  # of a prior of 0.05: the mass leaves 1 %
    assert abs(thrust.mean() - 0.75) < 3.0 * thrust.std()
    joint, _ = fitted(events, priors)
    assert joint.std() < 0.8 * thrust.std()
    assert abs(joint.mean() - 0.75) < 3.0 * joint.std()


def test_nothing_is_overwritten_unasked(tmp_path: Path) -> None:
    """A folder with files in it is refused; --force replaces."""
    path = written(tmp_path)
    simulate_scenario(path, tmp_path / "out", 1)
    with pytest.raises(InputError, match="--force"):
        simulate_scenario(path, tmp_path / "out", 2)
    simulate_scenario(path, tmp_path / "out", 2, force=True)
    assert json.loads((tmp_path / "out" / "truth.json").read_text())["seed"] == 2


@pytest.mark.parametrize("kind", ["folder", "file", "link"])
def test_what_is_no_event_is_never_replaced(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    """A folder, file or link of the user's that has an event's id: refused before anything is
    simulated, written or removed. Once it is away, what an earlier simulation left is replaced.
    """
    out = tmp_path / "out"
    path = written(tmp_path)
    (out / "one").mkdir(parents=True)
    (out / "one" / "event.toml").write_text("earlier")
    mine = {"folder": out / "two" / "index.md", "file": out / "two", "link": tmp_path / "mine"}
    mine[kind].parent.mkdir(exist_ok=True)
    mine[kind].write_text("mine")
    if kind == "link":
        (out / "two").symlink_to(out / "one")
    before = files(out)
    with monkeypatch.context() as patched:
        patched.setattr(scenario, "simulate_file", None)
        with pytest.raises(InputError, match=r"out/two: expected nothing, or an event folder"):
            simulate_scenario(path, out, 1, force=True)
    assert files(out) == before
    (out / "two").rename(tmp_path / "moved")
    simulate_scenario(path, out, 1, force=True)
    assert "earlier" not in (out / "one" / "event.toml").read_text()


def test_totals_of_the_user_are_never_replaced(tmp_path: Path) -> None:
    """Those that have no truth beside them are no simulation's."""
    path, mine = written(tmp_path), tmp_path / "out" / "totals.csv"
    mine.parent.mkdir()
    mine.write_text("mine")
    with pytest.raises(InputError, match=r"totals.csv: expected nothing, or that of an earlier"):
        simulate_scenario(path, mine.parent, 1, force=True)
    assert [own.name for own in mine.parent.iterdir()] == ["totals.csv"]
    assert mine.read_text() == "mine"


@pytest.mark.parametrize("path", sorted(FOLDER.glob("*.toml")), ids=lambda path: path.stem)
def test_the_shipped_scenarios_can_be_read(path: Path) -> None:
    """Every scenario of the repository passes the door and has a complete truth."""
    draw_truth(read_scenario(path), 1)


OTHER_SLEW = """\
[[event.slew]]
start_s = 0.0
axis = [0.0, 1.0, 0.0]
angle_rad = 0.05
rate_rad_s = 1e-3
acceleration_rad_s2 = 1e-5

"""
BAD = (
    ("[truth]", "[truht]", "truth"),
    ('kind = "bias"', 'kind = "bais"', "bias"),
    ('id = "two"', 'id = "one"', "rename"),
    ("to_rpm = [100.0, -100.0, 50.0]", "to_rpm = [100.0, -100.0]", "3 rates"),
    ("to_rpm = [100.0, -100.0, 50.0]", "to_rpm = [100.0, -5000.0, 50.0]", "within ±4000 rev/min"),
    ("to_rpm = [100.0, -100.0, 50.0]\n", "", "add to_rpm"),
    ("tau_fall_s = 0.05", "tau_fal_s = 0.05", "tau_fall_s"),
    ("tau_fall_s = 0.05", "tau_fall_s = nan", "finite"),
    ("tau_fall_s = 0.05", "tau_fall_s = -0.05", "0 or more"),
    ("tau_fall_s = 0.05", 'tau_fall_s = "50 ms"', "number"),
    ("mass_kg = 2380.0\n", "", "add mass_kg"),
    ("wheel_noise_rpm = 0.2", "wheel_noise_rmp = 0.2", "wheel_noise_rpm"),
    ("wheel_noise_rpm = 0.2", "wheel_noise_rpm = -0.2", "greater than or equal"),
    ('branch = "B"', 'branch = "C"', "branch"),
    ('branch = "B"', 'branch = "A"', "another branch"),
    ("wheels = [1, 2, 4]", "wheels = [1, 2, 2]", "different wheels"),
    ('name = "cassini"', 'name = "casini"', "cassini"),
    ('name = "cassini"\n', "", "neither"),
    ("axis = [1.0, 0.0, 0.0]", "axis = [0.0, 0.0, 0.0]", "give an axis"),
    ("angle_rad = 0.05", "angle_deg = 0.05", "angle_rad"),
    ("step_s = 0.005", "step_s = 0.007", "divides"),
    ("2010-05-01T00:00:00Z", "2010-05-01T00:00:00", "UTC"),
    ('draw_from = "PRIORS"', 'draw_from = "nowhere.toml"', "no such file"),
    ("step_s = 0.005", "step_s = = 3", "TOML"),
    ("step_s = 0.005", "step_s = true", "number"),
    ("step_s = 0.005", "step_s = 1e-300", "greater than"),
    ("wheels = [1, 2, 4]", 'wheels = ["1", 2, 4]', "integer"),
    ("wheel_noise_rpm = 0.2", 'wheel_noise_rpm = "0.2"', "number"),
    ("wheel_noise_rpm = 0.2", "wheel_noise_rpm = 1e308", "less than"),
    ("wheel_noise_rpm = 0.2", "counter_every_s = 0.0", "counter_every_s"),
    ("mass_kg = 2380.0", "mass_kg = 0.0", "above 0"),
    ("mass_kg = 2380.0", "inertia_xx_kg_m2 = -6500.0", "above 0"),
    ("mass_kg = 2380.0", "mass_kg = 2380.0\ninertia_xx_kg_m2 = 1e-6", "positive definite"),
    ("mass_kg = 2380.0", "thrust_individual_n = { z9 = 0.1 }", "z"),
    ("tau_fall_s = 0.05", "thrust_individual_n = { z3 = -2.0 }", "above 0"),
    ("mass_kg = 2380.0", "thrust_individual_n = 0.1", "by thruster"),
    ("mass_kg = 2380.0", "thrust_jitter_n = 0.1", "by thruster"),
    ("[[event.slew]]", OTHER_SLEW + "[[event.slew]]", "after the end of the slew before"),
    ("settle_s = 50.0", "duration_s = 1e9", "control cycles"),
    ("settle_s = 50.0", "duration_s = 1e-3", "control cycles"),
    ("settle_s = 50.0", "attitude = [0.0, 0.0, 0.0, 0.5]", "unit norm"),
    ('id = "two"', 'id = "../two"', "pattern"),
    ('id = "two"', 'id = "truth.json"', "rename"),
    ("wheels = [1, 2, 4]", "wheels = [2, 3, 4]", "parallel"),
    ('kind = "slew"', 'kind = "quiescent"', "add duration_s"),
    ('kind = "slew"', 'kind = "delta_v"', "add delta_v_m_s"),
)


@pytest.mark.parametrize(("old", "new", "hint"), BAD)
def test_a_bad_scenario_is_one_line_that_says_what_to_mend(
    tmp_path: Path, old: str, new: str, hint: str
) -> None:
    """File, dotted key, expected, found, fix; nothing is written."""
    assert old in TEXT
    path = written(tmp_path, TEXT.replace(old, new, 1))
    with pytest.raises(InputError, match=hint) as caught:
        simulate_scenario(path, tmp_path / "out", 1)
    assert "\n" not in str(caught.value)
    assert caught.value.exit_code == 2
    assert not (tmp_path / "out").exists()


def test_a_motion_that_the_step_cannot_follow_is_refused(tmp_path: Path) -> None:
    """A mode far faster than the step overflows: one line instead of NaN in the telemetry."""
    mode = (
        '\n[[appendage]]\nname = "stiff"\naxis = [1.0, 0.0, 0.0]\ninertia_kg_m2 = 10.0\n'
        "frequency_hz = 1e5\ndamping = 0.01\ninitial_rate_rad_s = 1e-3\n"
    )
    with pytest.raises(InputError, match="shorten the step"):
        simulate_scenario(written(tmp_path, TEXT + mode), tmp_path / "out", 1)


def test_a_missing_file_names_its_neighbours(tmp_path: Path) -> None:
    """A misspelt path gets the nearest file."""
    written(tmp_path)
    with pytest.raises(InputError, match=r"scenario\.toml"):
        read_scenario(tmp_path / "scenaro.toml")


def test_an_unknown_event_of_an_effect_is_refused(tmp_path: Path) -> None:
    """Effects may be confined to events that exist."""
    text = TEXT + EFFECT + 'events = ["onw"]\n'
    with pytest.raises(InputError, match="one"):
        read_scenario(written(tmp_path, text))


def test_a_negative_seed_is_refused(tmp_path: Path) -> None:
    """Seeds are whole numbers from 0."""
    with pytest.raises(InputError, match="from 0"):
        simulate_scenario(written(tmp_path), tmp_path / "out", -1)
