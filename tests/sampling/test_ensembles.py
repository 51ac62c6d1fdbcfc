"""The sampler draws known distributions, stops by its rule, and repeats itself to the bit."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import arviz
import numpy as np
import pytest
from scipy.stats import gumbel_r, multivariate_normal, norm

from cassini_bayes.computing.arrays import Array
from cassini_bayes.errors import CassiniBayesError, InputError
from cassini_bayes.files.checkpoint import CheckpointStore
from cassini_bayes.sampling.ensembles import (
    Chains,
    Convergence,
    ProgressReport,
    SamplerSettings,
    check_convergence,
    next_check,
    sample,
)
from cassini_bayes.sampling.warmstart import LogDensity, Proposal

MEAN = np.array([1.0, -2.0, 0.5, 0.0, 3.0])
COVARIANCE = np.diag([1.0, 0.25, 4.0, 0.01, 1.0]) + 0.05 * np.ones((5, 5))
NORMAL = multivariate_normal(MEAN, COVARIANCE)
LEVELS = np.array([0.05, 0.25, 0.5, 0.75, 0.95])
SIGMAS = 4.5  # of Monte Carlo error; some tens of numbers are compared
QUICK = SamplerSettings(ensembles=2, target_ess=400, first_check=60, max_steps=400)


def gaussian(z: Array) -> Array:
    """Log density of the five-dimensional normal target."""
    return np.asarray(NORMAL.logpdf(z))


def good_proposal(d: int = 5) -> Proposal:
    """The target's own shape, as a warm start finds it."""
    return Proposal(MEAN[:d], np.linalg.cholesky(COVARIANCE[:d, :d]), 15.0)


def skewed(z: Array) -> Array:
    """a ~ Gumbel, b = c + 0.3 a² with c ~ N(0, 1): a curved ridge with known marginals."""
    a, b = z[:, 0], z[:, 1]
    return np.asarray(gumbel_r.logpdf(a) + norm.logpdf(b - 0.3 * a**2))


def effective_size(values: Array, method: str = "bulk", **options: float) -> float:
    """ArviZ's effective sample size of every walker's chain, (chains, draws)."""
    return float(arviz.ess(values, method=method, **options))


def assert_distributed(chains: Chains, values: Array, exact: Array) -> None:
    """Quantiles of values (M, steps, W) are the exact ones within Monte Carlo error."""
    per_walker = np.moveaxis(values, 2, 1).reshape(-1, values.shape[1])
    for level, quantile in zip(LEVELS, exact, strict=True):
        below = per_walker < quantile
        size = effective_size(below.astype(float), method="mean")
        error = math.sqrt(level * (1 - level) / size)
        assert abs(below.mean() - level) < SIGMAS * error, (level, below.mean(), error)
        assert error < 0.02  # a check with too few draws would pass anything


def kept(chains: Chains) -> Array:
    """Steps after burn-in, (M, steps, W, d)."""
    return chains.z[:, chains.burn_in :]


def assert_gaussian(chains: Chains, d: int = 5) -> None:
    """Means, variances and quantiles of every dimension of the normal target."""
    z = kept(chains)
    for j in range(d):
        scale = math.sqrt(COVARIANCE[j, j])
        values = (z[..., j] - MEAN[j]) / scale
        assert_distributed(chains, values, norm.ppf(LEVELS))
        per_walker = np.moveaxis(values, 2, 1).reshape(-1, values.shape[1])
        assert abs(values.mean()) < SIGMAS / math.sqrt(effective_size(per_walker, "mean"))
        error = math.sqrt(2.0 / effective_size(per_walker**2, "mean"))
        assert abs((values**2).mean() - 1.0) < SIGMAS * error
        assert error < 0.05


