"""Drafted effects: what was hidden is drafted and scored, nothing where nothing is hidden."""

from __future__ import annotations

import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from cassini_bayes.balance.linearised import InnovationRows, Linear, information
from cassini_bayes.balance.part_columns import ColumnsByPart
from cassini_bayes.diagnosis.case import Weighed
from cassini_bayes.diagnosis.drafts import Draft, _Candidate, _Information, drafted, drafts_of
from cassini_bayes.diagnosis.hypotheses import compact, extend, none_hypothesis
from cassini_bayes.diagnosis.modes import find_mode
from cassini_bayes.diagnosis.search import search_from_starts
from cassini_bayes.effects.registry import read_kinds
from cassini_bayes.priors.reader import read_priors
from cassini_bayes.report.draft_file import write_drafts
from cassini_bayes.simulation import scenario_of
from cassini_bayes.studies.blind.flights import reduced
from cassini_bayes.studies.scenario import simulate_file

ROOT = Path(__file__).parents[2]
SCENARIO = ROOT / "runs" / "scenarios" / "calibration.toml"
N, EVENTS = 300, 4
Hidden = dict[str, np.ndarray]


def flight(hidden: np.ndarray, seed: int) -> tuple[Linear, list[InnovationRows], list[np.ndarray]]:
    """Events of white rows whose initial momentum is free, with momentum (n, 3) hidden in each.

    One thruster fires in bursts and gives momentum about X.
    """
    rng = np.random.default_rng(seed)
    time = np.arange(N, dtype=float)
    rows, thrusts, target = [], [], []
    for place in range(EVENTS):
        on_time = np.cumsum(0.125 * (rng.random(N) < 0.1))[:, None]
        wheel = np.stack([100.0 * np.sin(time / (40 + 9 * place + k)) for k in range(3)], axis=1)
        white = rng.standard_normal((N, 3)) + hidden
        attitude = np.tile([0.0, 0.0, 0.0, 1.0], (N, 1))
        rows.append(
            InnovationRows(
                event=f"e{place}",
                time_s=time,
                white=white,
                residual_n_m_s=white,
                rate_rad_s=np.zeros((N, 3)),
                wheel_rad_s=wheel,
                on_time_s=on_time,
                wheels=(1, 2, 4),
                thrusters=("z1",),
                noise_factor=np.eye(3),
                attitude=attitude,
            )
        )
        thrusts.append(np.einsum("nk,c->nck", on_time, np.eye(3)[0]))
        target.append(white.ravel())
    columns = np.kron(np.eye(EVENTS), np.tile(np.eye(3), (N, 1)))
    precision = np.full(3 * EVENTS, 1e-4)
    by_event = ColumnsByPart.of(columns, [3 * N] * EVENTS)
    return Linear(np.concatenate(target), by_event, precision), rows, thrusts


def drafts(hidden: np.ndarray, seed: int = 1) -> tuple[Draft, ...]:
    """Of such a flight, at a common thrust of 1 N."""
    linear, rows, thrusts = flight(hidden, seed)
    return drafts_of(linear, rows, np.zeros(0), thrusts, 1.0)


def about(axis: int, series: np.ndarray) -> np.ndarray:
    """A series as momentum (n, 3) about an axis."""
    return series[:, None] * np.eye(3)[axis]


def test_a_step_is_drafted_where_it_is_and_predicts_what_was_held_out() -> None:
    """Two units about Y from t = 120 s on: form, axis, time to half a grid step, size to 3 σ."""
    best = drafts(about(1, 2.0 * (np.arange(N) >= 120)))[0]
    assert (best.form, best.target) == ("jump", "y")
    assert abs(best.numbers["start_s"] - 120.0) < 12.0
    ((size, sd),) = best.sizes.values()
    assert abs(size - 2.0) < 0.1 + 3.0 * sd
    assert best.is_gain
    assert "step" in best.words


def test_an_oscillation_of_other_phases_is_drafted_at_its_frequency() -> None:
    """A line at 0.21 Hz about Z: its phase differs from event to event, its frequency does not."""
    best = drafts(about(2, 0.7 * np.sin(2.0 * np.pi * 0.21 * np.arange(N))))[0]
    assert (best.form, best.target) == ("oscillation", "z")
    assert best.numbers["frequency_hz"] == pytest.approx(0.21, abs=1.0 / N)
    assert best.is_gain


def test_a_torque_between_two_times_is_drafted() -> None:
    """A tenth a second about X from 60 to 180 s."""
    best = drafts(about(0, 0.1 * np.clip(np.arange(N) - 60.0, 0.0, 120.0)))[0]
    assert (best.form, best.target) == ("torque", "x")
    assert abs(best.numbers["start_s"] - 60.0) < 24.0
    assert abs(best.numbers["stop_s"] - 180.0) < 24.0


