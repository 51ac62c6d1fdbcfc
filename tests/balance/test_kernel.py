"""Small linear algebra of the compiled likelihood against LAPACK, and what has no value.

The likelihood as a whole is compared with plain algebra in tests/model/test_posterior.py.
"""

from __future__ import annotations

import numpy as np
import pytest

from cassini_bayes.balance import kernel
from cassini_bayes.balance.kernel import (
    Entries,
    FastBands,
    FlatRows,
    Noise,
    Placed,
    SlowBands,
    Turns,
    TurnSums,
    TurnVariances,
    gain_and_covariance,
    log_of_flat_rows,
)
from cassini_bayes.balance.rounded_wheels import HARMONICS
from cassini_bayes.computing.arrays import Array


def positive(size: int, seed: int) -> Array:
    """A positive matrix of scales from 1e-6 to 1."""
    rng = np.random.default_rng(seed)
    scale = 10.0 ** rng.uniform(-6.0, 0.0, size)
    rough = rng.standard_normal((size, 2 * size))
    return np.asarray(scale[:, None] * (rough @ rough.T) * scale)


@pytest.mark.parametrize("size", [1, 3, 4, 7])
def test_axes_and_squares_are_those_of_lapack(size: int) -> None:
    """Jacobi's rotations: the same eigenvalues, axes that are orthonormal and turn back."""
    wanted = positive(size, size)
    turned, axes = wanted.copy(), np.empty_like(wanted)
    kernel._diagonalise(turned, axes)
    values = np.diagonal(turned)
    assert np.sort(values) == pytest.approx(np.linalg.eigvalsh(wanted), rel=1e-9, abs=1e-18)
    assert axes.T @ axes == pytest.approx(np.eye(size), abs=1e-13)
    assert (axes * values) @ axes.T == pytest.approx(wanted, rel=1e-9, abs=1e-15 * wanted.max())


@pytest.mark.parametrize("size", [1, 3, 20])
def test_factor_and_inverse_are_those_of_lapack(size: int) -> None:
    """Cholesky's factor, its determinant, solutions and the inverse."""
    matrix, lower, inverse = positive(size, size), np.empty((size, size)), np.empty((size, size))
    wanted = np.linalg.slogdet(matrix)[1]
    assert kernel._factor(matrix, lower) == pytest.approx(wanted, rel=1e-9)
    assert lower == pytest.approx(np.linalg.cholesky(matrix), rel=1e-6, abs=1e-18)
    assert kernel._invert(matrix, inverse) == pytest.approx(wanted, rel=1e-9)
    assert inverse @ matrix == pytest.approx(np.eye(size), abs=1e-6)


def equations(
    beside: Array,
    own_sd: float = 1.0,
    turns: tuple[tuple[Array, float], ...] = (),
    first: tuple[int, ...] = (0, 4),
) -> tuple[Array, Array, Array]:
    """Normal equations of one unknown and the measured momentum, four modes, nothing faster.

    ``beside`` (3, 3), or (S, 3, 3) of bands that begin at the modes ``first``.
    ``turns``: rows (m, 3, 2) of integrated columns and the variance of their noise, by band, bands
    of two rows or fewer first.
    """
    modes = np.random.default_rng(2).standard_normal((3, 2, 4))
    slow = SlowBands(modes, np.array(first), np.ones(4))
    fast = FastBands(
        np.zeros((0, 3, 3, 2, 2)),
        np.zeros(0),
        np.zeros(0),
        np.zeros((0, 0)),
        np.zeros((0, 4, 0, 2)),
    )
    places = np.arange(2)
    entries = Entries(np.arange(3), places[1:], places)
    few = [rows for rows, _ in turns if len(rows) <= 2]
    grams = [np.einsum("tca,tdb->acdb", rows, rows) for rows, _ in turns[len(few) :]]
    band = Turns(
        np.concatenate([np.zeros((0, 3, 2)), *few]).transpose(1, 2, 0).copy(),
        np.cumsum([0, *map(len, few)]),
        np.array(grams).reshape(-1, 2, 3, 3, 2),
        np.array([float(len(rows)) for rows, _ in turns]),
    )
    by_turns = np.array([variance * np.eye(3) for _, variance in turns]).reshape(1, -1, 3, 3)
    noise = Noise(
        np.ones((1, 3, 1)),
        beside.reshape(1, -1, 3, 3),
        np.full((1, len(first) - 1, 1), 1e-12),
        np.zeros(1),
        by_turns,
    )
    placed = Placed(0, np.zeros((1, 1)), 1.0, np.full((1, 1), own_sd))
    weights = np.ones((1, 2, 3))
    turned = np.repeat(2.0 * weights[:, None], len(turns), axis=1)
    return kernel.normal_equations(weights, turned, noise, entries, slow, fast, band, placed)