@pytest.mark.statistical
def test_gaussian_target() -> None:
    """Five correlated dimensions of unlike scale: moments, quantiles and correlations are right."""
    chains = sample(gaussian, good_proposal(), SamplerSettings(seed=1))
    assert chains.convergence.done
    assert_gaussian(chains)
    flat = kept(chains).reshape(-1, 5)
    scale = np.sqrt(np.diag(COVARIANCE))
    expected = COVARIANCE / np.outer(scale, scale)
    size = chains.convergence.ess.min()
    assert np.corrcoef(flat.T) == pytest.approx(expected, abs=SIGMAS / math.sqrt(size))


@pytest.mark.statistical
def test_skewed_target() -> None:
    """A curved, skewed target that no Student-t resembles: exact marginal quantiles."""
    wide = Proposal(np.array([0.5, 1.0]), np.array([[1.3, 0.0], [0.7, 1.4]]), 15.0)
    chains = sample(skewed, wide, SamplerSettings(seed=2, target_ess=4_000))
    assert chains.convergence.done
    z = kept(chains)
    assert_distributed(chains, z[..., 0], gumbel_r.ppf(LEVELS))
    assert_distributed(chains, z[..., 1] - 0.3 * z[..., 0] ** 2, norm.ppf(LEVELS))
    with pytest.raises(AssertionError):  # negative control: a shift of a tenth is seen
        assert_distributed(chains, z[..., 0] + 0.1, gumbel_r.ppf(LEVELS))


@pytest.mark.statistical
@pytest.mark.parametrize("fault", ["narrow", "off by 5 sd", "wide"])
def test_a_bad_proposal_still_ends_right(fault: str) -> None:
    """Differential evolution mends a proposal a third as wide, six times as wide, or elsewhere."""
    good = good_proposal(2)
    proposal = {
        "narrow": Proposal(good.location, good.factor / 3, 15.0),
        "off by 5 sd": Proposal(good.location + 5 * good.factor.sum(1), good.factor, 15.0),
        "wide": Proposal(good.location, good.factor * 6, 15.0),
    }[fault]
    target = multivariate_normal(MEAN[:2], COVARIANCE[:2, :2])
    settings = SamplerSettings(seed=3, max_steps=4_000)
    chains = sample(lambda z: np.asarray(target.logpdf(z)), proposal, settings)
    assert chains.convergence.done, chains.convergence.failed
    assert_gaussian(chains, 2)


def test_without_differential_evolution_a_bad_proposal_is_not_accepted() -> None:
    """Negative control: independence moves alone stay where the proposal is, and are refused."""
    good = good_proposal(2)
    elsewhere = Proposal(good.location + 5 * good.factor.sum(1), good.factor, 15.0)
    target = multivariate_normal(MEAN[:2], COVARIANCE[:2, :2])
    settings = SamplerSettings(seed=3, max_steps=600, independence_share=1.0)
    chains = sample(lambda z: np.asarray(target.logpdf(z)), elsewhere, settings)
    assert not chains.convergence.done
    with pytest.raises(AssertionError):
        assert_gaussian(chains, 2)


def test_the_same_seed_gives_the_same_bits() -> None:
    """Same seed, same chain, whatever numpy's global state; another seed, another chain."""
    np.random.seed(1)  # noqa: NPY002 (the global state is what must not matter)
    one = sample(gaussian, good_proposal(), QUICK)
    state = np.random.get_state()[1].copy()  # noqa: NPY002
    np.random.seed(2)  # noqa: NPY002
    again = sample(gaussian, good_proposal(), QUICK)
    assert one.z.tobytes() == again.z.tobytes()
    assert one.log_density.tobytes() == again.log_density.tobytes()
    np.random.seed(1)  # noqa: NPY002
    assert np.array_equal(np.random.get_state()[1], state)  # noqa: NPY002 (left untouched)
    other = sample(
        gaussian,
        good_proposal(),
        SamplerSettings(ensembles=2, target_ess=400, first_check=60, max_steps=400, seed=1),
    )
    assert not np.isin(other.z[..., 0], one.z[..., 0]).any()
    # ensembles have streams of their own
    assert not np.isin(one.z[0, :, :, 0], one.z[1, :, :, 0]).any()


