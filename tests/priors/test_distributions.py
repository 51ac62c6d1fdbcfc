"""Every prior distribution passes one family of identities, with scipy as the oracle."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats
from scipy.special import log_ndtr, ndtr

from cassini_bayes.computing.arrays import Array
from cassini_bayes.errors import InputError
from cassini_bayes.files.checks import finite_number, nearest
from cassini_bayes.priors.distributions import Distribution, distribution_names, keywords_of


@dataclass(frozen=True)
class Case:
    """A distribution under test and scipy's own object for it, before truncation."""

    name: str
    keywords: dict[str, float]
    low: float | None = None
    high: float | None = None

    @property
    def ours(self) -> Distribution:
        return Distribution(self.name, self.keywords, self.low, self.high)

    @property
    def scipys(self) -> Any:
        return getattr(stats, self.name)(**self.keywords)

    @property
    def ends(self) -> tuple[float, float]:
        left, right = self.scipys.support()
        return (
            left if self.low is None else max(left, self.low),
            right if self.high is None else min(right, self.high),
        )

    @property
    def mass(self) -> float:
        left, right = self.ends
        base = self.scipys
        upper = base.sf(left) - base.sf(right)
        return float(upper if base.sf(left) < 0.5 else base.cdf(right) - base.cdf(left))

    def __str__(self) -> str:
        return repr(self.ours)


CASES = (
    Case("norm", {"loc": 0.13, "scale": 0.013}),
    Case("norm", {"loc": 0.05, "scale": 0.02}, low=0.0),
    Case("norm", {"loc": 0.0, "scale": 1.0}, high=0.5),
    Case("norm", {"loc": 2.0, "scale": 3.0}, -1.0, 4.0),
    Case("norm", {"loc": 0.0, "scale": 1.0}, low=3.0),
    Case("norm", {"loc": 0.0, "scale": 1.0}, high=-3.0),
    Case("lognorm", {"s": 0.5, "scale": 4e-5}),
    Case("lognorm", {"s": 1.0, "loc": 1.0, "scale": 2.0}, 2.0, 5.0),
    Case("lognorm", {"s": 1.0, "loc": 1.0, "scale": 2.0}, low=0.5),
    Case("uniform", {"loc": 2292.2, "scale": 1061.5}),
    Case("uniform", {"loc": -1.0, "scale": 3.0}, low=0.0),
    Case("halfnorm", {"scale": 2e-3}),
    Case("halfnorm", {"loc": 1.0, "scale": 2.0}, 1.5, 4.0),
    Case("t", {"df": 4.0, "loc": 1.0, "scale": 0.1}),
    Case("t", {"df": 4.0, "loc": 1.0, "scale": 0.1}, low=0.9),
    Case("gamma", {"a": 3.0, "scale": 0.2}),
    Case("gamma", {"a": 3.0, "scale": 0.2}, high=1.0),
    Case("beta", {"a": 2.0, "b": 5.0}),
    Case("beta", {"a": 2.0, "b": 5.0, "loc": -1.0, "scale": 2.0}, -0.9, 0.5),
    Case("truncnorm", {"a": -1.0, "b": 2.0, "loc": 1.0, "scale": 3.0}),
    Case("weibull_min", {"c": 2.0, "scale": 3.0}),
    Case("cauchy", {"loc": 1.0, "scale": 0.5}, -4.0, 4.0),
)
every_case = pytest.mark.parametrize("case", CASES, ids=str)

Z = np.linspace(-6.0, 6.0, 121)


@every_case
def test_cdf_undoes_quantile(case: Case) -> None:
    """F(θ(z)) = Φ(z), with scipy's cdf renormalised between the bounds."""
    x = case.ours.quantile_of_standard(Z)
    below = (case.scipys.cdf(x) - case.scipys.cdf(case.ends[0])) / case.mass
    np.testing.assert_allclose(below, ndtr(Z), rtol=0, atol=1e-12)


