"""Searches for a cause's mode beside the baseline's: three lengths, each for what needs it.

The baseline's Laplace factor makes its coordinates white, so that a few steps of a quasi-Newton
search end at a cause's own mode; what an effect trades with nuisances is a ridge in them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from cassini_bayes.computing.arrays import Array
from cassini_bayes.diagnosis.hypotheses import Hypothesis
from cassini_bayes.diagnosis.modes import (
    CURVATURE_STEP,
    LEAST_CURVATURE,
    LOG_2_PI,
    STEP,
    WHITE,
    LogDensity,
    Mode,
    maximise,
    mode_near,
    mode_of,
)
from cassini_bayes.sampling.warmstart import lower_factor, told

ROUNDING: Final = 1e-6
"""Nats by which the same point may differ between batches: a log density of 1e5 has 1e-11 of its
own, sums over a batch more. A Newton step of no gain is then no failure."""

# How long the first search goes on. Judgement, kept where verdicts on two flights were the same
# with and without the bounds (docs/results/diagnosis-campaigns.md).
NEAR_ROUNDS: Final = 9  # Newton steps: most causes need one or two
NEAR_TURNS: Final = 3  # rounds in a row that only turn the axes along a ridge
NEAR_LEFT: Final = 0.02  # nats that a last step predicts: below what Laplace's evidence is good to
NEAR_GAIN: Final = 5.0  # nats of a cause that is searched further: there may be another mode
NEAR_FAR: Final = 20.0  # nats that a step predicts: too far for the curvature here
SHORTER: Final = 0.3  # of a step that did not gain what it predicted
RIDGE_ROUNDS: Final = 2  # of axes turned along a ridge: the difference h − cᵀc is good after these
FEW_STEPS: Final = 6  # of L-BFGS in the second search: the third looks at the whole curvature
SLOPE_LEFT: Final = 0.1  # nats that its last slope predicts, a tenth of what matters to a rank

# What a search that has not ended may still lack (docs/topics/criticism.md §1). Judgement: a bound
# too low loses a cause, one too high costs a second for each.
LACKING_NATS: Final = 30.0  # of one that gained more than NEAR_GAIN
NEAR_LACKING: Final = 3.0  # of the gain after the first search, and of what its steps predict
LACKING_SHARE: Final = 1.0  # of the gain after the second
UNSURE_NATS: Final = 3.0
"""Of the volume of a peak whose ridge is not straight: what a banana in the tests is short of stays
within it (tests/diagnosis/test_evidence.py). Importance draws tell."""

LEAST_SHARE: Final = 0.2  # of the gain that a Newton step predicts, as in modes
LEAST_CROSS: Final = 0.1  # sum of squared off-diagonals of white axes: 0.05 nats of the evidence
FLATTEST: Final = 1e-4  # of the steepest curvature in one round: axes grow a hundredfold at most
LEAST_RIDGE: Final = 1e-6  # curvature; a thousand baseline standard deviations wide
BENT: Final = 0.03
"""Of the steepest curvature: what comes out more negative is bent within the step and no rounding
(judgement; its direction is used, its length is not)."""
FAR_MOVED: Final = 3.0
"""Baseline standard deviations along an axis, beyond which its curvature need not be the
baseline's: near a bound of its prior a parameter hardly moves (judgement)."""
EFFECT_STEPS: Final = (0.3, 0.03, 0.003, 0.0003)
"""Prior standard deviations, for the first curvature of an effect: telemetry tells some sizes to a
thousandth of their prior, totals hardly any."""
BEST_STEP: Final = 0.3
"""Standard deviations of a step that tells a curvature: far above rounding, and that of a Student-t
of eight degrees of freedom is then right to 0.6 per cent."""
STARTS: Final = (-2.0, -0.7, 0.0, 0.7, 2.0)  # of the second search, along every axis of an effect
NEAR_STARTS: Final = (-3.5, -2.5, -1.8, -1.2, -0.7, -0.3, 0.0, 0.4, 1.0, 2.0)
"""Of the first search, in standard normals. More of them below zero: half-normal sizes (leaks,
deficits) have their small values there."""