def test_an_interrupt_prints_nothing_of_its_own(capfd: pytest.CaptureFixture[str]) -> None:
    """A Ctrl-C while the log density is computed: what catches it says so, in one line."""
    batches = 0

    def interrupted(z: Array) -> Array:
        nonlocal batches
        batches += 1
        if batches > 20:
            raise KeyboardInterrupt
        return gaussian(z)

    with pytest.raises(KeyboardInterrupt):
        sample(interrupted, good_proposal(), QUICK)
    assert capfd.readouterr() == ("", "")


def test_log_density_belongs_to_its_draw() -> None:
    """Stored log densities are those of the stored coordinates, all steps and thinned ones."""
    chains = sample(gaussian, good_proposal(), QUICK)
    z, log_density = chains.thinned(500)
    assert log_density == pytest.approx(gaussian(z.reshape(-1, 5)).reshape(z.shape[:2]))
    every = gaussian(chains.z.reshape(-1, 5)).reshape(chains.log_density.shape)
    assert chains.log_density == pytest.approx(every)
    assert ((chains.acceptance > 0.2) & (chains.acceptance <= 1.0)).all()


@pytest.mark.parametrize(("value", "name"), [(np.nan, "nan"), (np.inf, "inf")])
def test_nan_is_an_error_with_the_place(value: float, name: str) -> None:
    """A log density of NaN or +∞ stops the run and says at which coordinates."""

    def broken(z: Array) -> Array:
        return np.where(z[:, 0] > 2.5, value, gaussian(z))

    with pytest.raises(CassiniBayesError, match=rf"is {name} at z = \[(2\.[5-9]|[3-9])"):
        sample(broken, good_proposal(), QUICK)


@pytest.mark.statistical
def test_outside_the_support_is_minus_infinity() -> None:
    """A bound inside the bulk: no walker starts or lands beyond it, the rest is the truncation."""

    def bounded(z: Array) -> Array:
        return np.where(z[:, 0] > 1.0, -np.inf, gaussian(z))

    chains = sample(bounded, good_proposal(), SamplerSettings(seed=5))
    assert chains.convergence.done
    assert chains.z[..., 0].max() <= 1.0
    half_normal = MEAN[0] + math.sqrt(COVARIANCE[0, 0]) * norm.ppf(LEVELS / 2)
    assert_distributed(chains, kept(chains)[..., 0], half_normal)


def test_a_proposal_outside_the_support_is_an_error() -> None:
    """No place to start from is said, instead of walkers that never move."""
    with pytest.raises(CassiniBayesError, match="-inf"):
        sample(lambda z: np.full(len(z), -np.inf), good_proposal(), QUICK)


@pytest.mark.parametrize("columns", [1, 5])
def test_a_wrong_shape_is_an_error_with_the_numbers(columns: int) -> None:
    """(n, d) instead of (n,) would be taken silently: expected and got are said."""

    def matrix(z: Array) -> Array:
        return np.repeat(gaussian(z)[:, None], columns, axis=1)

    with pytest.raises(
        CassiniBayesError, match=rf"expected shape \(\d+,\), got \(\d+, {columns}\)"
    ):
        sample(matrix, good_proposal(), QUICK)


def autoregressive(rng: np.random.Generator, phi: float, shape: tuple[int, ...]) -> Array:
    """Stationary AR(1) along axis 1 with unit variance: τ = (1 + φ) / (1 − φ)."""
    noise = rng.normal(size=shape)
    values = np.empty(shape)
    values[:, 0] = noise[:, 0]
    for t in range(1, shape[1]):
        values[:, t] = phi * values[:, t - 1] + math.sqrt(1 - phi**2) * noise[:, t]
    return values


RULE = SamplerSettings(target_ess=2_000)


