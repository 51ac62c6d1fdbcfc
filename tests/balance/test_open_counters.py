"""What counters leave open: steps of single cut tails and levels of rounded counters."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cassini_bayes.balance.open_counters import (
    OpenScales,
    step_patterns,
    step_variances,
)
from cassini_bayes.balance.statistics.event_statistics import CounterStatistics
from cassini_bayes.balance.statistics.long_levels import (
    NO_LEVELS,
    level_patterns,
)
from cassini_bayes.balance.statistics.pulse_columns import PulseBasis
from cassini_bayes.balance.statistics.sampling import LostTails, Sampling, lost_tails
from cassini_bayes.computing.arrays import Array
from cassini_bayes.spacecraft.pulses import PULSE_SHAPES

DURATION_S = 80.0
TIME = np.arange(DURATION_S)
GAPS_S = np.array([0.125])
UNLIKE = np.zeros((4, 1, 4, 4))
LONG = np.eye(1, 4) * np.ones((4, 1, 1))  # slopes of pulses that have reached their thrust
ENDS = np.array([3.0, 7.0, 13.0, 31.0])
STEP = (TIME[:, None] >= ENDS).astype(float)


def counters(pairs: list[float]) -> CounterStatistics:
    """One couple that fired in four intervals, with so many pairs in them."""
    weight = np.array(pairs)[:, None]
    fired = np.ones((4, 1), dtype=bool)
    open_s2, ratio, every = np.array([4e-6]), np.full((4, 1), np.inf), np.array([1.0])
    return CounterStatistics(
        TIME,
        1,
        ENDS,
        fired,
        weight,
        UNLIKE,
        weight,
        LONG,
        open_s2,
        ratio,
        every,
        GAPS_S,
        np.array([0.125]),
        np.zeros(0),
        0.0,
        0.0,
        0.0,
        1.0,
        0.0,
        np.zeros(1),
        0.0,
        0.0,
        0.0,
        NO_LEVELS.couple,
        NO_LEVELS.begin_s,
        NO_LEVELS.end_s,
        NO_LEVELS.value_s,
    )


def scales_of(pair_s2: Array, weights: Array) -> OpenScales:
    """Scales of a couple without torque, by the variance of what a pair loses."""
    n = len(pair_s2)
    return OpenScales(np.zeros((n, 3, 1)), LostTails(np.zeros(n), pair_s2), weights)


def test_pairs_of_a_quarter_add_up_to_what_the_likelihood_has() -> None:
    """A step is its quarter's mean, which the likelihood has, and what is added; one: nothing."""
    found, intervals = step_patterns(counters([1.0, 1.0, 1.0, 0.0]), 0, DURATION_S, STEP)
    assert intervals.tolist() == [0, 1, 2]
    for i in range(3):
        assert STEP[:, :3].mean(axis=1) + found[:, i] == pytest.approx(STEP[:, i])
    alone, _ = step_patterns(counters([1.0, 0.0, 0.0, 1.0]), 0, DURATION_S, STEP)
    assert not alone.any()


def test_several_pairs_of_an_interval_scatter_together() -> None:
    """Four pairs have four times the variance of one, about a mean that leans to them."""
    four = counters([4.0, 1.0, 0.0, 0.0])
    found, _ = step_patterns(four, 0, DURATION_S, STEP)
    mean = 0.8 * STEP[:, 0] + 0.2 * STEP[:, 1]
    assert found == pytest.approx(STEP[:, :2] - mean[:, None])
    scales = scales_of(np.array([1e-6, 3e-6]), np.ones((2, 4)))
    variances = step_variances(four, 0, scales)
    assert variances == pytest.approx(np.outer([1e-6, 3e-6], [4.0, 1.0, 0.0, 0.0]))