@dataclass(frozen=True)
class ModeSearch:
    """How far the search for a hypothesis's mode has come, and what it may still gain (nats).

    What is within :data:`UNSURE_NATS` is left to importance draws.
    """

    mode: Mode
    lacking: float = 0.0


class _Rows(NamedTuple):
    """Value, slope and curvature along axes of which the first are white."""

    value: float
    slope: Array  # (D,)
    inner: Array  # (D, D)


def starts(extra: int, values: Sequence[float] = STARTS) -> Array:
    """Starting values (s, extra) of an effect's coordinates: along each axis and at the middle."""
    points = [np.zeros(extra)]
    for axis in range(extra):
        points += [value * np.eye(extra)[axis] for value in values if value != 0.0]
    return np.array(points)


def newton_search(hypothesis: Hypothesis, base: Mode, worth: float = -np.inf) -> ModeSearch:
    """Mode of a cause that the data hardly speak of, by Newton steps from the baseline's mode.

    The nuisances keep the baseline's curvature; that of the effect, across and along, is computed
    before every step. The search has not ended where it comes to no rest, nor where the cause gains
    more than a few nats: there may be another mode. It is left where the cause will not gain what
    makes it ``worth`` while (nats).
    """
    density = hypothesis.log_density
    d, extra = len(base.point), hypothesis.dimension - len(base.point)
    points = starts(extra, NEAR_STARTS)
    points = np.concatenate([np.tile(base.point, (len(points), 1)), points], axis=1)
    values = density(points)
    point, value = points[int(np.nanargmax(values))], float(np.nanmax(values))
    axes = _whitening_axes(density, point, base, extra)
    step, predicted, turns, most = np.zeros(d + extra), 0.0, 0, 0.0
    for _ in range(NEAR_ROUNDS):
        rows = _effect_rows(density, point + step, axes, d)
        if not rows.value - value >= LEAST_SHARE * predicted - ROUNDING:
            step, predicted = SHORTER * step, SHORTER * predicted
            continue
        point, value, step, predicted = point + step, rows.value, np.zeros(d + extra), 0.0
        ridge, is_white = _ridge(axes, rows.inner, d)
        most = _larger(most, 0.5 * float(rows.slope @ rows.slope))
        if not is_white:
            turns += 1
            if turns > NEAR_TURNS:
                break
            axes = np.concatenate([axes[:, :d], ridge], axis=1)
            continue
        turns = 0
        values, vectors = np.linalg.eigh(rows.inner)
        turned = axes @ vectors / np.sqrt(values)
        slope = vectors.T @ rows.slope / np.sqrt(values)
        predicted = 0.5 * float(slope @ slope)
        most = _larger(most, predicted)
        if predicted > NEAR_FAR:
            break
        if _gain(value, extra, base) + NEAR_LACKING * predicted < worth:
            return ModeSearch(mode_of(point, lower_factor(turned), value))
        if predicted < NEAR_LEFT:
            mode = mode_of(point, lower_factor(turned), value)
            is_small = _gain(value, extra, base) < NEAR_GAIN
            return ModeSearch(mode, 0.0 if is_small else _lacking(mode, base, NEAR_LACKING))
        step = turned @ slope
    mode = mode_of(point, lower_factor(axes), value)
    is_small = _gain(value, extra, base) < NEAR_GAIN
    lacking = NEAR_GAIN if is_small else _lacking(mode, base, NEAR_LACKING)
    return ModeSearch(mode, lacking + NEAR_LACKING * most)