@every_case
def test_upper_tail_is_as_good_as_the_lower(case: Case) -> None:
    """1 − F(θ(z)) = Φ(−z) with scipy's survival function, where the cdf has no digits left."""
    z = np.linspace(0.0, 6.0, 61)
    x = case.ours.quantile_of_standard(z)
    above = (case.scipys.sf(x) - case.scipys.sf(case.ends[1])) / case.mass
    # A value next to a bound cannot be told from it by more than its own last digit, and the
    # oracle subtracts numbers near sf(left).
    grain = np.spacing(np.abs(x)) * np.exp(case.ours.log_density(x))
    oracle = 4 * np.spacing(case.scipys.sf(case.ends[0])) / case.mass
    assert np.all(np.abs(above - ndtr(-z)) <= 1e-9 * ndtr(-z) + 8 * grain + oracle)


@every_case
def test_standard_of_undoes_quantile(case: Case) -> None:
    """standard_of(quantile_of_standard(z)) = z for |z| ≤ 6; bounds away from 0 cost digits."""
    x = case.ours.quantile_of_standard(Z)
    np.testing.assert_allclose(case.ours.standard_of(x), Z, rtol=0, atol=1e-6)


@every_case
def test_quantile_increases_and_stays_inside(case: Case) -> None:
    """θ(z) never decreases and never leaves the bounds, far beyond any z that is walked."""
    # scipy's inverse of beta gives up, with a warning, at probabilities below 1e-100.
    reach = 15.0 if case.name == "beta" else 30.0
    z = np.linspace(-reach, reach, 601)
    x = case.ours.quantile_of_standard(z)
    assert np.all(np.diff(x) >= 0)
    assert np.all(np.isfinite(x))
    assert case.ends[0] <= x[0]
    assert x[-1] <= case.ends[1]
    inner = case.ours.quantile_of_standard(np.linspace(-5.0, 5.0, 101))
    assert np.all(np.diff(inner) > 0)


def integral(values: Callable[[Array], Array], edges: Array) -> float:
    """Gauss-Legendre quadrature of forty nodes between each two neighbouring edges."""
    nodes, weights = np.polynomial.legendre.leggauss(40)
    half = 0.5 * np.diff(edges)[:, None]
    x = 0.5 * (edges[1:] + edges[:-1])[:, None] + half * nodes
    return float((half * weights * values(x)).sum())


TAIL = np.geomspace(1e-12, 0.1, 23)
PROBABILITIES = np.concatenate([TAIL, np.linspace(0.1, 0.9, 17)[1:-1], 1.0 - TAIL[::-1]])


@every_case
def test_density_integrates_to_one(case: Case) -> None:
    """∫ exp(log_density) over the support is 1 by quadrature between quantiles of scipy."""
    left, right = case.ends
    inside = case.scipys.ppf(PROBABILITIES)
    between = inside[(inside > left) & (inside < right)]
    edges = np.concatenate([[end] for end in (left, right) if math.isfinite(end)] + [between])
    if case.low == 3.0:  # all of it lies beyond scipy's quantiles
        edges = np.linspace(3.0, 12.0, 10)
    if case.high == -3.0:
        edges = np.linspace(-12.0, -3.0, 10)
    total = integral(lambda x: np.exp(case.ours.log_density(x)), np.unique(edges))
    assert total == pytest.approx(1.0, abs=3e-9)


@every_case
def test_log_density_is_scipys_renormalised(case: Case) -> None:
    """log p = scipy's logpdf − log(mass between the bounds), −inf outside."""
    x = case.ours.quantile_of_standard(np.linspace(-5.0, 5.0, 41))
    expected = case.scipys.logpdf(x) - math.log(case.mass)
    np.testing.assert_allclose(case.ours.log_density(x), expected, rtol=1e-9, atol=1e-9)
    left, right = case.ends
    outside = [end + step for end, step in ((left, -0.1), (right, 0.1)) if math.isfinite(end)]
    assert np.all(np.isneginf(case.ours.log_density(outside)))


@every_case
def test_density_in_z_follows_from_the_change_of_variables(case: Case) -> None:
    """log p(θ(z)) + log dθ/dz = log N(z; 0, 1), the derivative by central differences."""
    z, step = np.linspace(-4.0, 4.0, 33), 1e-4
    ours = case.ours
    ends = ours.quantile_of_standard(np.stack([z - step, z + step]))
    log_slope = np.log((ends[1] - ends[0]) / (2 * step))
    walked = ours.log_density(ours.quantile_of_standard(z)) + log_slope
    np.testing.assert_allclose(walked, stats.norm.logpdf(z), rtol=0, atol=2e-6)


