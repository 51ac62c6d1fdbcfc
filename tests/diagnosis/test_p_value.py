"""The p-value of the baseline: uniform on the model, small where something is left."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cassini_bayes.balance.linearised import Linear
from cassini_bayes.balance.part_columns import ColumnsByPart
from cassini_bayes.diagnosis.p_value import line_statistic, p_value

TIME = np.arange(150.0)
TRIALS = 160


def drawn(rng: np.random.Generator) -> Linear:
    """Whitened data of a linear model with five unknowns."""
    columns = rng.standard_normal((450, 5))
    target = columns @ rng.standard_normal(5) + rng.standard_normal(450)
    return Linear(target, ColumnsByPart.of(columns, [450]), np.ones(5))


def test_p_value_is_uniform_on_the_model() -> None:
    """Data of the linear model give uniform p-values: Kolmogorov-Smirnov at one percent."""
    rng = np.random.default_rng(11)
    values = np.sort([p_of(drawn(rng), rng, 99) for _ in range(TRIALS)])
    gap = np.abs(values - (np.arange(TRIALS) + 0.5) / TRIALS).max()
    assert gap < 1.63 / np.sqrt(TRIALS)
    assert (values < 0.05).mean() < 0.11  # the binomial 99.9 % point of 160 trials


@pytest.mark.parametrize("cycles", [0.5, 30.0, 61.3])
def test_drifts_and_oscillations_give_small_p(cycles: float) -> None:
    """A drift and lines at any frequency are seen; the same line with no size is not."""
    rng = np.random.default_rng(3)
    linear = drawn(rng)
    line = np.repeat(np.cos(2.0 * np.pi * cycles * TIME / 150.0), 3)
    shown = replace(linear, target=linear.target + 0.8 * line)
    assert p_of(shown, rng, 199) <= 2 / 200
    assert p_of(linear, rng, 199) > 0.05


def p_of(linear: Linear, rng: np.random.Generator, replicates: int) -> float:
    """Of a target about the prior mean."""
    return p_value(linear, linear.target, [TIME], rng, replicates)


def test_a_target_about_the_mode_is_put_back_about_the_prior_mean() -> None:
    """Slow unknowns that data hardly tell: fitted about the mode, the data are fitted twice.

    Replicates are fitted once, so that p then comes out too large (0.66 on average).
    """
    rng = np.random.default_rng(5)
    slow = np.cos(np.pi * np.outer(TIME, np.arange(1, 9)) / TIME[-1])
    slow *= np.sqrt(0.3 / (slow**2).sum(axis=0))
    columns = np.kron(slow, np.eye(3))
    right, twice = [], []
    for _ in range(60):
        linear = replace(
            drawn(rng), columns=ColumnsByPart.of(columns, [450]), precision=np.ones(24)
        )
        target = columns @ rng.standard_normal(24) + rng.standard_normal(450)
        z = np.linalg.solve(columns.T @ columns + np.eye(24), columns.T @ target)
        about = replace(linear, target=target - columns @ z)
        right.append(p_value(about, about.about_prior_mean(z), [TIME], rng, 99))
        twice.append(p_value(about, about.target, [TIME], rng, 99))
    error = 1.0 / np.sqrt(12.0 * 60)
    assert abs(np.mean(right) - 0.5) < 3.0 * error
    assert np.mean(twice) > 0.5 + 3.0 * error


def test_line_statistic_of_one_line_with_gaps() -> None:
    """A line of amplitude a over n rows has power a² n/4 at its frequency, gaps or not."""
    time = np.delete(np.arange(400.0), np.arange(100, 180))
    target = np.zeros((3 * len(time), 1))
    target[1::3, 0] = 2.0 * np.cos(2.0 * np.pi * 0.125 * time)
    nothing = ColumnsByPart.of(np.zeros((len(target), 1)), [len(target)])
    linear = Linear(target[:, 0], nothing, np.ones(1))
    assert line_statistic(linear, target, [time])[0] == pytest.approx(len(time), rel=0.03)
