"""When in an interval a pulse was fired: variances against pulses fired at random moments."""

from __future__ import annotations

import numpy as np
import pytest

from cassini_bayes.balance.statistics import Samples
from cassini_bayes.effects.firings import TAIL_S, fired_intervals
from cassini_bayes.effects.flexible_mode import driven_answers
from cassini_bayes.effects.time_offset import LAG_S, PULSE_S, late_firings

TIME = np.arange(41.0)
WIDTH_S = 0.05
FORCE = np.array([[0.0, 0.0], [1.5, -0.5], [0.2, 0.4]])  # N m of two thrusters
DRAWS = 40_000


def samples(*first_s: float, count: int = 1) -> Samples:
    """Readings at 1 Hz of a couple of thrusters that fire ``count`` pulses in intervals named."""
    n = len(TIME)
    pulses = np.stack([sum(count * (t + 1.0 <= TIME) for t in first_s)] * 2, axis=1).astype(float)
    return Samples(
        TIME, np.ones((n, 4)), np.zeros((n, 3)), np.zeros((n, 3)), WIDTH_S * pulses, pulses
    )


def test_firings_of_a_couple_are_its_members_together() -> None:
    """Two intervals of one pulse each: bounds, momentum of both thrusters, what is left open."""
    found = fired_intervals(samples(7.0, 20.0), (0, 1), FORCE)
    assert found.start_s == pytest.approx([7.0, 20.0])
    assert found.end_s == pytest.approx([8.0, 21.0])
    given = (WIDTH_S + TAIL_S) * FORCE.sum(1)
    assert found.momentum_n_m_s == pytest.approx(np.stack([given, given]))
    assert found.scatter == pytest.approx([1.0 - WIDTH_S] * 2)


def test_firing_without_pause_leaves_nothing_open() -> None:
    """On-time of a whole interval has been delivered by every share of it: no column at all."""
    own = samples(7.0)
    full = Samples(
        own.time_s, own.attitude, own.rate_rad_s, own.wheel_rad_s, own.pulses * 1.0, own.pulses
    )
    found = fired_intervals(full, (0, 1), FORCE)
    assert len(found.scatter) == 0
    columns, variance = late_firings(found, TIME, 0.4)
    assert columns.shape == (len(TIME), 3, 0)
    assert len(variance) == 0


@pytest.mark.parametrize("count", [1, 3])
@pytest.mark.parametrize("offset_s", [0.3, 0.8, 1.3, -0.6])
def test_a_late_record_leaves_open_what_random_moments_scatter(offset_s: float, count: int) -> None:
    """Variance of what had been delivered, against 40,000 trains of pulses at random moments."""
    rng = np.random.default_rng(1)
    found = fired_intervals(samples(7.0, count=count), (0, 1), FORCE)
    columns, variance = late_firings(found, TIME, offset_s)
    moments = 7.0 + rng.uniform(0.0, 1.0, (count, DRAWS))
    given = moments + LAG_S + 0.5 * PULSE_S
    delivered = (TIME[:, None, None] + offset_s >= given).mean(1)
    expected = delivered.var(1)[:, None] * found.momentum_n_m_s[0] ** 2
    # pulses that last take that share of the interval's variance, to first order
    expected = expected * (1.0 - count * WIDTH_S)
    error = 5.0 * 0.5 / np.sqrt(DRAWS) * float((found.momentum_n_m_s**2).max())
    assert columns**2 @ variance == pytest.approx(expected, abs=error)
    assert np.count_nonzero(columns.any(axis=(1, 2))) == 1


def test_records_in_time_leave_nothing_open() -> None:
    """No offset, no columns: rows a reading after a pulse know what was fired."""
    quiet = TIME[~np.isin(TIME, [8.0, 10.0])]
    columns, variance = late_firings(fired_intervals(samples(7.0, 9.0), (0,), FORCE), quiet, 0.0)
    assert columns.shape == (len(quiet), 3, 0)
    assert len(variance) == 0


def test_an_appendage_answers_out_of_phase_by_as_much_as_random_moments_scatter() -> None:
    """Regressed on cosine and sine about the middle: the sine's variance; nothing before it."""
    rng = np.random.default_rng(2)
    frequency, kick = 0.21, 3e-5
    found = fired_intervals(samples(7.0), (0, 1), FORCE)
    answers, variance = driven_answers(found, TIME, np.array([kick]), (frequency, 0.0), 1.0)
    omega, after = 2.0 * np.pi * frequency, TIME > 7.5
    delay = rng.uniform(-0.5, 0.5, DRAWS)
    true = -kick * np.cos(omega * (TIME[after, None] - 7.5 - delay))
    basis = np.stack([np.cos(omega * (TIME - 7.5)), np.sin(omega * (TIME - 7.5))], axis=1)[after]
    weights = np.linalg.lstsq(basis, true, rcond=None)[0]
    mine = np.linalg.lstsq(basis, answers[after, 0], rcond=None)[0]
    assert mine == pytest.approx([0.0, kick], abs=1e-12)
    assert weights[1].var() == pytest.approx(
        kick**2 * variance[0] / (1.0 - WIDTH_S), rel=5.0 * np.sqrt(2.0 / DRAWS)
    )
    assert not answers[TIME < 8.0].any()


def test_a_damped_answer_dies() -> None:
    """After t its envelope is exp(−ζΩ t)."""
    found = fired_intervals(samples(7.0), (0,), FORCE)
    free, _ = driven_answers(found, TIME, np.array([1.0]), (0.2, 0.0), 1.0)
    damped, _ = driven_answers(found, TIME, np.array([1.0]), (0.2, 0.05), 1.0)
    rate = 0.05 * 2.0 * np.pi * 0.2
    after = np.maximum(TIME - 7.5, 0.0)
    assert damped[:, 0] == pytest.approx(free[:, 0] * np.exp(-rate * after), abs=1e-12)