@pytest.mark.statistical
@every_case
def test_samples_follow_scipys_distribution(case: Case) -> None:
    """A Kolmogorov-Smirnov test of 4000 draws against scipy's truncated cdf."""
    draws = case.ours.sample(np.random.default_rng(7), 4000)
    lower = case.scipys.cdf(case.ends[0])
    fit = stats.kstest(draws, lambda x: (case.scipys.cdf(x) - lower) / case.mass)
    assert fit.pvalue > 1e-3


@pytest.mark.statistical
def test_the_sample_test_would_notice_clipping() -> None:
    """Negative control: the same test rejects a normal clipped, not truncated, at its bound."""
    clipped = np.maximum(stats.norm(0.05, 0.02).rvs(4000, random_state=7), 0.02)
    prior = Distribution("norm", {"loc": 0.05, "scale": 0.02}, low=0.02)
    fit = stats.kstest(clipped, lambda x: ndtr(prior.standard_of(x)))
    assert fit.pvalue < 1e-6


@every_case
def test_moments_agree_with_quadrature(case: Case) -> None:
    """mean() and sd() are the moments of the density, by quadrature in standard normals."""
    edges = np.linspace(-15.0, 15.0, 61)

    def moment(power: int) -> float:
        return integral(
            lambda z: case.ours.quantile_of_standard(z) ** power * stats.norm.pdf(z), edges
        )

    mean = moment(1)
    assert case.ours.mean() == pytest.approx(mean, rel=1e-6, abs=1e-9)
    assert case.ours.sd() == pytest.approx(math.sqrt(moment(2) - mean**2), rel=1e-5)


def test_truncated_normal_matches_scipys_truncnorm() -> None:
    """Bounds on norm give what scipy's truncnorm gives, a separate implementation."""
    ours = Distribution("norm", {"loc": 0.05, "scale": 0.02}, 0.0, 0.08)
    scipys = stats.truncnorm(-2.5, 1.5, loc=0.05, scale=0.02)
    x = np.linspace(0.001, 0.079, 40)
    np.testing.assert_allclose(ours.log_density(x), scipys.logpdf(x), rtol=1e-12)
    np.testing.assert_allclose(
        ours.quantile_of_standard(Z), scipys.ppf(ndtr(Z)), rtol=1e-9, atol=1e-16
    )
    assert ours.mean() == pytest.approx(scipys.mean(), rel=1e-9)
    assert ours.sd() == pytest.approx(scipys.std(), rel=1e-9)


@pytest.mark.parametrize("z", [10.0, 20.0, 30.0])
def test_far_tails_stay_exact(z: float) -> None:
    """At |z| up to 30 the tail probabilities still match, in logarithms, where θ can hold them."""
    half = Distribution("halfnorm", {"scale": 2.0})
    assert stats.halfnorm(scale=2.0).logsf(half.quantile_of_standard(z)) == pytest.approx(
        float(log_ndtr(-z)), rel=1e-12
    )
    assert half.standard_of(half.quantile_of_standard(z)) == pytest.approx(z, rel=1e-12)
    assert half.standard_of(half.quantile_of_standard(-z)) == pytest.approx(-z, rel=1e-12)
    above = Distribution("norm", {"loc": 0.0, "scale": 1.0}, low=3.0)
    expected = float(log_ndtr(-z) + log_ndtr(-3.0))
    assert stats.norm.logsf(above.quantile_of_standard(z)) == pytest.approx(expected, rel=1e-12)
    assert above.standard_of(above.quantile_of_standard(z)) == pytest.approx(z, rel=1e-9)
    below = Distribution("norm", {"loc": 0.0, "scale": 1.0}, high=-3.0)
    assert below.quantile_of_standard(-z) == pytest.approx(-above.quantile_of_standard(z))
    unit = Distribution("uniform", {"loc": 0.0, "scale": 1.0})
    assert unit.quantile_of_standard(-z) == pytest.approx(float(ndtr(-z)), rel=1e-12)
    gamma = Distribution("gamma", {"a": 3.0, "scale": 0.2})
    assert gamma.standard_of(gamma.quantile_of_standard(z)) == pytest.approx(z, rel=1e-9)


