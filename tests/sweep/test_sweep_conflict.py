"""Prior-data conflict against exact normal models, and the sentences that say it."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr
from scipy.stats import chi2, norm
from sweep_cases import small_fit

from cassini_bayes.computing.arrays import Array
from cassini_bayes.results.record import Fit
from cassini_bayes.sweep.conflict import (
    conflict_table,
    predictive_p_value,
    pull_after,
    pull_before,
)
from cassini_bayes.sweep.coordinates import Coordinates, block_coordinates

NOISE = 0.5


def linear_case(datum: Array, seed: int = 1) -> tuple[Coordinates, Fit]:
    """z ~ N(0, 1)² and y = z₁ + noise, z₂ + noise, a third y of noise alone; z₃ is never seen."""
    rng = np.random.default_rng(seed)
    prior = rng.standard_normal((4_000, 3))
    predictive = np.concatenate([prior[:, :2], np.zeros((4_000, 1))], axis=1)
    predictive = predictive + NOISE * rng.standard_normal((4_000, 3))
    gain = 1.0 / (1.0 + NOISE**2)
    posterior = rng.standard_normal((4_000, 3))
    posterior[:, :2] = gain * datum[:2] + np.sqrt(1.0 - gain) * posterior[:, :2]

    def on_times(values: Array, dims: tuple[str, ...]) -> xr.Dataset:
        return xr.Dataset(
            {"on_time_s": (dims, values)}, coords={"event": ["one"], "thruster": ["a", "b", "c"]}
        )

    drawn = ("chain", "draw", "event", "thruster")
    groups = {
        "prior_predictive": on_times(predictive[None, :, None, :], drawn),
        "posterior_predictive": on_times(predictive[None, :, None, :], drawn),
        "observed_data": on_times(datum[None], ("event", "thruster")),
    }
    return Coordinates(("z1", "z2", "z3"), prior, posterior), Fit(groups, {})


def exact_p_value(datum: Array) -> float:
    """χ² of the two directions that are seen, mᵀ V⁻¹ m with m = gain y, V = gain."""
    gain = 1.0 / (1.0 + NOISE**2)
    return float(chi2.sf(gain * float(datum[:2] @ datum[:2]), 2))


@pytest.mark.parametrize("datum", [(0.3, -0.4, 0.1), (1.5, 1.0, 0.0), (2.5, -2.0, 0.2)])
def test_pulls_before_and_after_are_those_of_the_exact_model(datum: tuple[float, ...]) -> None:
    """Both p-values equal the exact χ² in a linear model; the unseen direction does not count."""
    y = np.array(datum)
    own, fit = linear_case(y)
    after, before = pull_after(own), pull_before(own, fit)
    assert after.directions == before.directions == 2
    for pull in (after, before):
        assert np.log(pull.p_value) == pytest.approx(np.log(exact_p_value(y)), abs=0.35)
    strongest = 0 if abs(datum[0]) > abs(datum[1]) else 1
    assert after.parameter == f"z{strongest + 1}"
    assert after.pull == pytest.approx(datum[strongest] / np.sqrt(1 + NOISE**2), abs=0.15)


def test_conflict_is_found_and_agreement_is_not_called_one() -> None:
    """A datum five deviations out is a conflict before and after; one within is not."""
    for datum, verdict in (((5.6, 0.0, 0.0), "conflict"), ((0.7, 0.0, 0.0), "agree")):
        own, fit = linear_case(np.array(datum))
        table = conflict_table({"pair": own}, fit)
        assert list(table["verdict"]) == [verdict, verdict]
        words = "disagree" if verdict == "conflict" else "agree with"
        assert words in table["sentence"][0]
        assert "z1" in table["sentence"][0]
        assert ("are not what" in table["sentence"][1]) == (verdict == "conflict")


def test_a_block_the_data_do_not_tell_is_said_to_be_returned() -> None:
    """Posterior equal to prior: no p-value, and the sentence says so."""
    draws = np.random.default_rng(2).standard_normal((4_000, 2))
    own, fit = linear_case(np.array([0.1, 0.2, 0.0]))
    table = conflict_table({"idle": Coordinates(("a", "b"), draws, draws[::-1])}, fit)
    assert table["verdict"][0] == "not told"
    assert "prior is returned" in table["sentence"][0]
    assert own.names[0] == "z1"


@pytest.mark.statistical
def test_event_p_values_are_uniform_when_the_model_is_right() -> None:
    """The predictive p-value of data from the same distribution is uniform (mean, 4.5 s.e.)."""
    rng = np.random.default_rng(3)
    mix = rng.standard_normal((3, 3))
    p_values = []
    for _ in range(200):
        draws = rng.standard_t(5, (400, 3)) @ mix
        p_values.append(predictive_p_value(draws, rng.standard_t(5, 3) @ mix))
    assert abs(np.mean(p_values) - 0.5) < 4.5 / np.sqrt(12 * 200)
    far = predictive_p_value(rng.standard_normal((400, 3)), np.full(3, 8.0))
    assert far == pytest.approx(1 / 401)


def test_coordinates_of_flight_blocks_are_standard_before_the_data() -> None:
    """Every block's prior draws have mean 0 and deviation 1; the tail-off's posterior does not."""
    factory, fit = small_fit()
    blocks = block_coordinates(factory.build(factory.priors), factory.priors, fit)
    assert {"thrust", "torque", "tail-off", "centre of mass"} <= set(blocks)
    for own in blocks.values():
        assert np.abs(own.prior.mean(0)).max() < 4.5 / np.sqrt(len(own.prior))
        assert np.abs(own.prior.std(0) - 1).max() < 4.5 / np.sqrt(2 * len(own.prior))
        assert own.posterior.shape[1] == len(own.names)
    table = conflict_table(blocks, fit).set_index("name")
    assert set(table["verdict"]) <= {"agree", "not told"}
    assert table.loc["2009-08-22-bias", "p_before"] > 0.01
    assert norm.isf(0.5 * table.loc["thrust", "p_after"]) < 4.0
