"""Forms of unknown that go with thrusters: what is hidden so is found, and nothing else."""

from __future__ import annotations

import tomllib
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from cassini_bayes.balance.linearised import Linear, information, information_without_each
from cassini_bayes.balance.part_columns import ColumnsByPart
from cassini_bayes.diagnosis.case import NONE, UNKNOWN, Weighed
from cassini_bayes.diagnosis.events import Events
from cassini_bayes.diagnosis.hypotheses import (
    Hypothesis,
    compact,
    extend,
    none_hypothesis,
    unknown_hypothesis,
)
from cassini_bayes.diagnosis.innovations import left_by
from cassini_bayes.diagnosis.modes import Mode, highest_mode
from cassini_bayes.diagnosis.search import search_from_starts
from cassini_bayes.diagnosis.thruster_forms import (
    DRIFT,
    LEVER,
    TORQUE,
    form_columns,
    thruster_forms,
    with_forms,
    with_thruster_forms,
)
from cassini_bayes.diagnosis.verdict import Verdict, ranked, with_second_cause
from cassini_bayes.priors.reader import read_priors
from cassini_bayes.simulation import scenario_of
from cassini_bayes.studies.blind.flights import reduced
from cassini_bayes.studies.scenario import simulate_file

ROOT = Path(__file__).parents[2]
SCENARIO = ROOT / "runs" / "scenarios" / "calibration.toml"
SURGE = {"thrust_fraction": 0.1, "start_s": 400.0, "decay_s": 300.0}
HIDDEN = {
    "none": [],
    "surge": [{"name": "pressure_surge", "parameters": SURGE}],
    "plume": [{"name": "plume_impingement:z1", "parameters": {"lever_m": 0.25}}],
    "degraded": [{"name": "thruster_degraded:z2", "parameters": {"thrust_factor": 0.6}}],
}


@cache
def flown(hidden: str, event: str = "bias-1") -> tuple[Events, Weighed[Hypothesis]]:
    """One event with something hidden, and the baseline at its mode."""
    priors = read_priors(ROOT / "priors" / "cassini_b_branch_telemetry.toml")
    document = tomllib.loads(SCENARIO.read_text(encoding="utf-8"))
    document["event"] = [e for e in document["event"] if e["id"] == event]
    document["effect"] = HIDDEN[hidden]
    flight = simulate_file(scenario_of(document, SCENARIO.parent), 11, priors=priors)
    events = reduced(flight, priors)
    none = compact(none_hypothesis(events))
    mode = highest_mode(none.log_density, none.model.starts)
    return events, Weighed(none, mode, mode.log_evidence)


@pytest.mark.parametrize(
    ("hidden", "form", "other"), [("surge", DRIFT, LEVER), ("plume", LEVER, DRIFT)]
)
def test_what_goes_with_thrusters_has_its_form(hidden: str, form: str, other: str) -> None:
    """A surge of all thrusts is a drift, a plume that one of them blows a lever."""
    events, none = flown(hidden)
    forms = thruster_forms(none, events.catalogue.unknown)
    assert forms[form] > 20.0
    assert forms[form] > forms[other] + 10.0


def test_nothing_hidden_has_no_form() -> None:
    """Both cost more than they gain: what is less than their bounds is not among them."""
    events, none = flown("none")
    forms = thruster_forms(none, events.catalogue.unknown)
    assert -30.0 < forms[DRIFT] < 0.0
    assert -30.0 < forms[LEVER] < 0.0


def test_beside_the_right_cause_there_is_no_form() -> None:
    """Z2 at 60 %: a lever or a drift beside none, and neither beside the cause at its mode."""
    events, none = flown("degraded")
    assert max(thruster_forms(none, events.catalogue.unknown).values()) > 10.0
    effect = events.catalogue.effect("thruster_degraded:z2")
    cause = compact(extend(none_hypothesis(events), [effect]))
    mode = search_from_starts(cause, none.mode).mode
    beside = thruster_forms(Weighed(cause, mode, mode.log_evidence), events.catalogue.unknown)
    assert max(beside.values()) < 1.0


def test_forms_are_of_the_thrusts_of_the_cause_that_they_stand_beside() -> None:
    """Z2 at 87 % of its thrust: its lever turns the body by as much, those of others as before."""
    events, none = flown("degraded")
    effect = events.catalogue.effect("thruster_degraded:z2")
    cause = compact(extend(none_hypothesis(events), [effect]))
    at = np.r_[none.mode.point, 0.0]
    drift, (lever,) = form_columns(none.hypothesis, none.mode.point, left_by(none))
    (weak,) = effect.values(cause.model.points(at[None]).parameters).values()
    own_drift, (own_lever,) = form_columns(cause, at, left_by(none))
    ratio = np.linalg.norm(own_lever, axis=(0, 1)) / np.linalg.norm(lever, axis=(0, 1))
    thrusters = left_by(none).rows[0].thrusters
    wanted = np.where(np.array(thrusters) == "z2", weak[0], 1.0)
    assert weak[0] < 0.9
    assert ratio.reshape(-1, 3) == pytest.approx(np.tile(wanted[:, None], 3))
    assert not np.allclose(own_drift[0], drift[0])


