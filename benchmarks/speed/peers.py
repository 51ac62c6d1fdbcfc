"""Other samplers on the same posterior, each handed our own likelihood in standard coordinates.

Every sampler gets a budget of processor time and stops early at the effective size wanted. Chains
start at draws of the posterior itself, so that emcee and zeus pay for no search: their figures are
upper bounds. A nested sampler that is not done at the end of its budget has no effective draws;
then only an upper bound is known, the size wanted over the time spent. An ensemble whose size is
below a hundred or not yet twice its number of walkers has hardly more than the draws that it was
given: a bound as well.
"""

from __future__ import annotations

import importlib
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import scipy.special
import scipy.stats

from cassini_bayes.computing.arrays import Array
from cassini_bayes.model.posterior import Model, log_likelihood, log_posterior
from speed.own import TARGET, least_of
from speed.problem import model_of, reduced_events

Row = dict[str, Any]
LEAST_ESS = 100.0  # of draws whose means and sds say something
LEAST_STEPS = 8  # of a chain whose size is asked for
BLOCK = 25
ZEUS_BLOCK = 5
LIVE = 500
NESTED_POINTS = 1_000


class OutOfBudgetError(Exception):
    """The budget of processor time is spent."""


class Clock:
    """Processor and wall time since its start, and whether the budget is spent."""

    def __init__(self, budget_s: float) -> None:
        self._budget = budget_s
        self._processor, self._wall = time.process_time(), time.perf_counter()

    @property
    def processor_s(self) -> float:
        """Processor seconds since the start."""
        return time.process_time() - self._processor

    @property
    def wall_s(self) -> float:
        """Wall seconds since the start."""
        return time.perf_counter() - self._wall

    @property
    def spent(self) -> bool:
        """Whether the budget is used up."""
        return self.processor_s > self._budget


@dataclass(frozen=True)
class Target:
    """The posterior as a sampler is handed it: our densities, and draws to start from."""

    model: Model
    start: Array  # (n, d) draws of the posterior, in random order

    @property
    def size(self) -> int:
        """Number of walked parameters."""
        return len(self.model.space.names)

    def log_density(self, z: Array) -> Array:
        """Log posterior at (n, size) points."""
        return log_posterior(self.model, z)

    def log_likelihood(self, z: Array) -> Any:
        """Log likelihood at one point or at many: the prior is N(0, 1) in every coordinate."""
        found = log_likelihood(self.model, np.atleast_2d(z))
        return found if z.ndim == 2 else float(found[0])


@dataclass(frozen=True)
class Outcome:
    """What a sampler came to within its budget."""

    draws: Array  # (n, size), none from a nested sampler that is not done
    ess: float
    note: str
    given: int = 0  # independent draws that it started from


def run_emcee(target: Target, clock: Clock) -> Outcome:
    """emcee with its default stretch move, four walkers per dimension."""
    import emcee

    walkers = 4 * target.size
    sampler = emcee.EnsembleSampler(walkers, target.size, target.log_density, vectorize=True)
    begin = target.start[:walkers]
    return _ensemble(clock, begin, lambda x: sampler.run_mcmc(x, BLOCK), sampler.get_chain)


def run_zeus(target: Target, clock: Clock) -> Outcome:
    """zeus with its default differential slice move, two walkers per dimension."""
    import zeus

    walkers = 2 * target.size
    sampler = zeus.EnsembleSampler(
        walkers, target.size, target.log_density, vectorize=True, verbose=False, light_mode=False
    )

    def advance(x: Any) -> Any:
        sampler.run_mcmc(x, ZEUS_BLOCK, progress=False)
        return sampler.get_last_sample()

    return _ensemble(clock, target.start[:walkers], advance, sampler.get_chain)


def _ensemble(
    clock: Clock, begin: Array, advance: Callable[[Any], Any], chain: Callable[[], Array]
) -> Outcome:
    """Blocks of steps until the effective size or the budget is reached."""
    state: Any = begin
    ess, checked = 0.0, 0
    while not clock.spent and ess < TARGET:
        state = advance(state)
        steps = len(chain())
        if steps > 1.5 * checked + LEAST_STEPS:
            checked = steps
            ess = _effective(chain())
    draws = chain()
    return Outcome(
        draws.reshape(-1, draws.shape[-1]), _effective(draws), f"{len(draws)} steps", len(begin)
    )