def search_from_starts(hypothesis: Hypothesis, base: Mode) -> ModeSearch:
    """Mode of a hypothesis with more coordinates than the baseline, from the baseline's mode.

    From every starting value of the effect one Newton step is made in the baseline's coordinates;
    the best is maximised from there. The determinant is the baseline's with the effect's own rows
    and columns renewed, right as long as the nuisances are not moved far (:func:`has_moved`). Where
    these rows are not white there, or still slope, the search has not ended; a cause that could win
    has the better part of its gain by then.
    """
    density = hypothesis.log_density
    d, extra = len(base.point), hypothesis.dimension - len(base.point)
    point = _best_start(density, base, starts(extra))
    axes, _, _ = _along_ridges(density, point, _whitening_axes(density, point, base, extra), d)
    point = maximise(density, point, axes, FEW_STEPS)
    turned, rows, is_white = _along_ridges(density, point, axes, d)
    predicted = 0.5 * float(rows.slope @ rows.slope)
    if not is_white or predicted > SLOPE_LEFT:
        mode = mode_of(point, lower_factor(axes), rows.value)
        if _gain(rows.value, extra, base) > NEAR_GAIN:
            return ModeSearch(mode, _lacking(mode, base, LACKING_SHARE))
        return ModeSearch(mode, UNSURE_NATS + NEAR_LACKING * _larger(0.0, predicted))
    values, vectors = np.linalg.eigh(rows.inner)
    turned = turned @ vectors / np.sqrt(np.maximum(values, LEAST_CURVATURE))
    return ModeSearch(mode_of(point, lower_factor(turned), rows.value))


def _gain(value: float, extra: int, base: Mode) -> float:
    """Nats gained in density over the baseline, the prior of ``extra`` coordinates at its peak."""
    return value + 0.5 * extra * LOG_2_PI - base.value


def _larger(one: float, other: float) -> float:
    """The larger of two; infinite where one is not a number."""
    return max(one, other) if np.isfinite(other) else np.inf


def _lacking(mode: Mode, base: Mode, share: float) -> float:
    """Nats that a search which has not ended may lack: thirty, and a share of what it gained."""
    return LACKING_NATS + share * max(mode.log_evidence - base.log_evidence, 0.0)


def higher_of(new: ModeSearch, old: ModeSearch, base: Mode) -> ModeSearch:
    """The search that came higher; the older one has not ended where that is the one."""
    if new.mode.log_evidence >= old.mode.log_evidence:
        return new
    return ModeSearch(old.mode, _lacking(old.mode, base, LACKING_SHARE))


def has_moved(mode: Mode, base: Mode) -> bool:
    """Whether nuisances are so far from the baseline's mode that their curvature may differ."""
    d = len(base.point)
    moved = np.linalg.solve(base.factor, mode.point[:d] - base.point)
    return bool(np.abs(moved).max() > FAR_MOVED)


def with_whole_curvature(hypothesis: Hypothesis, mode: Mode) -> Mode:
    """Mode and its whole curvature anew.

    Needed where the nuisances went far from the baseline's mode, as their curvature there is not
    the baseline's: near a bound of its prior a parameter hardly moves.
    """
    return mode_near(hypothesis.log_density, mode.point, mode.factor)


def _ridge(axes: Array, inner: Array, d: int) -> tuple[Array, bool]:
    """The last axes turned along the ridges on which the effect trades with the nuisances.

    With them whether those there are followed the ridges already. With the baseline's coordinates
    white and c, h the effect's rows of the curvature, the ridge is (−c, 1) and its curvature
    h − cᵀc. That difference of large numbers is good after a few rounds.
    """
    cross, along = inner[:d, d:], inner[d:, d:]
    values, vectors = np.linalg.eigh(along - cross.T @ cross)
    is_white = (cross**2).sum() < LEAST_CROSS and WHITE[0] < values[0] and values[-1] < WHITE[1]
    most = float(np.abs(np.diagonal(along)).max())
    least = max(FLATTEST * most, LEAST_RIDGE)
    # where it comes out negative the ridge is bent: its direction is used, its length is not
    length = np.where(values > -BENT * most, np.maximum(values, least), most)
    turn = vectors / np.sqrt(length)
    ridge = axes @ np.concatenate([-cross @ turn, turn])
    return ridge / np.maximum(np.abs(ridge[d:]).max(0), 1.0), bool(is_white)