@pytest.mark.statistical
@pytest.mark.parametrize("phi", [0.0, 0.6, 0.9])
def test_autocorrelation_time_and_effective_size_of_a_known_process(phi: float) -> None:
    """τ and ESS of AR(1) chains are the closed form's; twice the same τ is accepted.

    Each walker's own mean is taken off, which lowers every lag by τ / N and so their sum over the
    window of 5 τ, both sides, by 10 τ / N of itself.
    """
    z = autoregressive(np.random.default_rng(4), phi, (4, 1_500, 32, 2))
    tau = (1 + phi) / (1 - phi)
    first = check_convergence(z[:, :1_400], RULE, None)
    found = check_convergence(z, RULE, first.autocorrelation_time)
    low = 1 - 10 * tau / 1_500
    assert found.autocorrelation_time == pytest.approx(low * tau, rel=0.05)
    draws = 4 * 32 * (1_500 - math.ceil(5 * found.autocorrelation_time.max()))
    assert found.ess.max() <= draws / found.autocorrelation_time.min()  # never above emcee's
    assert found.ess == pytest.approx(draws / tau, rel=0.25)
    assert (found.rhat < 1.01).all()
    assert first.failed == ("τ not seen twice",)
    assert found.done
    assert found.steps_left == 0


def test_an_ensemble_elsewhere_is_caught() -> None:
    """One of four ensembles off by 0.4 sd: every other criterion holds, R-hat does not.

    With a shift of δ sd, the means of eight halves have variance 3 δ² / 14, so split R-hat is
    √(1 + 3 δ² / 14): the limit of 1.01 is passed from δ = 0.31 on, and not by 0.2.
    """
    z = autoregressive(np.random.default_rng(5), 0.5, (4, 1_000, 32, 2))
    tau = check_convergence(z, RULE, None).autocorrelation_time
    assert check_convergence(z, RULE, tau).done
    for shift, caught in ((0.2, False), (0.4, True)):
        moved = z.copy()
        moved[2, :, :, 1] += shift
        found = check_convergence(moved, RULE, tau)
        expected = math.sqrt(1 + 3 * shift**2 / 14)
        assert found.rhat[1] == pytest.approx(expected, abs=3e-3)
        assert found.rhat[0] < 1.002
        assert found.done is not caught
        assert [reason.split()[0] for reason in found.failed] == ["R-hat"] * caught
        assert (found.steps_left > 0) is caught


def test_walkers_are_not_taken_for_independent_chains() -> None:
    """Two ensembles stuck apart, their walkers well mixed within each: caught between ensembles."""
    z = autoregressive(np.random.default_rng(6), 0.0, (2, 600, 64, 1))
    z[1] += 1.0
    assert check_convergence(z, RULE, None).rhat.max() > 1.1


@pytest.mark.parametrize("steps", [20, 60, 150])
def test_short_chains_are_not_accepted(steps: int) -> None:
    """Chains of less than 50 τ never pass, however many draws their walkers make."""
    z = autoregressive(np.random.default_rng(7), 0.8, (4, steps, 200, 1))
    tau = check_convergence(z, RULE, None).autocorrelation_time
    found = check_convergence(z, RULE, tau)
    assert not found.done
    assert any(reason.startswith("length") for reason in found.failed)
    assert found.steps_left >= next_check(steps) - steps


@pytest.mark.parametrize("steps", [3, 200])
def test_walkers_that_never_moved_are_not_accepted(steps: int) -> None:
    """Their autocorrelation and effective size are no numbers: the rule fails and does not end."""
    z = autoregressive(np.random.default_rng(9), 0.0, (4, 1, 32, 2))
    z = np.broadcast_to(z, (4, steps, 32, 2))
    tau = check_convergence(z, RULE, None).autocorrelation_time
    found = check_convergence(z, RULE, tau)
    assert not found.done
    assert any(reason.startswith("ESS") for reason in found.failed)
    assert found.steps_left > 0