def test_only_a_plain_normal_is_normal() -> None:
    """is_normal promises θ = mean + sd · z, so bounds and other families must not claim it."""
    plain = Distribution("norm", {"loc": 1.0, "scale": 2.0})
    assert plain.is_normal
    np.testing.assert_allclose(plain.quantile_of_standard(Z), plain.mean() + plain.sd() * Z)
    assert not Distribution("norm", {"loc": 1.0, "scale": 2.0}, low=0.0).is_normal
    assert not Distribution("t", {"df": 3.0}).is_normal
    assert not Distribution("lognorm", {"s": 1.0}).is_normal


@given(
    width=st.floats(0.25, 4.0),
    shift=st.floats(-2.0, 2.0),
    case=st.sampled_from([c for c in CASES if c.name == "norm" and c.low is None is c.high]),
)
def test_scaled_normal(width: float, shift: float, case: Case) -> None:
    """A normal becomes N(loc + shift · sd, (width · sd)²)."""
    changed = case.ours.scaled(width, shift)
    assert changed.mean() == pytest.approx(case.ours.mean() + shift * case.ours.sd())
    assert changed.sd() == pytest.approx(width * case.ours.sd())


@every_case
def test_scaled_keeps_the_support_and_can_be_undone(case: Case) -> None:
    """Widening and narrowing by the same factor gives the distribution back; bounds never move."""
    wide = case.ours.scaled(width=2.0)
    assert (wide.low, wide.high) == (case.ours.low, case.ours.high)
    back = wide.scaled(width=0.5)
    for key, value in case.ours.keywords.items():
        assert back.keywords[key] == pytest.approx(value, rel=1e-12, abs=1e-15)
    assert wide.quantile_of_standard(1.0) - wide.quantile_of_standard(-1.0) > 0


def test_scaled_families() -> None:
    """Log-normals move in the logarithm, one-sided ones keep their edge, intervals their middle."""
    noise = Distribution("lognorm", {"s": 0.5, "scale": 4e-5}).scaled(2.0, 1.0)
    assert dict(noise.keywords) == pytest.approx({"s": 1.0, "scale": 4e-5 * math.exp(0.5)})
    half = Distribution("halfnorm", {"loc": 1.0, "scale": 2.0})
    assert half.scaled(shift=-2.0).support == (1.0, math.inf)
    assert half.scaled(shift=0.01).mean() == pytest.approx(half.mean() + 0.01 * half.sd(), rel=1e-4)
    interval = Distribution("uniform", {"loc": 2.0, "scale": 4.0}).scaled(2.0)
    assert interval.support == pytest.approx((0.0, 8.0))
    moved = Distribution("uniform", {"loc": 2.0, "scale": 4.0}).scaled(shift=1.0)
    assert moved.mean() == pytest.approx(4.0 + 4.0 / math.sqrt(12.0))
    heavy = Distribution("cauchy", {"loc": 1.0, "scale": 0.5}).scaled(2.0, 1.0)
    assert dict(heavy.keywords) == pytest.approx({"loc": 1.5, "scale": 1.0})
    for width, shift in ((0.0, 0.0), (-1.0, 0.0), (math.nan, 0.0), (1.0, math.inf)):
        with pytest.raises(InputError, match="width"):
            half.scaled(width, shift)


def test_moments_that_do_not_exist() -> None:
    """Heavy tails say so instead of inventing a number."""
    assert math.isnan(Distribution("cauchy", {}).sd())
    assert math.isinf(Distribution("t", {"df": 2.0}).sd())
    assert math.isinf(Distribution("t", {"df": 2.0}, low=-1.0).sd())
    assert Distribution("beta", {"a": 2.0, "b": 5.0}, high=0.5).sd() < 0.15  # and no warning


@pytest.mark.parametrize(("df", "mean"), [(2.0, 3.0), (1.5, 3.982)])
def test_a_bound_moves_the_mean_of_heavy_tails(df: float, mean: float) -> None:
    """t about 1 of scale 2, above 0: the mean is that of what is left, and there is no width."""
    heavy = Distribution("t", {"df": df, "loc": 1.0, "scale": 2.0}, low=0.0)
    assert heavy.mean() == pytest.approx(mean, rel=2e-3)
    assert math.isinf(heavy.sd())