def test_unlike_pulses_scatter_by_their_columns() -> None:
    """The variance of a step is the quadratic form of its columns' weights, beside its pairs."""
    rng = np.random.default_rng(20261123)
    factor = 1e-3 * rng.standard_normal((4, 1, 4, 4))
    unlike = factor @ np.swapaxes(factor, -1, -2)
    weights = rng.standard_normal((2, 4))
    scales = scales_of(np.array([1e-6, 0.0]), weights)
    found = step_variances(replace(counters([1.0, 0.0, 0.0, 0.0]), unlike=unlike), 0, scales)
    own = [[w @ unlike[i, 0] @ w for i in range(4)] for w in weights]
    pairs = np.array([[1e-6, 0.0, 0.0, 0.0], [0.0] * 4])
    assert found == pytest.approx(np.array(own) + pairs)


def test_rounding_leaves_no_variance_below_zero() -> None:
    """Columns along which the weights have nothing: zero, also where sums come out below it."""
    rng = np.random.default_rng(20261124)
    weights = rng.standard_normal((200, 4))
    across = rng.standard_normal((200, 4))
    across -= (
        (across * weights).sum(1, keepdims=True) / (weights**2).sum(1, keepdims=True) * weights
    )
    unlike = across[:, :, None] * across[:, None]
    scales = scales_of(np.zeros(200), weights)
    found = scales.variance_s2(np.zeros(200), unlike)
    assert (np.einsum("nc,ncd,nd->n", weights, unlike, weights) < 0.0).any()
    assert np.diagonal(found).min() >= 0.0
    assert np.diagonal(found).max() < 1e-12


def test_a_rounding_lasts_until_the_next_firing() -> None:
    """Five levels of 2 ms, which add up to a constant."""
    found = level_patterns(counters([0.0] * 4).levels, 0, STEP, np.ones((len(TIME), 1)))
    assert not found[:, 1:].any()
    found = found[:, 0]
    assert found.sum(axis=1) == pytest.approx(np.full(len(TIME), 2e-3))
    assert found[:, 1] == pytest.approx(2e-3 * ((TIME >= 3.0) & (TIME < 7.0)))


@pytest.mark.parametrize(
    ("every", "seen"), [(1.0, [1, 1, 1, 1, 1]), (2.0, [1, 0, 1, 0, 1]), (np.inf, [1, 0, 0, 0, 1])]
)
def test_levels_bound_by_alike_widths_have_the_stated_covariance(
    every: float, seen: list[float]
) -> None:
    """Patterns squared are σ² (1 + Dᵀ Q⁻¹ D)⁻¹ seen in the rows, with ones for readings in use."""
    ratio = np.array([0.3, 0.3, 5.0, 0.01])
    bound = replace(counters([0.0] * 4), open_ratio=ratio[:, None], open_every=np.array([every]))
    free = level_patterns(counters([0.0] * 4).levels, 0, STEP, np.ones((len(TIME), 1)))[:, 0]
    found = level_patterns(bound.levels, 0, STEP, np.ones((len(TIME), 1)))[:, 0]
    apart = np.diff(np.eye(5), axis=0)
    covariance = np.linalg.inv(np.diag(seen) + apart.T @ (apart / ratio[:, None]))
    np.testing.assert_allclose(found @ found.T, free @ covariance @ free.T, atol=1e-18)