def test_inner_products_of_modes_are_the_sums_written_out() -> None:
    """White noise of three unlike axes: Σ over modes of (y_k)ᵀ W y_l."""
    beside = positive(3, 9) + np.eye(3)
    normal, log_scale, _ = equations(beside)
    modes = np.random.default_rng(2).standard_normal((3, 2, 4))
    covariance = beside + 1e-12
    wanted = np.einsum("akm,ab,blm->kl", modes, np.linalg.inv(covariance), modes)
    assert normal[0] == pytest.approx(wanted, rel=1e-9)
    assert log_scale[0] == pytest.approx(-2.0 * np.linalg.slogdet(covariance)[1], rel=1e-9)


def test_slow_bands_have_noise_of_their_own() -> None:
    """One mode with one covariance, three with another: the sums of both, and of determinants."""
    beside = np.stack([positive(3, 9), positive(3, 10)]) + np.eye(3)
    normal, log_scale, _ = equations(beside, first=(0, 1, 4))
    modes = np.random.default_rng(2).standard_normal((3, 2, 4))
    own = (modes[..., :1], modes[..., 1:])
    covariances = beside + 1e-12
    wanted = sum(
        np.einsum("akm,ab,blm->kl", of_band, np.linalg.inv(covariance), of_band)
        for of_band, covariance in zip(own, covariances, strict=True)
    )
    assert normal[0] == pytest.approx(wanted, rel=1e-9)
    log_dets = np.linalg.slogdet(covariances)[1]
    assert log_scale[0] == pytest.approx(-0.5 * (log_dets[0] + 3.0 * log_dets[1]), rel=1e-9)


def test_turns_add_their_own_products_and_determinants() -> None:
    """Integrated rows with weights and noise of their own: Σ (w y)ᵀ (w y)/σ², −½ · 3 N log σ².

    The first band has two modes, the second is a Gram matrix.
    """
    beside, rows = positive(3, 9) + np.eye(3), np.random.default_rng(5).standard_normal((7, 3, 2))
    without = equations(beside)
    with_turns = equations(beside, turns=((rows[:2], 0.3), (rows[2:], 0.5)))
    added = 4.0 * np.einsum("t,tca,tcb->ab", 1.0 / np.r_[[0.3] * 2, [0.5] * 5], rows, rows)
    assert with_turns[0][0] - without[0][0] == pytest.approx(added, rel=1e-9)
    log_scale = -0.5 * 3 * (2 * np.log(0.3) + 5 * np.log(0.5))
    assert with_turns[1][0] - without[1][0] == pytest.approx(log_scale)


def test_noise_that_is_none_has_no_density() -> None:
    """A covariance with a negative direction gives −∞ and nothing that is not a number."""
    normal, log_scale, _ = equations(np.diag([1.0, 1.0, -1.0]))
    assert log_scale[0] == -np.inf
    assert not normal.any()


def test_standard_normals_are_integrated_out_as_a_normal_is() -> None:
    """∫ exp(−½ |y − X θ − Z ξ|²) N(ξ; 0, 1): covariance 1 + Z Zᵀ of y, for one point in density."""
    rng = np.random.default_rng(6)
    design = rng.standard_normal((30, 5))  # two standard normals, two others, the measured
    normal = np.stack([design.T @ design, np.zeros((5, 5))])
    found, log_scale = kernel.without_first(normal, 2, np.array([0.3, -np.inf]))
    covariance = np.eye(30) + design[:, :2] @ design[:, :2].T
    wanted = design[:, 2:].T @ np.linalg.solve(covariance, design[:, 2:])
    assert found[0] == pytest.approx(wanted, rel=1e-9)
    assert log_scale[0] == pytest.approx(0.3 - 0.5 * np.linalg.slogdet(covariance)[1])
    assert log_scale[1] == -np.inf
    assert not found[1].any()


def test_own_unknowns_are_integrated_out_as_a_normal_is() -> None:
    """Against the normal distribution written out, own unknowns and thrusts of unlike scales."""
    rng = np.random.default_rng(4)
    thrusters, own = 2, 3
    size = thrusters + own + 1
    rough = rng.standard_normal((size, 3 * size))
    normal, mean = (rough @ rough.T)[None], rng.standard_normal(own)
    sd, common = np.array([[10.0, 0.1, 1.0]]), np.array([0.7])
    thrust = np.array([0.72, 0.65])
    factor, shift, coupling, matrix, vector, constant = kernel.without_own(
        normal, thrusters, mean, sd, common
    )
    departure = thrust - common
    found = constant[0] + vector[0] @ departure - 0.5 * departure @ matrix[0] @ departure
    # ∫ exp(−½ |y − X θ|²) N(own; mean, sd²), a quadratic form in the own unknowns
    to_own, square = normal[0, thrusters:-1, thrusters:-1], np.diag(sd[0] ** -2)
    pull = normal[0, thrusters:-1, -1] - normal[0, thrusters:-1, :thrusters] @ thrust
    pull = pull + mean / sd[0] ** 2
    precision = to_own + square
    fit = normal[0, -1, -1] - 2.0 * thrust @ normal[0, :thrusters, -1]
    fit += thrust @ normal[0, :thrusters, :thrusters] @ thrust
    wanted = -0.5 * (fit + (mean / sd[0]) @ (mean / sd[0]))
    wanted += 0.5 * pull @ np.linalg.solve(precision, pull)
    wanted -= 0.5 * np.linalg.slogdet(precision)[1] + np.log(sd[0]).sum()
    assert found == pytest.approx(wanted, rel=1e-9)
    white = np.linalg.solve(factor[0].T, shift[0] - coupling[0] @ thrust)
    assert mean + sd[0] * white == pytest.approx(np.linalg.solve(precision, pull), rel=1e-8)


