"""Effects fitted by name: recovered, in tables under their names; what cannot be is refused."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache, partial
from pathlib import Path

import numpy as np
import pytest
from event_cases import PRIORS, document, events, priors
from run_cases import B_BRANCH, EVENTS, FLIGHT, command, small_table, write_run
from test_joint_run import SAMPLER, do
from test_run import Silent

from cassini_bayes.diagnosis.events import prepare
from cassini_bayes.diagnosis.hypotheses import TORQUE_NOISE, extend, none_hypothesis
from cassini_bayes.diagnosis.modes import find_mode
from cassini_bayes.effects.catalogue import named_effects, read_catalogue
from cassini_bayes.effects.registry import KINDS
from cassini_bayes.errors import InputError
from cassini_bayes.model import build_model, log_posterior, observability
from cassini_bayes.pipeline.run import Outcome
from cassini_bayes.pipeline.run_file import check_run
from cassini_bayes.pipeline.sweep_run import execute_sweep
from cassini_bayes.simulation import scenario_of
from cassini_bayes.studies.scenario import simulate_file, write_simulation
from cassini_bayes.sweep.specification import SweepFile

pytestmark = pytest.mark.usefixtures("short_warm_start")
EXAMPLE = Path(__file__).parents[2] / "docs" / "examples" / "plume.py"
LEAK_N, BIAS_RAD_S = 1.0e-4, 6.0e-6
LEAK, BIAS = "thruster_leak_z3_leak_n", "rate_bias_y_rate_bias_y_rad_s"
NAMES = ("thruster_leak:z3", "rate_bias:y")
WHEELS = (1, 2, 4)


def fitted(folder: Path) -> Outcome:
    """A short fit with two effects named, of a flight that has them."""
    content = document()
    content["effect"] = [
        {"name": "thruster_leak:z3", "parameters": {"leak_n": LEAK_N}},
        {"name": "rate_bias:y", "parameters": {"rate_bias_y_rad_s": BIAS_RAD_S}},
    ]
    write_simulation(simulate_file(scenario_of(content), 7), folder)
    table = {
        "events": [str(folder / name) for name in ("bias", "slews")],
        "priors": str(PRIORS),
        "model": {"effects": list(NAMES)},
        "sampler": {**SAMPLER, "first_check": 120, "max_steps": 120},
        "output": {"report": False, "draws_per_ensemble": 500, "prior_draws": 500},
    }
    return do(table, folder / "run")[0]


def test_a_leak_and_a_gyro_bias_are_recovered_by_name(tmp_path: Path) -> None:
    """Both true sizes within three standard deviations, told to a tenth; tables name them.

    The mode of the same model on a flight without them has neither (negative control).
    """
    shown = fitted(tmp_path)
    rows = shown.review.summary.set_index("name")
    for name, truth, unit in ((LEAK, LEAK_N, "N"), (BIAS, BIAS_RAD_S, "rad/s")):
        own = rows.loc[name]
        assert own["unit"] == unit
        assert abs(own["mean"] - truth) < 3.0 * own["sd"]
        assert own["sd"] < 0.1 * truth
    nuisances = shown.review.nuisances.set_index("name")
    assert nuisances.loc[LEAK, "block"] == "effect"
    assert "lever arm" in nuisances.loc[LEAK, "source"]
    assert "thruster_leak:z3" in nuisances.loc[LEAK, "meaning"]
    assert LEAK in (shown.folder / "tables" / "nuisances.csv").read_text()
    chosen = named_effects(NAMES, priors(), WHEELS, ["telemetry"])
    model = build_model(events("bias", "slews"), priors(), effects=chosen)
    mode = find_mode(partial(log_posterior, model), model.space.dimension)
    at_mode = model.space.to_parameters(mode.point)
    assert at_mode[LEAK] < 0.1 * LEAK_N
    assert abs(at_mode[BIAS]) < 0.1 * BIAS_RAD_S


@cache
def of_every_kind() -> tuple[str, ...]:
    """One effect of every kind that telemetry shows and that needs no search."""
    catalogue = read_catalogue(priors(), WHEELS, ("telemetry",))
    names = {e.kind.name: e.name for e in catalogue.effects if not e.needs_search}
    return tuple(names.values())


@pytest.mark.parametrize("name", of_every_kind())
def test_a_fit_has_the_density_of_the_diagnosis(name: str) -> None:
    """Without torque noise the named model is the hypothesis on that cause, columns and all."""
    flown = events("bias", "slews")
    diagnosed = prepare(flown, priors())
    cause = extend(none_hypothesis(diagnosed), [diagnosed.catalogue.effect(name)])
    without_noise = priors().with_fixed(TORQUE_NOISE, 0.0)
    chosen = named_effects([name], without_noise, WHEELS, ["telemetry"])
    unmeasured = [replace(event, delta_v=None) for event in flown]
    model = build_model(unmeasured, without_noise, effects=chosen)
    z = 0.3 * np.random.default_rng(4).standard_normal((3, model.space.dimension))
    assert len(model.space.names) == len(cause.model.space.names)
    assert log_posterior(model, z) == pytest.approx(cause.log_density(z), rel=1e-9)
    assert len(KINDS) > len(of_every_kind()) > 10


def test_what_events_cannot_see_is_said() -> None:
    """A leak of slews on wheels: every column of it is empty, and the posterior is the prior."""
    chosen = named_effects(["thruster_leak:z3"], priors(), WHEELS, ["telemetry"])
    blind = observability(build_model(events("slews"), priors(), effects=chosen))
    assert blind.unseen_effects == (f"These events cannot see {LEAK}: its posterior is its prior.",)
    assert f"Effects – not seen: {LEAK}." in blind.sentences
    seeing = observability(build_model(events("bias"), priors(), effects=chosen))
    assert seeing.unseen_effects == ()


@pytest.mark.parametrize(
    ("names", "inputs", "told"),
    [
        (["thruster_leek:z3"], ["telemetry"], "did you mean 'thruster_leak:z3'"),
        (["thruster_leak:z9"], ["telemetry"], "known: thruster_leak:z1, .*y4"),
        (["rate_bias:x"], ["totals"], "'rate_bias:x', which only telemetry can"),
        (["firing_logic"], ["telemetry", "totals"], "which only on_times can"),
        (["flexible_mode"], ["telemetry"], "diagnose --then-fit"),
        (["tail_off", "tail_off"], ["totals"], "'tail_off' twice"),
    ],
)
def test_names_that_cannot_be_fitted_are_one_line(
    names: list[str], inputs: list[str], told: str
) -> None:
    """A misspelt one, one that such events cannot show, one to be searched for, one twice."""
    with pytest.raises(InputError, match=told) as caught:
        named_effects(names, priors(), WHEELS, inputs, where="model.effects")
    assert str(caught.value).startswith("model.effects: expected ")
    assert "\n" not in str(caught.value)


def test_an_effect_is_fitted_from_an_event_on() -> None:
    """Behind @: the bias does not know of a gyro error that begins with the slews, which do."""
    flown, order = events("bias", "slews"), ("bias", "slews")
    named = partial(named_effects, priors=priors(), wheels=WHEELS, inputs=["telemetry"])
    (later,), (always,) = named(["rate_bias:y@slews"], order=order), named(["rate_bias:y"])
    assert later.parameters == always.parameters
    assert "from slews on" in later.specs[0].meaning
    model, whole, plain = (
        build_model(flown, priors(), effects=own) for own in ((later,), (always,), ())
    )
    z = 0.3 * np.random.default_rng(4).standard_normal((2, model.space.dimension))
    parts = [[t.at(m.points(z)).log_likelihood for t in m.telemetry] for m in (model, whole)]
    assert parts[0][1] == pytest.approx(parts[1][1], rel=1e-12)
    (bias, _), (bias_whole, _) = model.telemetry, whole.telemetry
    own = bias.at(model.points(z)).information.constant
    assert own == pytest.approx(
        plain.telemetry[0].at(plain.points(z[:, :-1])).information.constant, rel=1e-9
    )
    assert own != pytest.approx(bias_whole.at(whole.points(z)).information.constant, rel=1e-9)


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("tail_off@slew", "did you mean 'slews'"),
        ("tail_off@bias", "it acts in all events"),
        ("tail_off@", "behind @ an event of this fit"),
    ],
)
def test_an_onset_that_is_none_is_one_line(name: str, told: str) -> None:
    """No event of the fit, with the nearest; the first one; nothing."""
    with pytest.raises(InputError, match=told) as caught:
        named_effects([name], priors(), WHEELS, ["telemetry"], order=("bias", "slews"))
    assert "\n" not in str(caught.value)


def test_a_departure_of_a_fixed_parameter_is_refused() -> None:
    """It has no width to count from."""
    fixed = priors().with_fixed("cm_x_m", 0.13)
    with pytest.raises(InputError, match=r"'center_of_mass:x', .*is fixed in"):
        named_effects(["center_of_mass:x"], fixed, WHEELS, ["telemetry"])


def test_own_effects_are_fitted_from_the_command_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """``run`` and ``fit`` take ``--effects``; its hash is kept; no run file can bring one."""
    table = small_table() | {"model": {"delta_v": "ignore", "effects": ["plume:z3"]}}
    path = write_run(tmp_path, table)
    own = ["--effects", str(EXAMPLE)]
    assert command(["run", str(path), "--out", str(tmp_path / "run"), "--quiet"]) == 2
    assert "plume:z3" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()
    assert command(["run", str(path), "--out", str(tmp_path / "run"), "--quiet", *own]) == 1
    provenance = json.loads((tmp_path / "run" / "provenance.json").read_text())
    assert {str(EXAMPLE), str(EXAMPLE.with_suffix(".toml"))} <= set(provenance["sha256"])
    assert "plume_z3_lever_m" in (tmp_path / "run" / "summary.csv").read_text()
    given = [f"{FLIGHT}:{EVENTS[0]}", "--priors", str(B_BRANCH), "--out", str(tmp_path / "fit")]
    assert command(["fit", *given, "--quiet", "--effect", "plum:z3", *own]) == 2
    assert "did you mean 'plume:z3'" in capsys.readouterr().err
    assert command(["predict", str(tmp_path / "run" / "fit.nc"), "--quiet"]) == 2


def test_a_run_with_effects_is_not_swept(tmp_path: Path) -> None:
    """Sweeps vary the parameters of the priors file, and say so."""
    run = check_run(small_table() | {"model": {"effects": ["tail_off"]}}, "test")
    rest = {"jobs": 1, "dask": None, "report": False, "reporter": Silent()}
    with pytest.raises(InputError, match="one with tail_off"):
        execute_sweep(run, Path(), tmp_path, SweepFile(), "test", **rest)