def _effective(chain: Array) -> float:
    """Smallest effective size of a chain (steps, walkers, size), 0 while it is too short."""
    return least_of(np.moveaxis(chain, 0, 1)) if len(chain) >= LEAST_STEPS else 0.0


def run_dynesty(target: Target, clock: Clock) -> Outcome:
    """dynesty's nested sampler, 500 live points, its default choice of proposals."""
    import dynesty

    sampler = dynesty.NestedSampler(
        _guarded(target.log_likelihood, clock),
        scipy.special.ndtri,
        target.size,
        nlive=LIVE,
        rstate=np.random.default_rng(1),
    )
    try:
        sampler.run_nested(print_progress=False)
    except OutOfBudgetError:
        return Outcome(np.empty((0, target.size)), 0.0, f"stopped at iteration {sampler.it}")
    found = sampler.results
    weights = np.exp(found.logwt - found.logz[-1])
    ess = float(weights.sum() ** 2 / (weights**2).sum())
    draws = found.samples_equal(rstate=np.random.default_rng(2))
    return Outcome(draws, ess, f"{found.niter} iterations")


def run_nautilus(target: Target, clock: Clock) -> Outcome:
    """nautilus with 1,000 live points until the effective size is reached."""
    from nautilus import Prior, Sampler

    prior = Prior()
    for i in range(target.size):
        prior.add_parameter(f"x{i}", dist=scipy.stats.norm())
    sampler = Sampler(
        prior,
        _guarded(target.log_likelihood, clock),
        n_live=NESTED_POINTS,
        pass_dict=False,
        vectorized=True,
        seed=1,
    )
    try:
        sampler.run(n_eff=TARGET, verbose=False)
    except OutOfBudgetError:
        return Outcome(np.empty((0, target.size)), 0.0, f"stopped after {sampler.n_like} calls")
    points, log_weights, _ = sampler.posterior()
    weights = np.exp(log_weights - log_weights.max())
    chosen = np.random.default_rng(2).choice(len(points), 4_000, p=weights / weights.sum())
    return Outcome(points[chosen], float(sampler.n_eff), f"{sampler.n_like} calls")


def _guarded(function: Callable[[Array], Any], clock: Clock) -> Callable[[Array], Any]:
    def call(x: Array) -> Any:
        if clock.spent:
            raise OutOfBudgetError
        return function(x)

    return call


PEERS: Mapping[str, Callable[[Target, Clock], Outcome]] = {  # by the package that is imported
    "emcee": run_emcee,
    "zeus": run_zeus,
    "dynesty": run_dynesty,
    "nautilus": run_nautilus,
}


def peer_row(name: str, noise: bool, folders: list[Path], budget_s: float, reference: Array) -> Row:
    """One sampler; ``reference`` (n, d) are draws of the posterior."""
    model = model_of(reduced_events(folders[:1], noise), noise)
    target = Target(model, reference[np.random.default_rng(5).permutation(len(reference))])
    for package in ("arviz", name):  # neither imports nor compilation count
        importlib.import_module(package)
    target.log_density(target.start[:1])
    clock = Clock(budget_s)
    outcome = PEERS[name](target, clock)
    processor, wall = clock.processor_s, clock.wall_s
    ess = outcome.ess
    row: Row = {
        "sampler": name,
        "torque_noise": noise,
        "dimensions": target.size,
        "processor_s": processor,
        "wall_s": wall,
        "ess": ess,
        "bound": ess < max(2.0 * outcome.given, LEAST_ESS),
        "given": outcome.given,
        "ess_per_s": (ess if ess >= 1.0 else TARGET) / processor,
        "reached": ess >= TARGET,
        "note": outcome.note,
    }
    if ess >= LEAST_ESS:
        scale = reference.std(0)
        shift = np.abs(outcome.draws.mean(0) - reference.mean(0)) / scale
        row["largest_shift_sd"] = float(shift.max())
        row["largest_sd_ratio_change"] = float(np.abs(outcome.draws.std(0) / scale - 1.0).max())
    return row