def test_distributions_compare_copy_and_rebuild() -> None:
    """Equal by value, hashable, frozen; repr rebuilds the object; copies work across processes."""
    prior = Distribution("norm", {"loc": 0.05, "scale": 0.02}, low=0.0)
    twin = Distribution("norm", {"scale": 0.02, "loc": 0.05}, low=0.0)
    assert prior == twin
    assert hash(prior) == hash(twin)
    assert prior != Distribution("norm", {"loc": 0.05, "scale": 0.02})
    assert repr(prior) == "Distribution('norm', {'loc': 0.05, 'scale': 0.02}, low=0.0)"
    assert copy.deepcopy(prior) == prior
    with pytest.raises(AttributeError):
        prior.low = 1.0  # type: ignore[misc]
    with pytest.raises(TypeError):
        prior.keywords["loc"] = 1.0  # type: ignore[index]


@pytest.mark.parametrize(
    ("name", "keywords", "bounds", "fragments"),
    [
        ("nrom", {}, {}, ["nrom", "did you mean 'norm'"]),
        ("normal", {}, {}, ["did you mean 'norm'"]),
        ("poisson", {"mu": 3.0}, {}, ["poisson", "continuous"]),
        ("rv_continuous", {}, {}, ["rv_continuous", "continuous"]),
        ("norm.rvs", {}, {}, ["norm.rvs"]),
        ("norm", {"mean": 0.0}, {}, ["mean", "loc, scale"]),
        ("norm", {"scael": 1.0}, {}, ["scael", "did you mean 'scale'"]),
        ("lognorm", {"scale": 1.0}, {}, ["lognorm.s", "add s"]),
        ("norm", {"scale": 0.0}, {}, ["scale", "above 0", "fixed"]),
        ("norm", {"scale": -1.0}, {}, ["scale", "above 0"]),
        ("norm", {"scale": math.nan}, {}, ["scale", "finite", "nan"]),
        ("norm", {"loc": math.inf}, {}, ["loc", "finite", "inf"]),
        ("norm", {"loc": True}, {}, ["loc", "number", "True"]),
        ("norm", {"loc": "0.1"}, {}, ["loc", "number", "without quotes"]),
        ("beta", {"a": -1.0, "b": 2.0}, {}, ["beta", "domain", "a = -1.0"]),
        ("norm", {}, {"low": 1.0, "high": 1.0}, ["low", "below high"]),
        ("norm", {}, {"low": 2.0, "high": 1.0}, ["low", "swap"]),
        ("norm", {}, {"low": math.nan}, ["low", "finite"]),
        ("norm", {}, {"low": 40.0}, ["probability", "40.0"]),
        ("uniform", {}, {"low": 2.0}, ["probability", "uniform"]),
        ("gamma", {"a": 2.0}, {"low": 900.0}, ["probability", "gamma"]),
        ("halfnorm", {"loc": 1.0}, {"high": 0.5}, ["probability", "halfnorm"]),
    ],
)
def test_bad_distributions_say_what_is_wrong(
    name: str, keywords: dict[str, Any], bounds: dict[str, float], fragments: list[str]
) -> None:
    """Each bad distribution is refused with the key, what was expected and a hint."""
    with pytest.raises(InputError) as caught:
        Distribution(name, keywords, **bounds)
    for fragment in fragments:
        assert fragment in str(caught.value)


def test_keywords_and_names_are_scipys() -> None:
    """Shapes come first, in scipy's order; discrete distributions are not listed."""
    assert keywords_of("beta") == ("a", "b", "loc", "scale")
    assert keywords_of("norm") == ("loc", "scale")
    assert {"norm", "lognorm", "t", "weibull_min"} <= set(distribution_names())
    assert "poisson" not in distribution_names()


def test_hints_and_numbers_of_the_door_checks() -> None:
    """The nearest name when one is alike, all when none is; numbers beyond a float refused."""
    assert nearest("cm_x", ["cm_x_m", "tau_fall_s"]) == "did you mean 'cm_x_m'?"
    assert nearest("zzz", ["cm_x_m", "tau"]) == "known: cm_x_m, tau"
    assert nearest("zzz", []) == "known: none"
    assert finite_number("here", 3) == 3.0
    with pytest.raises(InputError, match="here: expected a finite number in kg, got inf"):
        finite_number("here", 10**400, "kg")
