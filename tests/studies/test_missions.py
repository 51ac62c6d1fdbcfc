"""Rules on single-bias estimates, and rates over made-up missions."""

from __future__ import annotations

import numpy as np
import pytest
from totals_cases import flight

from cassini_bayes.studies.flight_priors import IDEAL, TESTED, with_beliefs
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
    delay = findings.rules.set_index("rule")["median_delay_biases"]
    assert delay["posterior odds"] == 1.0
    found["onset"][::2, 0, 0] = 9
    assert findings_of(found).near == (0, 20)
    found["chances"][1, 0, 3, 5] = 0.99
    spoilt = findings_of(found)
    assert spoilt.false_alarms == (1, 40)
    assert not passes(spoilt)


def test_beliefs_replace_means_and_keep_bounds() -> None:
    """The tail-off stays positive, everything else as it was."""
    _, priors = flight(1)
    moved = with_beliefs(priors, {**IDEAL, **TESTED})
    assert moved.means()["cm_y_m"] == pytest.approx(0.0453)
    tail = moved.parameters["tau_fall_s"].distribution
    assert tail is not None
    assert tail.low == 0.0
    assert moved.means()["cm_z_m"] == priors.means()["cm_z_m"]
