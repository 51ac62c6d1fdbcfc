"""Weights, their errors, power scaling and the worth of knowledge, against closed forms."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
import xarray as xr

from cassini_bayes.sweep.coordinates import Coordinates
from cassini_bayes.sweep.knowledge import knowledge_table, residual_ratio
from cassini_bayes.sweep.scaling import cjs_distance, power_scaling
from cassini_bayes.sweep.weights import (
    Weights,
    batch_labels,
    change_between,
    change_on_same_draws,
    equal_weights,
    error_of,
    influence,
    moments,
    smoothed_weights,
)


def normal_ratio(x: np.ndarray, mean: float, sd: float) -> np.ndarray:
    """log N(x; mean, sd²) − log N(x; 0, 1)."""
    return np.asarray(-0.5 * ((x - mean) / sd) ** 2 - np.log(sd) + 0.5 * x**2)


@pytest.mark.statistical
def test_weighted_moments_and_errors_match_the_changed_normal() -> None:
    """Over 100 sets of draws the shift and width are unbiased and their errors are honest."""
    rng = np.random.default_rng(1)
    batches = batch_labels(4, 500)
    shifts, widths = [], []
    for _ in range(100):
        x = rng.standard_normal((2_000, 1))
        weights = smoothed_weights(normal_ratio(x[:, 0], 0.3, 0.8))
        change = change_on_same_draws(x, x, weights.values, batches)
        # both in units of the true baseline: the sample's own sd scatters with the estimate
        scale = x.std()
        shifts.append((change.shift[0] * scale - 0.3) / (change.shift_error[0] * scale))
        widths.append((change.width[0] - 0.8) / change.width_error[0])
    for scores in (np.array(shifts), np.array(widths)):
        assert abs(scores.mean()) < 4.5 / np.sqrt(100)
        assert 0.8 < scores.std() < 1.3


def test_untrusted_weights_are_seen() -> None:
    """Negative control: a four times wider target is not trusted; a shifted one is."""
    x = np.random.default_rng(2).standard_normal(4_000)
    assert not smoothed_weights(normal_ratio(x, 0.0, 4.0)).trusted
    assert smoothed_weights(normal_ratio(x, 0.5, 1.0)).trusted


def test_degenerate_weights() -> None:
    """Equal ratios give equal weights; hardly any draw inside the support gives none at all."""
    assert smoothed_weights(np.full(400, 3.0)).values == pytest.approx(1 / 400)
    ratio = np.full(400, -np.inf)
    ratio[:20] = 0.0
    nothing = smoothed_weights(ratio)
    assert not nothing.trusted
    assert np.isnan(nothing.values).all()
    some = np.where(np.arange(400) < 300, 0.0, -np.inf)
    assert smoothed_weights(some).values[300:].max() == 0.0


def test_weights_come_without_a_warning_of_the_library() -> None:
    """Ratios that crowd at their upper end: ArviZ's fit overflows in trials of weight zero."""
    ratio = -0.1 * np.random.default_rng(0).chisquare(0.5, size=20_000)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        weights = smoothed_weights(ratio)
    assert weights.trusted
    assert weights.values == pytest.approx(np.exp(ratio) / np.exp(ratio).sum(), rel=1e-3)


def test_few_effective_draws_are_not_trusted() -> None:
    """A bounded ratio has a good k̂ however few draws it leaves; their number decides then."""
    assert not Weights(np.ones(10) / 10, 0.1, 250.0).trusted
    assert equal_weights(1_000).trusted


def test_batches_count_repeated_draws_once() -> None:
    """Each draw written ten times in a row: the error with batches is √10 times the naive one."""
    x = np.repeat(np.random.default_rng(3).standard_normal((4_000, 1)), 10, axis=0)
    on_mean, _ = influence(x, equal_weights(len(x)).values)
    naive, honest = error_of(on_mean, None), error_of(on_mean, batch_labels(4, 10_000))
    assert honest[0] / naive[0] == pytest.approx(np.sqrt(10), rel=0.35)


def test_change_between_independent_draws() -> None:
    """Two sets of draws: shift and width in units of the first, errors added in quadrature."""
    rng = np.random.default_rng(4)
    base, other = rng.normal(1.0, 2.0, (4_000, 1)), rng.normal(2.0, 1.0, (4_000, 1))
    change = change_between(base, batch_labels(4, 1_000), other, np.full(4_000, 1 / 4_000), None)
    assert change.shift[0] == pytest.approx(0.5, abs=5 * change.shift_error[0])
    assert change.width[0] == pytest.approx(0.5, abs=5 * change.width_error[0])
    assert change.shift_error[0] == pytest.approx(np.sqrt(1 + 0.25) / np.sqrt(4_000), rel=0.2)