@pytest.mark.parametrize("spread_s", [0.0, 0.03])
def test_errors_of_short_pulses_are_taken_back_as_far_as_slopes_are_alike(spread_s: float) -> None:
    """A hundred short pulses on a rounded counter, simulated: the patterns have their momentum.

    Pulses of 15 ms gain some two seconds per second: errors are twice as large, but add up to
    nothing. Among pulses of 15 and 45 ms they do not. Control: steps that are independent, as if
    nothing were taken back.
    """
    rng = np.random.default_rng(20261127)
    firings, draws, step_s = 100, 400, 2e-4
    basis = PulseBasis(PULSE_SHAPES["first_order"], (0.0, 0.02, 0.05))
    widths = 0.015 + spread_s * rng.integers(0, 2, firings)
    one = np.ones(firings)
    error = step_s * (rng.random((draws, firings + 1)) - 0.5)
    read = widths + np.diff(error, axis=1)
    expected = np.array([basis.expected_columns(own, one)[:, 0] for own in read])
    late = np.cumsum(basis.columns(widths)[:, 0] - expected, axis=1)
    cosine = np.cos(np.pi * (np.arange(firings) + 0.5)[:, None] / firings * np.arange(1, 50))
    ends = np.arange(firings, dtype=float)
    fired = np.ones((firings, 1), dtype=bool)
    slopes = basis.slopes(widths, one)[:, None]
    none = np.zeros((firings, 1))
    known = replace(
        counters([0.0] * 4),
        end_s=ends,
        fired=fired,
        square=none,
        steps=none,
        slopes=slopes,
        open_s2=np.array([step_s**2 / 12.0]),
        open_ratio=np.full((firings, 1), np.inf),
    )
    step = (ends[:, None] >= ends).astype(float)
    patterns = level_patterns(known.levels, 0, step, np.ones((firings, 1)))[:, 0]
    gained = slopes[:, 0, 0] - 1.0
    independent = step * gained * step_s / np.sqrt(6.0)
    for waves in (slice(0, 3), slice(3, 20), slice(20, 49)):
        part = cosine[:, waves]
        simulated = ((late @ part) ** 2).mean()
        stated = ((patterns.T @ part) ** 2).sum(axis=0).mean()
        assert stated == pytest.approx(simulated, rel=0.25)
    slow = ((independent.T @ cosine[:, :3]) ** 2).sum(axis=0).mean()
    simulated = ((late @ cosine[:, :3]) ** 2).mean()
    assert slow > (5.0 if spread_s == 0.0 else 1.2) * simulated


@pytest.mark.parametrize(
    ("tau_fall_s", "offset_s"), [(0.05, 0.0), (0.15, 0.0), (0.05, 0.08), (0.05, 0.14)]
)
def test_pairs_within_a_second_lose_what_their_gaps_say(tau_fall_s: float, offset_s: float) -> None:
    """Pulses that fill control cycles, anywhere in a second: the closest pairs are one in seven.

    Had the others nothing to lose, a tail of 150 ms would be cut by a third of what it is. Pulses
    that go on for longer leave shorter gaps, and lose what overlaps the next.
    """
    cycle_s, rise_s, pairs = 0.125, 0.02, 200_000
    gaps = cycle_s * np.random.default_rng(20_261_126).integers(1, 8, pairs)
    left = np.maximum(gaps - offset_s, 0.0)
    lost = (tau_fall_s - rise_s) * np.exp(-left / tau_fall_s) + np.maximum(offset_s - gaps, 0.0)
    fall, share = np.array([tau_fall_s]), np.array([1.0 / 7.0])
    found = lost_tails(
        np.array([cycle_s]), cycle_s, fall - rise_s, fall, share, np.array([offset_s])
    )
    # ends of the other gaps are between cycles: 7 % of what is lost there at 150 ms
    assert found.mean_s[0] == pytest.approx(lost.mean(), rel=0.06)
    assert found.variance_s2[0] == pytest.approx(lost.var(), rel=0.06)
    closest = (tau_fall_s - rise_s) * np.exp(-cycle_s / tau_fall_s) / 7.0
    assert (closest < 0.6 * lost.mean()) == (tau_fall_s > 0.1 or offset_s > 0.0)