def test_a_moving_autocorrelation_time_is_not_accepted() -> None:
    """τ that changed by more than 5 % since the last check fails on its own."""
    z = autoregressive(np.random.default_rng(8), 0.5, (4, 1_000, 32, 1))
    tau = check_convergence(z, RULE, None).autocorrelation_time
    (reason,) = check_convergence(z, RULE, tau / 1.08).failed
    assert reason == "τ changed 8%"
    assert check_convergence(z, RULE, tau / 1.04).done


def test_too_few_effective_draws_are_not_accepted() -> None:
    """The target size is a criterion of its own, with the steps it still needs."""
    z = autoregressive(np.random.default_rng(9), 0.0, (2, 500, 8, 1))
    tau = check_convergence(z, RULE, None).autocorrelation_time
    found = check_convergence(z, SamplerSettings(target_ess=16_000), tau)
    assert [reason.split()[0] for reason in found.failed] == ["ESS"]
    assert found.steps_left == pytest.approx(500, rel=0.5)  # twice the draws


def test_checks_are_a_quarter_apart() -> None:
    """The schedule grows, so that checking stays cheap, and always moves on."""
    assert [next_check(step) for step in (1, 20, 200, 1_000)] == [2, 25, 250, 1_250]


def made_chains(steps: int, tau: float) -> Chains:
    """Chains whose coordinates say which step and walker they are."""
    step, walker = np.meshgrid(np.arange(steps), np.arange(10), indexing="ij")
    z = np.stack([step, walker], axis=-1)[None].repeat(3, axis=0).astype(float)
    nothing = np.ones(2)
    convergence = Convergence(steps, tau * nothing, 0.0, nothing, nothing, (), 0)
    return Chains(z, z[..., 0] + 0.01 * z[..., 1], np.ones(3), convergence)