def _along_ridges(
    density: LogDensity, point: Array, axes: Array, d: int
) -> tuple[Array, _Rows, bool]:
    """Axes whose last ones follow the ridges, the rows along them, whether these are white."""
    for left in reversed(range(RIDGE_ROUNDS + 1)):
        rows = _effect_rows(density, point, axes, d)
        ridge, is_white = _ridge(axes, rows.inner, d)
        if is_white or left == 0:
            break
        axes = np.concatenate([axes[:, :d], ridge], axis=1)
    return axes, rows, is_white


def _best_start(density: LogDensity, base: Mode, starting: Array) -> Array:
    d = len(base.point)
    offsets = np.vstack([np.zeros((1, d)), STEP * base.factor.T])
    batch = np.concatenate(
        [
            np.broadcast_to(base.point + offsets, (len(starting), d + 1, d)),
            np.broadcast_to(starting[:, None], (len(starting), d + 1, starting.shape[1])),
        ],
        axis=2,
    )
    values = density(batch.reshape(-1, d + starting.shape[1])).reshape(len(starting), -1)
    gradient = (values[:, 1:] - values[:, :1]) / STEP + 0.5 * STEP
    candidates = [np.concatenate([np.tile(base.point, (len(starting), 1)), starting], axis=1)]
    for share in (1.0, SHORTER):
        stepped = base.point + share * gradient @ base.factor.T
        candidates.append(np.concatenate([stepped, starting], axis=1))
    everything = np.concatenate(candidates)
    values = density(everything)
    return np.asarray(everything[int(np.nanargmax(values))])


def _whitening_axes(density: LogDensity, point: Array, base: Mode, extra: int) -> Array:
    """Whitening axes (d + extra, d + extra): the baseline's; the effect's by curvature.

    Of several lengths of a step, the curvature is taken from the one nearest to a third of the
    standard deviation that it tells.
    """
    d = len(base.point)
    axes = np.zeros((d + extra, d + extra))
    axes[:d, :d] = base.factor
    scales = np.array(EFFECT_STEPS)
    ahead = [scales[:, None] * unit for unit in np.eye(d + extra)[d:]]
    moves = [np.concatenate([own, -own]) for own in ahead]
    here, *of_moves = _by_move(density, point, [np.zeros((1, d + extra)), *moves])
    for i, values in enumerate(of_moves):
        bend = (2.0 * here[0] - values.reshape(2, -1).sum(0)) / scales**2
        sd = 1.0 / np.sqrt(np.maximum(bend, LEAST_CURVATURE))
        axes[d + i, d + i] = sd[int(np.argmin(np.abs(np.log(BEST_STEP * sd / scales))))]
    return axes


def _effect_rows(density: LogDensity, point: Array, axes: Array, d: int) -> _Rows:
    """Value, slope and curvature along ``axes``: the unit matrix but for the effect's own rows.

    Steps to points of no density leave the unit matrix, and no slope.
    """
    size = axes.shape[1]
    inner, slope = np.eye(size), np.zeros(size)
    h, unit = CURVATURE_STEP, axes.T
    moves = [np.zeros((1, len(point)))]
    for i in range(d, size):
        away = np.stack([h * unit[i], -h * unit[i]])
        moves += [away, (away[:, None] + STEP * unit[:i]).reshape(-1, len(point))]
    here, *of_moves = _by_move(density, point, moves)
    with np.errstate(invalid="ignore"):
        for i, both, beside in zip(range(d, size), of_moves[::2], of_moves[1::2], strict=True):
            slopes = (beside.reshape(2, i) - both[:, None]) / STEP
            inner[i, :i] = inner[:i, i] = -(slopes[0] - slopes[1]) / (2.0 * h)
            inner[i, i] = (2.0 * here[0] - both.sum()) / h**2
            slope[i] = (both[0] - both[1]) / (2.0 * h)
    slope[:d] = slopes.mean(0)[:d] + 0.5 * STEP
    return _Rows(float(here[0]), told(slope, 0.0), told(inner, np.eye(size)))


def _by_move(density: LogDensity, point: Array, moves: Sequence[Array]) -> list[Array]:
    """Values (n,) at several lots of moves (n, d) from a point: in one batch, which costs less."""
    values = density(point + np.concatenate(moves))
    return np.split(values, np.cumsum([len(own) for own in moves])[:-1])
