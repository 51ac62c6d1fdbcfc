"""The study of mistakes: an honest draw passes, outcomes are judged, the page counts them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from study_cases import study_in
from totals_cases import flight

from cassini_bayes.events.plausibility import Nominal, departures
from cassini_bayes.events.plausibility.evidence import Evidence
from cassini_bayes.events.plausibility.rows import RowCollector
from cassini_bayes.events.plausibility.verdict import SUSPECT
from cassini_bayes.model.nominal import nominal_values
from cassini_bayes.studies.conditions import LEVELS, draw_condition
from cassini_bayes.studies.mistakes import run_mistakes
from cassini_bayes.studies.mistakes.campaign import (
    CASES,
    MOST_EVENTS,
    NO_EVENT,
    ROW_CASES,
    VERDICTS,
    Honest,
    judge_rows,
)
from cassini_bayes.studies.mistakes.flights import fly, with_events
from cassini_bayes.studies.mistakes.kinds import TELEMETRY, TOTALS, RowChange, cell_times
from cassini_bayes.studies.mistakes.oracle import (
    TELLS,
    Answer,
    Physics,
    answer_of,
    physics_of,
)
from cassini_bayes.studies.mistakes.page import outcome
from cassini_bayes.studies.study import Arrays, Study

ROOT = Path(__file__).parents[2]
SCENARIO, PRIORS = ROOT / "runs" / "scenarios" / "calibration.toml", ROOT / "priors"


def test_an_honest_draw_passes_twice_alike() -> None:
    """A draw has a random stream of its own; without mistakes nothing is refused."""
    first, again = (Honest(SCENARIO, PRIORS, seed=3).repetition(0) for _ in range(2))
    assert first["effect"] == -1
    verdicts = np.asarray(first["verdict"])
    assert set(verdicts[verdicts != NO_EVENT]) == {VERDICTS.index("passed")}
    assert all(np.array_equal(first[key], again[key]) for key in first)


@pytest.mark.usefixtures("usual_drive")
def test_cut_tails_are_no_mistake(monkeypatch: pytest.MonkeyPatch) -> None:
    """An honest bias whose controller fires all the time fits; without what tails lose it does not.

    Draw 24 of seed 9001, which was flagged.
    """
    rng = np.random.default_rng([9001, 0, 24])
    condition = draw_condition(rng)
    assert (condition.controller, condition.rates) == ("high gain, union", "ten times finer")
    flight = fly(with_events(condition, "one bias"), SCENARIO, PRIORS, rng)
    ((event, chunk),) = flight.events
    collected = RowCollector()
    collected.add(chunk)

    def misfit() -> float:
        nominal = Nominal.of(
            flight.priors.spacecraft,
            event.branch,
            event.wheels,
            nominal_values(flight.priors),
            fires=True,
        )
        return Evidence(nominal, collected.motion(), collected.rows()).misfit()

    assert misfit() < SUSPECT
    monkeypatch.setattr(departures, "WIDTHS", {**departures.WIDTHS, "cut": 1e-9})
    assert misfit() > 3.0 * SUSPECT


def test_there_are_enough_kinds() -> None:
    """Sixty in telemetry, and those of totals; each names what there is to accept."""
    assert len(TELEMETRY) >= 60
    for each in (*TELEMETRY.values(), *TOTALS.values()):
        assert set(each.names) <= set(VERDICTS)


@pytest.mark.parametrize(
    ("verdict", "moved", "nats", "word"),
    [
        ("wheel-order", np.nan, np.nan, "named"),
        ("wheel-sign", np.nan, np.nan, "wrong name"),
        ("flagged", np.nan, np.nan, "flagged"),
        ("passed", 2.9, np.nan, "harmless"),
        ("passed", 9.0, 1.9, "cannot be known"),
        ("passed", 9.0, 2.1, "missed"),
        ("passed", np.inf, np.inf, "missed"),
    ],
)
def test_outcomes(verdict: str, moved: float, nats: float, word: str) -> None:
    """Right by name, harmless below 3 σ, excused below 2 nats, and nothing else."""
    assert outcome(verdict, ("wheel-order",), moved, nats).word == word


def test_the_oracle_sees_what_matters() -> None:
    """Flight rows: wheels exchanged move thrusts and data speak against it; on-times × 1.2 do not.

    Longer on-times are a weaker thrust: with what the catalogue holds nothing tells.
    """
    rows, priors = flight()
    honest = physics_of(rows, priors)
    assert honest is not None
    for name, tells in (("first two wheels exchanged", True), ("on-times × 1.2", False)):
        wrong = [TOTALS[name].change(row) for row in rows]
        found = physics_of(wrong, priors)
        assert found is not None
        assert (honest.best - found.best > 20.0) == tells
        assert (judge_rows(wrong, priors) == "wheel-order") == tells
    answer = answer_of(rows, priors)
    assert answer is not None
    assert answer.moved(answer) == 0.0


def test_answers_are_compared_by_what_both_have() -> None:
    """Counters that a mistake stops leave rows without late pulses, and no factor of theirs."""
    late = Answer(
        {"thrust": 0.75, "late_pulse_factor": 1.0}, {"thrust": 0.01, "late_pulse_factor": 0.1}
    )
    settled = Answer({"thrust": 0.78}, {"thrust": 0.02})
    assert late.moved(settled) == pytest.approx(3.0)
    assert settled.moved(late) == pytest.approx(1.5)


def test_one_effect_is_physics_to_the_oracle() -> None:
    """A thruster's on-times × 1.3 are its thrust / 1.3, which the catalogue holds.

    Four rows without velocity changes: wide priors alone would tell, with one degraded thruster
    nothing does. Exchanged wheels are no effect: they can be known as before.
    """
    rows, priors = flight()
    rows = [replace(row, delta_v_m_s=None, delta_v_source=None) for row in rows[:4]]

    def physics(change: RowChange) -> Physics:
        found = physics_of([change(row) for row in rows], priors)
        assert found is not None
        return found

    honest, longer = physics(lambda row: row), physics(cell_times(4, 1.3))
    assert honest.log_density - longer.log_density > TELLS
    assert honest.best - longer.best < TELLS
    assert max(longer.causes, key=lambda name: longer.causes[name]) == "thruster_degraded:y1"
    exchanged = physics(TOTALS["first two wheels exchanged"].change)
    assert honest.best - exchanged.best > 10.0 * TELLS


def test_the_page_counts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Made up: one draw of four disturbed; all named in one set, all missed in the other."""
    names = [TELEMETRY[name].names for name, _ in CASES] + [TOTALS[n].names for n, _ in ROW_CASES]
    named = np.array([VERDICTS.index(each[0]) if each else 0 for each in names])
    nothing = np.zeros(len(names))
    honest = np.full((4, MOST_EVENTS), NO_EVENT)
    honest[:, 0] = 0
    honest[1, 0] = VERDICTS.index("flagged")
    made_up: dict[str, Arrays] = {
        "honest": {
            "levels": np.zeros((4, len(LEVELS)), dtype=np.int64),
            "effect": np.array([-1, 0, -1, 1]),
            "verdict": honest,
        },
        "mistaken": {
            "verdict": np.array([named, np.zeros_like(named)]),
            "moved": np.array([nothing, nothing + 9.0]),
            "nats": np.array([nothing, nothing + 5.0]),
        },
    }
    monkeypatch.setattr(Study, "repeat", lambda _, name, *__: made_up[name])
    study = study_in(tmp_path)
    assert not run_mistakes(study, SCENARIO, PRIORS, {"honest": 4, "mistaken": 2})
    page = study.page.read_text()
    assert "| effect | a clear one | 2 | 1 |" in page
    assert "Not passed: draw 1, thrust_scale: flagged." in page
    assert "| wheels rotated | both | named | **missed (9 σ, 5 nats)** |" in page
    assert "1 of 4 honest draws" in page
