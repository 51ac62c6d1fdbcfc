"""Rules on single-bias estimates, and rates over made-up missions."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from mission_cases import PRIORS
from study_cases import study_in
from totals_cases import FLIGHT, flight

from cassini_bayes.model.nominal import check_rows
from cassini_bayes.studies import missions
from cassini_bayes.studies.flight_priors import IDEAL, TESTED, with_beliefs
from cassini_bayes.studies.mission_flights import MissionFlights, fly, study_priors
from cassini_bayes.studies.missions import cusum, findings_of, passes, ratio_of_ends


def estimates(loss: float, onset: int, events: int = 12) -> np.ndarray:
    """One thruster with a step, one healthy, each seen in two events out of three."""
    found = np.full((events, 2), 0.75)
    found[onset:, 0] *= 1.0 - loss
    found[::3] = np.nan
    return found


def test_ratio_and_cusum_see_a_step_and_no_step() -> None:
    """The ratio of ends is the loss once four biases have it; the CUSUM rises from the onset."""
    values = estimates(0.2, 7, 18)
    ratio, total = ratio_of_ends(values), cusum(values)
    assert ratio[-1, 0] == pytest.approx(0.2)
    assert ratio[6, 0] == pytest.approx(0.0)
    assert (np.diff(total[7:, 0]) >= 0).all()
    assert total[-1, 0] > 10.0
    np.testing.assert_allclose(ratio[:, 1], 0.0, atol=1e-12)
    np.testing.assert_allclose(total[:, 1], 0.0)


def made_up(missions: int = 40) -> dict[str, np.ndarray]:
    """Missions of twelve events on one branch; every second one loses z1 from its event 7 on."""
    shape = (missions, 2, 8)
    found = {
        "converged": np.ones(missions, dtype=bool),
        "untrusted": np.zeros(missions),
        "looks": np.full(missions, 5),
        "events": np.tile([12.0, 0.0], (missions, 1)),
        "failed": np.full(shape, -1.0),
        "share": np.zeros(shape),
        "onset": np.full(shape, -1.0),
        "oracle": np.full(shape, -1.0),
        "onset_rank": np.full(shape, np.nan),
        "fired": np.ones((missions, 2, 60, 8), dtype=bool),
        "chances": np.full((missions, 2, 60, 8), 0.01),
        "estimates": np.full((missions, 2, 60, 8), 0.75),
        "ranks": np.linspace(0.01, 0.99, missions)[:, None],
        "names": np.full((missions, 1), "thrust_intercept_share"),
        "slope_rank": np.tile(np.linspace(0.01, 0.99, missions)[:, None], 2),
    }
    found["chances"][:, :, 12:] = 0.0
    for i in range(0, missions, 2):
        found["failed"][i, 0, 0], found["share"][i, 0, 0] = 6, 0.2
        found["onset"][i, 0, 0], found["oracle"][i, 0, 0] = 7, 6
        found["chances"][i, 0, 7:12, 0] = 0.99
        found["estimates"][i, 0, 6:12, 0] = 0.6
        found["onset_rank"][i, 0, 0] = (i + 1) / missions
    return found


def test_rates_of_made_up_missions() -> None:
    """All named one bias late, no false alarm, earlier than either rule; then spoilt on purpose."""
    found = made_up()
    findings = findings_of(found)
    assert findings.named == findings.near == findings.oracle_near == (20, 20)
    assert findings.false_alarms == (0, 40)
    assert findings.in_time == (20, 20)
    late = {**found, "fired": found["fired"] & (np.arange(60) < 8)[:, None]}  # two biases since
    assert findings_of(late).in_time == (0, 0)
    delay = findings.rules.set_index("rule")["median_delay_biases"]
    assert delay["posterior odds"] == 1.0
    assert set(findings.rank_p) == {"thrust_intercept_share", "A slope", "B slope", "onset"}
    assert min(findings.rank_p.values()) > 0.5
    assert findings_of({**found, "slope_rank": found["slope_rank"] ** 2}).rank_p["A slope"] < 0.01
    found["onset"][::2, 0, 0] = 9
    assert findings_of(found).near == (0, 20)
    found["chances"][1, 0, 3, 5] = 0.99
    spoilt = findings_of(found)
    assert spoilt.false_alarms == (1, 40)
    assert not passes(spoilt)
    found["chances"][2, 0, 4, 0] = 0.99  # this thruster fails two biases later
    assert findings_of(found).false_alarms == (2, 40)


@dataclass(frozen=True)
class MadeUp(MissionFlights):
    """Missions that are not flown: those of the table."""

    def repetition(self, index: int) -> dict[str, np.ndarray]:
        """One mission of the table."""
        return {key: values[index] for key, values in made_up().items()}


def test_a_study_keeps_its_missions_and_writes_a_page(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Missions are run and kept as in every other study; the second time none is flown."""
    monkeypatch.setattr(missions, "MissionFlights", MadeUp)
    study = study_in(tmp_path)
    arguments = (str(FLIGHT), str(PRIORS), {"missions": 40})
    verdict = passes(findings_of(made_up()))
    assert missions.study_missions(study, *arguments) == verdict
    page = study.page.read_text()
    assert page.startswith("# Simulated missions")
    assert "20 of 20: 100%" in page
    assert "posterior odds" in study.page.with_suffix(".csv").read_text()
    monkeypatch.setattr(MadeUp, "repetition", None)
    assert missions.study_missions(study, *arguments) == verdict
    assert study.page.read_text() == page


def test_what_finished_missions_depend_on(tmp_path: Path) -> None:
    """Another seed, other priors, other events: another identity; the same ones elsewhere: not."""
    copy = tmp_path / "priors.toml"
    copy.write_bytes(PRIORS.read_bytes())
    flights = MissionFlights(FLIGHT, PRIORS, seed=1)
    same = replace(flights, priors=copy)
    assert same.identity() == flights.identity()
    others = (
        replace(flights, seed=2),
        replace(flights, events=copy),
        replace(flights, priors=FLIGHT),
    )
    assert len({own.identity() for own in (flights, *others)}) == 4


def test_beliefs_replace_means_and_keep_bounds() -> None:
    """The tail-off stays positive, everything else as it was."""
    _, priors = flight(1)
    moved = with_beliefs(priors, {**IDEAL, **TESTED})
    assert moved.means()["cm_y_m"] == pytest.approx(0.0453)
    tail = moved.parameters["tau_fall_s"].distribution
    assert tail is not None
    assert tail.low == 0.0
    assert moved.means()["cm_z_m"] == priors.means()["cm_z_m"]


def test_failing_thrusters_are_no_mistakes() -> None:
    """Simulated missions, with failures and pressures between 1,700 and 2,700 kPa: none refused."""
    priors = study_priors(str(PRIORS))
    for seed in range(3):
        flown = fly(FLIGHT, priors, np.random.default_rng(seed))
        for branch in "AB":
            of_branch = priors.for_branch(branch)
            assert check_rows(flown.events, of_branch, "mission", steady=False) == ()