def test_quantiles_of_weighted_draws() -> None:
    """Weighted quantiles are those of the target."""
    x = np.random.default_rng(5).standard_normal((20_000, 1))
    weights = smoothed_weights(normal_ratio(x[:, 0], 0.5, 0.9))
    quantiles = moments(x, weights.values).quantiles[:, 0]
    assert quantiles[99] == pytest.approx(0.5, abs=0.03)
    assert quantiles[189] == pytest.approx(0.5 + 0.9 * 1.645, abs=0.08)


def test_power_scaling_agrees_with_arviz() -> None:
    """The same sensitivities as arviz.psens for a normal mean with prior and likelihood."""
    import arviz

    rng = np.random.default_rng(6)
    draws = rng.normal(0.8, np.sqrt(0.5), (4, 1_000))  # prior N(0, 1), datum 1.6 with sd 1
    log_prior, log_likelihood = -0.5 * draws**2, -0.5 * (draws - 1.6) ** 2
    data = arviz.from_dict(posterior={"mu": draws})
    dims = ("chain", "draw")
    data.add_groups(
        {
            "log_prior": xr.Dataset({"mu": (dims, log_prior)}),
            "log_likelihood": xr.Dataset({"y": (dims, log_likelihood)}),
        }
    )
    theirs = [float(arviz.psens(data, component=part)["mu"]) for part in ("prior", "likelihood")]
    parts = {"prior": log_prior.reshape(-1), "likelihood": log_likelihood.reshape(-1)}
    ours = power_scaling(parts, ["mu"], draws.reshape(-1, 1), ["N"])["sensitivity"].to_list()
    assert ours == pytest.approx(theirs, rel=0.1)
    assert min(ours) > 0.05


def test_power_scaling_of_what_does_not_matter_is_nil() -> None:
    """Negative control: a density that does not vary with the quantity has no sensitivity."""
    rng = np.random.default_rng(7)
    other = {"idle": -0.5 * rng.standard_normal(4_000) ** 2}
    table = power_scaling(other, ["mu"], rng.standard_normal((4_000, 1)), ["N"])
    assert table["sensitivity"][0] < 0.02
    assert not table["sensitive"][0]


def test_distance_is_zero_for_equal_weights_and_grows_with_a_shift() -> None:
    """The Jensen-Shannon distance of draws to themselves is nil, to shifted ones is not."""
    x = np.random.default_rng(8).standard_normal(2_000)
    assert cjs_distance(x, np.full(2_000, 1 / 2_000)) == pytest.approx(0.0, abs=1e-6)
    near, far = (
        cjs_distance(x, smoothed_weights(normal_ratio(x, m, 1.0)).values) for m in (0.1, 0.4)
    )
    assert 0.0 < near < far


def test_knowledge_is_the_residual_of_the_regression() -> None:
    """Correlation 0.8 leaves 60 % of the width; a square leaves what it does not explain."""
    rng = np.random.default_rng(9)
    known = rng.standard_normal((8_000, 1))
    noise = rng.standard_normal(8_000)
    values = np.stack(
        [0.8 * known[:, 0] + 0.6 * noise, known[:, 0] ** 2 / np.sqrt(2), noise], axis=-1
    )
    ratio, error = residual_ratio(known, values, batch_labels(4, 2_000))
    assert ratio[0] == pytest.approx(0.6, abs=5 * error[0])
    assert error[0] == pytest.approx(0.6 * 0.8 / np.sqrt(8_000), rel=0.6)  # delta method, ρ √(1−ρ²)
    assert ratio[1] < 0.01
    assert ratio[2] == pytest.approx(1.0, abs=0.002)


def test_knowledge_table_has_blocks_and_parameters() -> None:
    """A block of two parameters is listed as a whole and one by one; the whole is worth most."""
    rng = np.random.default_rng(10)
    draws = rng.standard_normal((4_000, 2))
    blocks = {"pair": Coordinates(("a", "b"), draws, draws)}
    values = (draws @ [1.0, 2.0] + rng.standard_normal(4_000))[:, None]
    table = knowledge_table(blocks, 4, ["q"], values, ["N"]).set_index("known")["width_ratio"]
    assert table["pair"] == pytest.approx(np.sqrt(1 / 6), rel=0.05)
    assert table["pair"] < table["b"] < table["a"] < 1.0