@pytest.mark.parametrize("width_s", [0.02, 0.031, 0.045, 0.125, 0.4])
def test_short_pulses_of_a_pair_lose_less(width_s: float) -> None:
    """Two pulses of a first-order valve by its differential equation: what they deliver less.

    Had pulses of 31 ms reached their thrust, it would be 1.6 times as much.
    """
    delay, rise, fall, gap = 0.005, 0.02, 0.095, 0.055
    time = np.arange(0.0, 3.0, 1e-5)
    is_open = (time < width_s) | ((time >= width_s + gap) & (time < 2.0 * width_s + gap))
    opening, closing = -np.expm1(-1e-5 / rise), -np.expm1(-1e-5 / fall)
    thrust, delivered = 0.0, 0.0
    for own in is_open.tolist():
        before = thrust
        thrust += opening * (1.0 - thrust) if own else -closing * thrust
        delivered += 0.5e-5 * (before + thrust)
    shape = PULSE_SHAPES["first_order"]
    lost = 2.0 * float(shape.effective_time(width_s, delay, rise, fall)) - delivered
    sampling = Sampling(shape, (delay, rise, fall), 0.3, ((0,),), 60.0, paired_s=(width_s,))
    tails = (sampling.cut_tail_s((delay, rise, fall)), np.array(fall - rise))
    found, long = (
        lost_tails(np.array([gap]), 0.125, tail[None], np.array([fall]), np.ones(1)).mean_s[0]
        for tail in tails
    )
    assert found == pytest.approx(lost, rel=2e-3)
    assert (long > 1.5 * lost) == (width_s < 0.04)


def test_pairs_lose_by_their_widths() -> None:
    """Of unlike pairs each loses by what its own pulses reach; on average as the event's do."""
    delay, rise, fall = 0.005, 0.02, 0.05
    own = np.array([0.03, 0.06, 0.25])
    sampling = Sampling(
        PULSE_SHAPES["first_order"], (delay, rise, fall), 0.3, ((0,),), 60.0, paired_s=(*own,)
    )
    reached = -np.expm1(-own / rise)
    assert sampling.cut_by_width(own) == pytest.approx((reached / reached.mean()) ** 2)
    alike = replace(sampling, paired_s=(0.04,))
    assert alike.cut_by_width(np.array([0.04])) == pytest.approx([1.0])
    longer = sampling.cut_tail_s((delay, np.array([rise, rise]), fall), np.array([0.0, 0.01]))
    assert longer[0] < longer[1] < fall - rise


def test_a_control_cycle_of_a_second_leaves_no_other_gaps() -> None:
    """Pairs within a second are close there or none."""
    tail, fall = np.array([0.18]), np.array([0.2])
    found = lost_tails(np.array([1.0]), 1.0, tail, fall, np.array([0.5]))
    assert found.mean_s[0] == pytest.approx(0.5 * 0.18 * np.exp(-5.0))


@pytest.mark.parametrize("offset_s", [0.02, 0.06, 0.16, 0.4, 1.2])
def test_overlap_of_all_pairs_is_lost(offset_s: float) -> None:
    """Pulses of 100 ms in cycles of 125 ms that go on for long: by quadrature over all gaps."""
    cycle_s, gap_s, tail_s, fall_s, share = 0.125, 0.025, 0.03, 0.05, 1.0 / 7.0

    def lost(gaps: Array) -> Array:
        left, overlap = np.maximum(gaps - offset_s, 0.0), np.maximum(offset_s - gaps, 0.0)
        return np.asarray(tail_s * np.exp(-left / fall_s) + overlap)

    edges = np.linspace(gap_s + 0.5 * cycle_s, 1.0, 400_001)
    others, close = lost(0.5 * (edges[1:] + edges[:-1])), lost(np.array([gap_s]))[0]
    mean = share * close + (1.0 - share) * others.mean()
    square = share * close**2 + (1.0 - share) * (others**2).mean()
    given = (np.array([value]) for value in (tail_s, fall_s, share, offset_s))
    found = lost_tails(np.array([gap_s]), cycle_s, *given)
    assert found.mean_s[0] == pytest.approx(mean, rel=1e-9)
    assert found.variance_s2[0] == pytest.approx(square - mean**2, rel=1e-8)