def test_a_step_long_after_the_epoch_is_drafted_where_it_is() -> None:
    """Rows from an hour on: times lie between the first row and the last, 12 s apart.

    Laid from the epoch on, all but two of them would lie before the first row.
    """
    linear, rows, thrusts = flight(about(1, 2.0 * (np.arange(N) >= 120)), 1)
    later = [replace(event, time_s=event.time_s + 3_600.0) for event in rows]
    best = drafts_of(linear, later, np.zeros(0), thrusts, 1.0)[0]
    plain = drafts_of(linear, rows, np.zeros(0), thrusts, 1.0)[0]
    assert (best.form, best.target) == ("jump", "y")
    assert best.numbers["start_s"] == pytest.approx(3_600.0 + plain.numbers["start_s"])
    assert abs(best.numbers["start_s"] - 3_720.0) < 12.0
    assert best.gain == pytest.approx(plain.gain)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_nothing_hidden_gives_no_gain(seed: int) -> None:
    """Negative control: of white rows no form predicts what was held out."""
    assert not any(draft.is_gain for draft in drafts(np.zeros((N, 3)), seed))


def test_the_change_of_evidence_is_that_of_two_normal_densities() -> None:
    """Δ(a) against scipy's multivariate normal with and without the columns' covariance."""
    rng = np.random.default_rng(3)
    columns, white, target = rng.normal(size=(24, 3)), rng.normal(size=(24, 2)), rng.normal(size=24)
    linear = Linear(target, ColumnsByPart.of(columns, [24]), np.array([0.5, 2.0, 1.0]))
    told = _Information.on(information(linear, target, white))
    plain = np.eye(24) + columns @ np.diag(1.0 / linear.precision) @ columns.T
    a = 0.7
    expected = multivariate_normal(cov=plain + a**2 * white @ white.T).logpdf(target)
    expected -= multivariate_normal(cov=plain).logpdf(target)
    assert told.change(_Candidate("", {}, (0, 1)), a) == pytest.approx(expected, abs=1e-9)
    one = (white[:, 0] - white[:, 1])[:, None]
    expected = multivariate_normal(cov=plain + a**2 * one @ one.T).logpdf(target)
    expected -= multivariate_normal(cov=plain).logpdf(target)
    assert told.change(_Candidate("", {}, (0,), (1,)), a) == pytest.approx(expected, abs=1e-9)


def test_what_a_cause_leaves_is_drafted_beside_it() -> None:
    """Z2 at 60 % is named, and a surge of all thrusters beside it: the draft is the surge alone."""
    priors = read_priors(ROOT / "priors" / "cassini_b_branch_telemetry.toml")
    document = tomllib.loads(SCENARIO.read_text(encoding="utf-8"))
    document["event"] = [e for e in document["event"] if e["id"] == "bias-1"]
    surge = {"thrust_fraction": 0.06, "start_s": 400.0, "decay_s": 300.0}
    document["effect"] = [
        {"name": "thruster_degraded:z2", "parameters": {"thrust_factor": 0.6}},
        {"name": "pressure_surge", "parameters": surge},
    ]
    events = reduced(
        simulate_file(scenario_of(document, SCENARIO.parent), 11, priors=priors), priors
    )
    full = none_hypothesis(events)
    base = find_mode(compact(full).log_density, full.dimension)
    cause = compact(extend(full, [events.catalogue.effect("thruster_degraded:z2")]))
    mode = search_from_starts(cause, base).mode
    best = drafted(events, Weighed(cause, mode, mode.log_evidence))[0]
    assert (best.form, best.target) == ("thrust", "all")
    assert best.numbers["start_s"] == pytest.approx(400.0, abs=60.0)
    ((share, _),) = best.sizes.values()
    assert 0.03 < share < 0.06  # the mean of what decays
    assert best.gain > 100.0


def made_up(form: str, numbers: dict[str, float], sizes: list[str]) -> Draft:
    """A draft that gains."""
    target = {"thrust": "all", "wheel": "2"}.get(form, "y")
    return Draft(form, target, numbers, dict.fromkeys(sizes, (0.1, 0.01)), 50.0, 5.0, "event")


@pytest.mark.parametrize(
    "draft",
    [
        made_up("jump", {"start_s": 12.0}, ["momentum_n_m_s"]),
        made_up("torque", {"start_s": 12.0, "stop_s": np.inf}, ["torque_n_m"]),
        made_up("thrust", {"start_s": 12.0, "stop_s": 80.0}, ["thrust_share"]),
        made_up("oscillation", {"frequency_hz": 0.21}, ["amplitude_n_m_s"]),
        made_up("wheel", {"power": 2, "place": 1}, [f"momentum_{a}_n_m_s" for a in "xyz"]),
    ],
    ids=lambda draft: draft.form,
)
def test_the_file_of_a_draft_is_an_effect(draft: Draft, tmp_path: Path) -> None:
    """Every form's file is taken by --effects as it is, with its table."""
    write_drafts((draft,), tmp_path)
    kinds = read_kinds([tmp_path / f"{draft.name}.py"])
    kind, table = next(pair for pair in kinds.kinds if pair[0].name == draft.name)
    assert kind.columns is not None
    assert all(column.name.startswith(draft.name) for column in kind.columns(("z1", "z2")))
    assert len(table.parameters) == (2 if draft.form == "oscillation" else len(draft.sizes))
