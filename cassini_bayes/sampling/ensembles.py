"""Posterior sampling with emcee: independent ensembles, a stated stop rule, resumable blocks.

The only module that knows emcee. Each ensemble has a random stream of its own and walks standard-
normal prior coordinates z with a mixture of an independence move (the Student-t of the warm start)
and differential evolution, which keeps a mode from hiding from a bad proposal. emcee's snooker and
full-covariance Gaussian moves sample wrong distributions in 3.1.6 and are not used.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Final

import emcee
import numpy as np
from numpy.typing import NDArray

from cassini_bayes.computing.arrays import Array
from cassini_bayes.computing.arviz_import import arviz
from cassini_bayes.computing.processes import in_lock_step
from cassini_bayes.errors import CassiniBayesError, InputError
from cassini_bayes.files.checkpoint import CheckpointStore
from cassini_bayes.sampling.warmstart import LogDensity, Proposal

LEAST_WALKERS: Final = 4  # of an ensemble: each half proposes moves by differences within the other
BURN_IN_TAU: Final = 5.0  # autocorrelation times τ left out at the start: judgement
LENGTH_IN_TAU: Final = 50.0  # τ, from which on emcee's documentation trusts its estimate of τ
TAU_CHANGE: Final = 0.05  # relative change of τ since the last check: judgement
MAX_RHAT: Final = 1.01  # of rank-normalised R̂ (Vehtari et al. 2021)
GROWTH: Final = 1.25  # length at a check over that at the last: few checks, little overshoot
START_ATTEMPTS: Final = 100
FEWEST_STEPS: Final = 8
_RANDOM: Final = ("random_key", "random_position", "random_has_gauss", "random_gauss")
"""Arrays of the state of a Mersenne Twister, in the order of numpy."""


@dataclass(frozen=True)
class SamplerSettings:
    """How to sample, and when to stop.

    ``ensembles`` independent ensembles of ``walkers`` (0: four per dimension) are run in blocks;
    the first check is after ``first_check`` steps, later ones each a quarter further.
    ``independence_share`` is the weight of the independence move.
    """

    ensembles: int = 4
    walkers: int = 0
    target_ess: int = 2_000
    first_check: int = 200
    max_steps: int = 5_000
    independence_share: float = 0.7
    seed: int = 2010

    def walkers_for(self, dimensions: int, where: str = "sampler.walkers") -> int:
        """Walkers per ensemble: even, at least four per dimension unless set.

        ``where`` is what a refusal calls the setting.

        Raises
        ------
        InputError
            Fewer than two per dimension, or than four: their differences would not reach every
            direction, or each half of them has none.
        """
        wanted, least = self.walkers or max(4 * dimensions, 32), max(2 * dimensions, LEAST_WALKERS)
        if wanted < least:
            raise InputError(
                where,
                f"at least {least}, two for each of {dimensions} walked parameters, and four",
                str(wanted),
                "raise it, or leave it out (four per parameter)",
            )
        return wanted + wanted % 2

    def check_kept(self, draws_per_ensemble: int, where: str = "output.draws_per_ensemble") -> None:
        """Refuse to keep fewer draws than ``target_ess`` effective ones need.

        Raises
        ------
        InputError
            Fewer than two draws for each effective one.
        """
        if self.ensembles * draws_per_ensemble < 2 * self.target_ess:
            raise InputError(
                where,
                f"at least {-(-2 * self.target_ess // self.ensembles)}, so that the "
                f"{self.ensembles} ensembles can hold {self.target_ess} effective draws",
                str(draws_per_ensemble),
                "keep more draws, or ask for a smaller target_ess",
            )


@dataclass(frozen=True)
class Convergence:
    """The criteria of the stop rule at one check; every array is per walked dimension."""

    step: int
    autocorrelation_time: Array
    tau_change: float
    rhat: Array
    ess: Array
    failed: tuple[str, ...]
    steps_left: int

    @property
    def done(self) -> bool:
        """Whether every criterion holds."""
        return not self.failed


@dataclass(frozen=True)
class Chains:
    """All ensembles' steps so far: z (M, steps, W, d) and log density (M, steps, W)."""

    z: Array
    log_density: Array
    acceptance: Array  # (M,)
    convergence: Convergence

    @property
    def burn_in(self) -> int:
        """Steps to drop at the start: a multiple of the autocorrelation time."""
        return int(np.ceil(BURN_IN_TAU * self.convergence.autocorrelation_time.max()))

    def thinned(self, draws: int) -> tuple[Array, Array]:
        """About ``draws`` draws per ensemble after burn-in.

        Shapes: z (M, draws, d), log density (M, draws). Whole steps are kept, spaced evenly, so
        neighbours in the flattened order are different walkers and the steps kept are as far apart
        as the number of draws allows.
        """
        m, steps, walkers, d = self.z.shape
        kept_steps = max(1, draws // walkers)
        available = np.arange(min(self.burn_in, steps - 1), steps)
        stride = max(1, len(available) // kept_steps)
        kept = available[::-1][::stride][::-1]
        return (
            self.z[:, kept].reshape(m, -1, d),
            self.log_density[:, kept].reshape(m, -1),
        )


@dataclass(frozen=True)
class ProgressReport:
    """What a progress line says; the time left is NaN before anything was sampled afresh.

    ``steps_left`` are those until the stop rule may hold, or until it gives up; then those that
    were missing.
    """

    step: int
    steps_left: int
    seconds_left: float
    failed: tuple[str, ...]


def check_convergence(
    z: Array, settings: SamplerSettings, previous_tau: Array | None
) -> Convergence:
    """Apply the stop rule to the steps so far.

    z (M, steps, W, d). Criteria: steps after burn-in > 50 τ for every dimension; τ changed by less
    than 5 % since the last check; split R-hat between ensembles (walkers of one ensemble are not
    independent chains) < 1.01; bulk and tail effective sample sizes at least the target, each the
    smaller of emcee's and ArviZ's.
    """
    m, steps, walkers, d = z.shape
    every_walker = np.moveaxis(z, 0, 1).reshape(steps, m * walkers, d)
    with np.errstate(invalid="ignore"):  # a walker that never moved has no autocorrelation
        tau = emcee.autocorr.integrated_time(every_walker, tol=0, quiet=True)
    tau = np.maximum(np.nan_to_num(tau, nan=steps), 1.0)
    burn_in = int(np.ceil(BURN_IN_TAU * tau.max()))
    kept = z[:, min(burn_in, steps - 4) :]
    flat = kept.reshape(m, -1, d)
    per_walker = np.moveaxis(kept, 2, 1).reshape(m * walkers, -1, d)
    from_emcee = kept.shape[0] * kept.shape[1] * walkers / tau
    between = np.array([float(arviz().rhat(flat[:, :, j])) for j in range(d)])
    sizes = np.array([min(*_ess(per_walker[:, :, j]), from_emcee[j]) for j in range(d)])
    sizes = np.nan_to_num(sizes, nan=0.0)  # of a few steps there are none
    change = np.inf if previous_tau is None else float(np.max(np.abs(tau / previous_tau - 1.0)))
    length = kept.shape[1]
    failed = []
    needed = LENGTH_IN_TAU * tau.max()
    if length <= needed:
        failed.append(f"length {length} of {needed:.0f} steps, {LENGTH_IN_TAU:.0f} τ")
    if change >= TAU_CHANGE:
        failed.append("τ not seen twice" if previous_tau is None else f"τ changed {change:.0%}")
    if not between.max() < MAX_RHAT:
        failed.append(f"R-hat {between.max():.3f} ≥ {MAX_RHAT}")
    if sizes.min() < settings.target_ess:
        failed.append(f"ESS {sizes.min():.0f} of {settings.target_ess}")
    wanted = max(
        needed + burn_in - steps,
        (settings.target_ess / max(sizes.min(), 1.0) - 1.0) * length,
        0.0,
    )
    left = max(int(np.ceil(wanted)), next_check(steps) - steps) if failed else 0
    return Convergence(steps, tau, change, between, sizes, tuple(failed), left)


def stored_ess(draws: Array, walkers: int) -> tuple[float, float]:
    """Bulk and tail effective sample size of stored draws (M, S·W), step by step as ``thinned``.

    In that order neighbours are different walkers, and ArviZ's sum of autocorrelations would end
    before the same walker comes round again; so each walker is also taken as a chain of its own,
    and the smaller of the two counts (where there are steps enough to tell).
    """
    m, n = draws.shape
    if n < FEWEST_STEPS * walkers:
        return _ess(draws)
    per_walker = draws.reshape(m, n // walkers, walkers).transpose(0, 2, 1).reshape(m * walkers, -1)
    bulk, tail = map(min, _ess(draws), _ess(per_walker))
    return bulk, tail


def _ess(draws: Array) -> tuple[float, float]:
    """Bulk and tail effective sample size of chains (M, n), as ArviZ has them."""
    ess = arviz().ess
    return float(ess(draws, method="bulk")), float(ess(draws, method="tail"))


def next_check(step: int) -> int:
    """Step of the check that follows the one at ``step`` (a quarter further)."""
    return int(np.ceil(step * GROWTH))


def steps_kept(store: CheckpointStore) -> int:
    """Steps of the blocks that :func:`sample` would go on from.

    Raises
    ------
    InputError
        A checkpoint of another run.
    """
    steps, block = 0, 0
    while (stored := store.load(_name(block))) is not None:
        steps, block = steps + stored["z"].shape[1], block + 1
    return steps


def _name(block: int) -> str:
    return f"block_{block:04d}"


def sample(
    log_density: LogDensity,
    proposal: Proposal,
    settings: SamplerSettings,
    *,
    store: CheckpointStore | None = None,
    progress: Callable[[ProgressReport], None] | None = None,
    more: Callable[[Chains], bool] | None = None,
) -> Chains:
    """Run the ensembles until the stop rule holds.

    Parameters
    ----------
    log_density
        (n, d) → (n,) log posterior in z.
    proposal
        Student-t used to start the walkers and as the independence move.
    store
        Where finished blocks are kept. Blocks already there are taken as they are, and the run ends
        with exactly the draws of an uninterrupted one. One that gave up may go on with more
        ``max_steps``.
    more
        Asked once the rule holds; True asks for further blocks (a derived quantity needs them).

    Raises
    ------
    InputError
        A checkpoint of another run, or one whose log densities this model does not reproduce.
    CassiniBayesError
        The log density returned NaN or the wrong shape.
    """
    d = len(proposal.location)
    walkers = settings.walkers_for(d)
    checked = _checked(log_density)
    seeds = np.random.SeedSequence(settings.seed).spawn(settings.ensembles)
    states = [_start(checked, proposal, walkers, seed) for seed in seeds]
    blocks: list[Array] = []
    densities: list[Array] = []
    accepted = np.zeros(settings.ensembles)
    tau: Array | None = None
    step, block, goal = 0, 0, min(settings.first_check, settings.max_steps)
    fresh_seconds, fresh_steps = 0.0, 0
    while True:
        began = time.monotonic()
        stored = store.load(_name(block)) if store else None
        if stored is None:
            advance = partial(_advance, proposal=proposal, steps=goal - step, settings=settings)
            results = in_lock_step(checked, [partial(advance, state=state) for state in states])
            states = [result[0] for result in results]
            arrays = _pack(states, results)
            fresh_steps += goal - step
            if store:
                store.save(_name(block), arrays)
        else:
            arrays = stored
            states = _unpack(arrays)
            _refuse_other_model(checked, states, block)
        blocks.append(np.asarray(arrays["z"], dtype=np.float64))
        densities.append(np.asarray(arrays["log_density"], dtype=np.float64))
        accepted += np.asarray(arrays["accepted"], dtype=np.float64)
        # a last block, cut short by a lower limit, is shorter than this run would make it
        step, block = step + blocks[-1].shape[1], block + 1
        z = np.concatenate(blocks, axis=1)
        convergence = check_convergence(z, settings, tau)
        tau = convergence.autocorrelation_time
        if stored is None:
            fresh_seconds += time.monotonic() - began
        if progress:
            per_step = fresh_seconds / fresh_steps if fresh_steps else np.nan
            left = convergence.steps_left
            if step < settings.max_steps:
                left = min(left, settings.max_steps - step)
            progress(ProgressReport(step, left, left * per_step, convergence.failed))
        chains = Chains(
            z, np.concatenate(densities, axis=1), accepted / (step * walkers), convergence
        )
        if step >= settings.max_steps or (
            convergence.done and not (more is not None and more(chains))
        ):
            return chains
        goal = min(next_check(step), settings.max_steps)


def _checked(log_density: LogDensity) -> LogDensity:
    """Guard emcee's door: a wrong shape or NaN is an error there, not a wrong answer."""

    def guarded(z: Array) -> Array:
        values = log_density(z)
        if values.shape != (len(z),):
            raise CassiniBayesError(f"log density: expected shape {(len(z),)}, got {values.shape}")
        impossible = np.isnan(values) | (values == np.inf)
        if impossible.any():
            first = int(np.flatnonzero(impossible)[0])
            place = np.round(z[first], 3).tolist()
            raise CassiniBayesError(f"log density is {values[first]} at z = {place}")
        return values

    return guarded


def _ensemble(
    log_density: LogDensity, proposal: Proposal, walkers: int, d: int, settings: SamplerSettings
) -> emcee.EnsembleSampler:
    share = settings.independence_share

    def independent(coordinates: Array, random: np.random.RandomState) -> tuple[Array, Array]:
        new = proposal.sample(random, len(coordinates))
        return new, proposal.log_density(coordinates) - proposal.log_density(new)

    moves = [
        (emcee.moves.MHMove(independent), share),
        (emcee.moves.DEMove(), 0.9 * (1.0 - share)),
        (emcee.moves.DEMove(gamma0=1.0), 0.1 * (1.0 - share)),
    ]
    sampler = emcee.EnsembleSampler(walkers, d, log_density, moves=moves, vectorize=True)
    # emcee's wrapper for other processes prints every exception, a Ctrl-C too, with its traceback
    sampler.log_prob_fn = log_density
    return sampler


def _start(
    log_density: LogDensity, proposal: Proposal, walkers: int, seed: np.random.SeedSequence
) -> emcee.State:
    """Dispersed, full-rank start: draws of the proposal itself, from the ensemble's own stream.

    Draws outside the support are drawn again.
    """
    random = np.random.RandomState(np.random.MT19937(seed))
    z = np.empty((walkers, len(proposal.location)))
    values = np.full(walkers, -np.inf)
    for _ in range(START_ATTEMPTS):
        outside = np.flatnonzero(values == -np.inf)
        z[outside] = proposal.sample(random, len(outside))
        values[outside] = log_density(z[outside])
        if not (values == -np.inf).any():
            break
    else:
        raise CassiniBayesError(
            f"log density is -inf at {START_ATTEMPTS} draws of the proposal in a row: it has no "
            "place to start from"
        )
    return emcee.State(z, log_prob=values, random_state=random.get_state())


def _advance(
    log_density: LogDensity,
    *,
    state: emcee.State,
    proposal: Proposal,
    steps: int,
    settings: SamplerSettings,
) -> tuple[emcee.State, Array, Array, float]:
    walkers, d = state.coords.shape
    sampler = _ensemble(log_density, proposal, walkers, d, settings)
    end = sampler.run_mcmc(state, steps, skip_initial_state_check=True)
    accepted = float(sampler.backend.accepted.sum())
    return end, sampler.get_chain(), sampler.get_log_prob(), accepted


def _pack(
    states: list[emcee.State], results: list[tuple[emcee.State, Array, Array, float]]
) -> dict[str, NDArray[np.generic]]:
    return {
        "z": np.stack([result[1] for result in results]),
        "log_density": np.stack([result[2] for result in results]),
        "accepted": np.array([result[3] for result in results]),
        **{
            name: np.array([state.random_state[place] for state in states])
            for place, name in enumerate(_RANDOM, start=1)
        },
    }


def _unpack(arrays: Mapping[str, NDArray[np.generic]]) -> list[emcee.State]:
    z, log_density = arrays["z"], arrays["log_density"]
    return [
        emcee.State(
            z[i, -1],
            log_prob=log_density[i, -1],
            random_state=("MT19937", *(arrays[name][i] for name in _RANDOM)),
        )
        for i in range(len(z))
    ]


def _refuse_other_model(log_density: LogDensity, states: list[emcee.State], block: int) -> None:
    for state in states:
        again = log_density(np.asarray(state.coords))
        if not np.allclose(again, state.log_prob, rtol=1e-9, atol=1e-9):
            worst = float(np.max(np.abs(again - state.log_prob)))
            raise InputError(
                f"checkpoint block {block}",
                "log densities that this model reproduces",
                f"a difference of {worst:.3g}",
                "the model has changed since: start anew with --force",
            )