@pytest.mark.parametrize(("steps", "draws"), [(500, 400), (500, 10_000), (501, 77), (60, 5)])
def test_thinned_draws(steps: int, draws: int) -> None:
    """Whole steps after burn-in, evenly spaced, the last one kept, never more than asked for."""
    chains = made_chains(steps, 4.0)
    assert chains.burn_in == 20
    z, log_density = chains.thinned(draws)
    assert z.shape[0] == 3
    assert z.shape[1] == log_density.shape[1]
    assert log_density == pytest.approx(z[..., 0] + 0.01 * z[..., 1])
    steps_kept = z[0, ::10, 0]
    assert np.array_equal(z[0, :10, 1], np.arange(10))  # all walkers of a step
    assert steps_kept[-1] == steps - 1
    assert steps_kept[0] >= 20
    gaps = np.diff(steps_kept)
    assert len(set(gaps)) <= 1
    stride = max(1, (steps - 20) // max(1, draws // 10))
    assert (gaps == stride).all()
    wanted = min(max(draws // 10, 1), steps - 20)
    assert wanted <= len(steps_kept) < 2 * wanted + 1


def test_more_is_asked_once_the_rule_holds() -> None:
    """A derived quantity can ask for further blocks; it is not asked before."""
    asked: list[int] = []

    def more(chains: Chains) -> bool:
        assert chains.convergence.done
        asked.append(chains.convergence.step)
        return len(asked) < 3

    settings = SamplerSettings(ensembles=2, target_ess=400, first_check=150, seed=4)
    plain = sample(gaussian, good_proposal(), settings)
    chains = sample(gaussian, good_proposal(), settings, more=more)
    assert plain.convergence.done
    assert asked[0] == plain.convergence.step
    assert len(asked) == 3
    assert chains.convergence.step == asked[-1] > plain.convergence.step
    assert chains.z[:, : plain.convergence.step].tobytes() == plain.z.tobytes()


@pytest.mark.parametrize("max_steps", [100, 170])
def test_the_limit_ends_a_run_that_has_not_converged(max_steps: int) -> None:
    """At max_steps the chains come back as they are, marked as not done, with what is missing."""
    settings = SamplerSettings(ensembles=2, first_check=150, max_steps=max_steps, target_ess=10**7)
    reports: list[ProgressReport] = []
    chains = sample(
        gaussian, good_proposal(), settings, progress=reports.append, more=lambda _: True
    )
    assert chains.z.shape == (2, max_steps, 32, 5)
    assert not chains.convergence.done
    assert any("ESS" in reason for reason in chains.convergence.failed)
    assert reports[-1].step == max_steps
    assert reports[-1].failed == chains.convergence.failed
    assert all(report.steps_left > 0 and report.seconds_left > 0 for report in reports)


def test_a_run_that_gave_up_goes_on_with_more_steps(tmp_path: Path) -> None:
    """Its draws are the first ones of the longer run, and those of one that never gave up."""
    store = CheckpointStore(tmp_path, "run")
    long = replace(QUICK, target_ess=10**7, max_steps=150)
    short = sample(gaussian, good_proposal(), replace(long, max_steps=70), store=store)
    assert short.z.shape[1] == 70
    went_on = sample(gaussian, good_proposal(), long, store=store)
    at_once = sample(gaussian, good_proposal(), long)
    assert went_on.z.tobytes() == at_once.z.tobytes()
    assert went_on.log_density.tobytes() == at_once.log_density.tobytes()
    assert np.array_equal(went_on.acceptance, at_once.acceptance)


def test_blocks_are_taken_up_bit_for_bit(tmp_path: Path) -> None:
    """From any number of finished blocks, the run ends with the draws of an uninterrupted one."""
    plain = sample(gaussian, good_proposal(), QUICK)
    store = CheckpointStore(tmp_path, "run")
    sample(gaussian, good_proposal(), QUICK, store=store)
    blocks = sorted(tmp_path.glob("block_*.npz"))
    assert len(blocks) > 2
    for lost in (blocks[-1:], blocks[1:2], blocks[:1], blocks):
        for path in lost:
            path.write_bytes(path.read_bytes()[:50])
        again = sample(gaussian, good_proposal(), QUICK, store=store)
        assert again.z.tobytes() == plain.z.tobytes()
        assert again.log_density.tobytes() == plain.log_density.tobytes()
        assert np.array_equal(again.acceptance, plain.acceptance)
    reports: list[ProgressReport] = []
    sample(gaussian, good_proposal(), QUICK, store=store, progress=reports.append)
    assert all(math.isnan(report.seconds_left) or report.steps_left == 0 for report in reports)


def test_blocks_of_another_model_are_refused(tmp_path: Path) -> None:
    """A model that does not reproduce the stored log densities is not continued."""
    store = CheckpointStore(tmp_path, "run")
    sample(gaussian, good_proposal(), QUICK, store=store)

    def shifted(z: Array) -> Array:
        return gaussian(z) + 1e-6

    with pytest.raises(InputError, match="block 0") as caught:
        sample(shifted, good_proposal(), QUICK, store=store)
    assert "1e-06" in caught.value.got
    assert "--force" in caught.value.fix


@pytest.mark.parametrize(
    ("walkers", "dimensions", "expected"), [(0, 3, 32), (0, 25, 100), (50, 25, 50), (51, 25, 52)]
)
def test_number_of_walkers(walkers: int, dimensions: int, expected: int) -> None:
    """Even, four per dimension unless set."""
    assert SamplerSettings(walkers=walkers).walkers_for(dimensions) == expected


def test_too_few_walkers_are_refused() -> None:
    """Fewer than two per dimension: one line that says how many are needed."""
    with pytest.raises(InputError, match="at least 50"):
        SamplerSettings(walkers=20).walkers_for(25)
    target: LogDensity = gaussian
    with pytest.raises(InputError, match=r"at least 4, two for each of 1 walked.*, and four"):
        SamplerSettings(walkers=2).walkers_for(1)
    with pytest.raises(InputError, match="at least 10"):
        sample(target, good_proposal(), SamplerSettings(walkers=6))