def test_own_unknowns_without_a_precision_have_no_density() -> None:
    """Normal equations that no data give: −∞, and information of zero."""
    normal = -10.0 * np.eye(3)[None]
    found = kernel.without_own(normal, 1, np.zeros(1), np.ones((1, 1)), np.zeros(1))
    assert found[-1][0] == -np.inf
    assert not found[3].any()
    assert np.isfinite(found[0]).all()


def made_up_noise(rng: np.random.Generator, one: bool) -> tuple[Array, ...]:
    """Momentum per rate, wheels' and noise of five points, the noise of one for all or of each."""
    n, wheels, bands = 5, 2, 4
    m = 1 if one else n
    inertia = np.diag([3.0, 2.0, 1.0]) + 0.1 * rng.standard_normal((n, 3, 3))
    own = 0.1 * rng.standard_normal((n, 3, wheels))
    root = rng.standard_normal((m, bands, 3, 3))
    left_open = 1e-4 * root @ np.swapaxes(root, -1, -2)
    return inertia, own, left_open, rng.uniform(1.0, 2.0, m)


@pytest.mark.parametrize("one", [True, False])
def test_turns_have_the_gain_and_the_covariance_of_the_formula(one: bool) -> None:
    """(1 + Q) I Σ_θ Iᵀ (1 + Q)ᵀ + D + Q D with Q = D A⁻¹ per summed rate, by matrices."""
    rng = np.random.default_rng(3)
    inertia, own, left_open, level = made_up_noise(rng, one)
    m, bands = len(level), left_open.shape[1]
    wheel, repeated = rng.uniform(1.0, 2.0, (m, 2)), rng.uniform(0.0, 0.1, (m, HARMONICS))
    sums = TurnSums(rng.uniform(1.0, 9.0, bands), rng.uniform(0.0, 1.0, (bands, HARMONICS, 2)))
    walked = rng.uniform(0.0, 2.0, bands)
    noise = TurnVariances(0.01 * level, 0.02 * level, wheel, repeated, 0.03 * level)
    by_rate = 1.1 * inertia
    gain, covariance = gain_and_covariance(by_rate, inertia, own, noise, left_open, sums, walked)
    for i in range(len(inertia)):
        p = 0 if one else i
        for t in range(bands):
            of_wheels = sums.summed_s2[t] * wheel[p] + repeated[p] @ sums.rounded_s2[t]
            shared = own[i] @ np.diag(of_wheels) @ own[i].T + left_open[p, t]
            shared += 0.03 * level[p] * walked[t] * np.eye(3)
            gyro = sums.summed_s2[t] * 0.01 * level[p] * by_rate[i] @ by_rate[i].T
            q = shared @ np.linalg.inv(gyro)
            turn = 0.02 * level[p] * inertia[i] @ inertia[i].T
            plain = (np.eye(3) + q) @ turn @ (np.eye(3) + q).T + shared + q @ shared
            np.testing.assert_allclose(gain[i, t], q, rtol=1e-10, atol=1e-14)
            np.testing.assert_allclose(covariance[i, t], plain, rtol=1e-10, atol=1e-14)


@pytest.mark.parametrize("one", [True, False])
def test_flat_rows_have_the_determinant_of_every_mode(one: bool) -> None:
    """Slow bands mode by mode, the constant by eigenvalues, a fast one as often as it has rows."""
    rng = np.random.default_rng(4)
    inertia, own, left_open, level = made_up_noise(rng, one)
    first, walk = np.array([0, 2, 5]), rng.uniform(0.1, 9.0, 5)
    constant = rng.standard_normal(5)
    flat = FlatRows(first, walk, constant, np.array([1]), np.array([7.0]), np.array([0.4]))
    variance = rng.uniform(0.1, 0.2, (len(level), left_open.shape[1], 2))
    white = 0.01 * inertia @ np.swapaxes(inertia, -1, -2)
    found = log_of_flat_rows(white, left_open, own, variance, 0.03 * level, flat)
    for i in range(len(inertia)):
        p = 0 if one else i
        noise = white[i] + left_open[p] + (own[i] * variance[p][:, None]) @ own[i].T
        values = np.concatenate(
            [
                np.linalg.eigvalsh(noise[s]) + 0.03 * level[p] * walk[m]
                for s in range(2)
                for m in range(first[s], first[s + 1])
            ]
        ).reshape(5, 3)
        plain = np.log(values).sum() + np.log((constant[:, None] ** 2 / values).sum(0)).sum()
        fast = noise[3] + 0.03 * level[p] * 0.4 * np.eye(3)
        assert found[i] == pytest.approx(plain + 7.0 * np.linalg.slogdet(fast)[1], rel=1e-12)