def test_events_without_thrusters_have_no_forms() -> None:
    """Slews on wheels: torque alone, and everything weighed stays as it is."""
    events, none = flown("none", "slews")
    assert thruster_forms(none, events.catalogue.unknown) == {}
    assert with_thruster_forms([none], events.catalogue.unknown) == [none]


def made_up(hypothesis: Hypothesis, evidence: float) -> Weighed[Hypothesis]:
    """A hypothesis with some evidence."""
    return Weighed(hypothesis, Mode(np.zeros(1), np.eye(1), evidence), evidence)


def test_unknown_is_the_sum_of_its_forms() -> None:
    """A third each; those of thrusters have evidence and prior of what they stand beside."""
    events, _ = flown("none")
    unknown = made_up(unknown_hypothesis(events), -7.0)
    whole = with_forms(unknown, -2.5, {DRIFT: 4.0, LEVER: -1.0})
    wanted = np.array([-7.0, -2.5 + 4.0, -2.5 - 1.0])
    assert whole.net_evidence == pytest.approx(np.log(np.exp(wanted).mean()))
    shares = np.exp(wanted) / np.exp(wanted).sum()
    assert dict(whole.forms) == pytest.approx(
        dict(zip((TORQUE, DRIFT, LEVER), shares, strict=True))
    )
    again = with_forms(whole, -2.5, {DRIFT: 4.0, LEVER: -1.0})
    assert again.net_evidence == pytest.approx(whole.net_evidence)  # and not counted twice


class _Pairs:
    """A case with one pair of a given evidence."""

    def __init__(self, pair: Weighed[Hypothesis]) -> None:
        self.pair = pair

    def pairs(self, *_: object) -> list[Weighed[Hypothesis]]:
        return [self.pair]

    def confirmed(self, pair: Weighed[Hypothesis], _: object) -> Weighed[Hypothesis]:
        return pair


@pytest.mark.parametrize("gain", [30.0, 90.0])
def test_a_second_cause_takes_the_place_of_a_form(gain: float) -> None:
    """A pair that is more probable than unknown: what stood beside the first cause has a name."""
    events, _ = flown("none")
    full, catalogue = none_hypothesis(events), events.catalogue
    first = extend(full, [catalogue.effect("thruster_degraded:z2")])
    both = extend(full, [catalogue.effect(n) for n in ("thruster_degraded:z2", "tail_off")])
    cause, pair = made_up(first, 100.0), made_up(both, 100.0 + gain)
    unknown = with_forms(
        made_up(unknown_hypothesis(events), -50.0), cause.score, {DRIFT: 60.0, LEVER: -2.0}
    )
    verdict = ranked([made_up(full, 0.0), unknown, cause])
    assert verdict.best.name == UNKNOWN
    result: Verdict[Hypothesis] = with_second_cause(
        _Pairs(pair),  # type: ignore[arg-type]
        verdict,
        cause,
        np.random.default_rng(1),
    )
    if gain > 60.0:
        assert result.pair is pair
        assert result.best is cause
        assert result.named(UNKNOWN).net_evidence == pytest.approx(-50.0)
    else:
        assert result.pair is None
        assert result.best.name == UNKNOWN
    assert result.named(NONE).log_evidence == 0.0


def test_information_without_a_part_is_that_of_the_others() -> None:
    """One pass over all parts gives what counting the others' rows alone gives, unknowns alike."""
    rng = np.random.default_rng(4)
    columns, of_part = rng.normal(size=(36, 6)), np.repeat([0, 1, 2], 12)
    columns[of_part != 0, 4] = columns[of_part == 2, 5] = 0.0  # of one part alone, and of two
    by_part = ColumnsByPart.of(columns, [12] * 3)
    linear = Linear(rng.normal(size=36), by_part, rng.uniform(0.5, 2.0, 6))
    further = rng.normal(size=(36, 3))
    for part, told in enumerate(information_without_each(linear, linear.target, further)):
        plain = information(linear, linear.target, further, used=of_part != part)
        assert told.matrix == pytest.approx(plain.matrix, rel=1e-10)
        assert told.vector == pytest.approx(plain.vector, rel=1e-10)


@pytest.mark.parametrize("groups", [None, [0, 1, 0, 1]])
def test_information_is_that_of_the_whole_covariance(groups: list[int] | None) -> None:
    """M and h against V written out, unknowns of one group alone summed over first or not."""
    rng = np.random.default_rng(3)
    columns = rng.normal(size=(48, 7))
    halves = np.repeat([0, 1, 0, 1], 12)
    columns[halves == 0, 5] = columns[halves == 1, 6] = columns[:, 4] = 0.0
    by_part = ColumnsByPart.of(columns, [12] * 4)
    linear = Linear(rng.normal(size=48), by_part, rng.uniform(0.5, 2.0, 7))
    further, used = rng.normal(size=(48, 3)), rng.random(48) < 0.8
    for kept in (None, used):
        own = np.ones(48, dtype=bool) if kept is None else kept
        told = information(linear, linear.target, further, used=kept, groups=groups)
        x, c, y = columns[own], further[own], linear.target[own]
        v = np.eye(len(y)) + x @ np.diag(1.0 / linear.precision) @ x.T
        assert told.matrix == pytest.approx(c.T @ np.linalg.solve(v, c))
        assert told.vector == pytest.approx(c.T @ np.linalg.solve(v, y))
