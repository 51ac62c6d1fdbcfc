"""Other samplers on the same posterior, on the plain likelihood or handed our fast one.

Every sampler gets a budget of processor time and stops early at the effective size wanted. Chains
start at draws of the posterior itself, so that stretch moves, zeus and NUTS pay for no search:
their figures are upper bounds. Only NUTS warms up (step size, mass matrix), and that is counted.
A nested sampler that is not done at the end of its budget has no effective draws; then only an
upper bound is known, the size wanted over the time spent. An ensemble whose size is not yet twice
its number of walkers has hardly more than the draws that it was given: a bound as well. A chain of
which no hundred draws are effective has not mixed: one draw a step is its bound.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np
import scipy.special
import scipy.stats

from cassini_bayes.balance.telemetry_balance import INITIAL_SD_N_M_S, cut_tail_sd
from cassini_bayes.computing.arrays import Array
from cassini_bayes.model.draws import draw
from cassini_bayes.model.posterior import log_posterior
from cassini_bayes.model.telemetry import unknowns_of
from speed import plain
from speed.problem import model_of, reduced_events

Row = dict[str, Any]
TARGET = 2_000
LEAST_ESS = 100.0  # of a chain that has mixed
WARM_UP = 300
BLOCK = 25
LIVE = 500
NESTED_POINTS = 1_000


class OutOfBudgetError(Exception):
    """The budget of processor time is spent."""


class Clock:
    """Processor and wall time since its start, and whether the budget is spent."""

    def __init__(self, budget_s: float) -> None:
        self._budget = budget_s
        self.restart()

    def restart(self) -> None:
        """Start again: what came before (compilation) does not count."""
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


class Target:
    """The posterior as a sampler is handed it: log density, start draws, size."""

    def __init__(self, problem: plain.Problem, fast: bool, reference_z: Array) -> None:
        self.problem, self.fast = problem, fast
        self.walked = len(problem.model.space.names)
        self.size = self.walked if fast else problem.size
        rng = np.random.default_rng(5)
        z = reference_z[rng.permutation(len(reference_z))]
        self.start = z if fast else lifted(problem, z[:600], rng)
        self.given = 0  # independent draws that a sampler started from

    def many(self, x: Array) -> Array:
        """Log density at (n, size) points."""
        if self.fast:
            return log_posterior(self.problem.model, x)
        return np.array([self.one(point) for point in x])

    def one(self, x: Array) -> float:
        """Log density at one point."""
        if self.fast:
            return float(log_posterior(self.problem.model, x[None])[0])
        return float(plain.log_posterior(np, scipy.special, self.problem, x))

    def likelihood(self, x: Array) -> Any:
        """Log likelihood for nested samplers: the prior is N(0, 1) in every coordinate."""
        prior = -0.5 * (x**2).sum(-1) - 0.5 * self.size * np.log(2.0 * np.pi)
        return (self.many(x) if x.ndim == 2 else self.one(x)) - prior

    def potential(self) -> Callable[[Any], Any]:
        """Minus the log density, in JAX."""
        import jax.numpy as jnp
        import jax.scipy.special as jax_special

        from speed.fast_jax import fast_log_posterior

        if self.fast:
            log_density = fast_log_posterior(self.problem)
        else:
            log_density = partial(plain.log_posterior, jnp, jax_special, self.problem)
        return lambda x: -log_density(x)


def lifted(problem: plain.Problem, z: Array, rng: np.random.Generator) -> Array:
    """Draws of the plain likelihood's unknowns at walked coordinates, from their conditional."""
    model, terms = problem.model, problem.terms
    draws = draw(model, z, rng)
    unknowns = unknowns_of(draws.thrusts.thrust_n, draws.integrated[0])
    places = terms.unknowns
    thrust = unknowns[:, places.thrusts] - model.thrust_prior.common_mean_n
    parts = [
        z,
        np.linalg.solve(problem.thrust_factor, thrust.T).T,
        (unknowns[:, places.initial] - terms.initial_mean_n_m_s) / INITIAL_SD_N_M_S,
        (unknowns[:, places.torque] - model.torque_mean_n_m) / model.torque_sd_n_m,
        unknowns[:, places.tails] / cut_tail_sd(terms),
    ]
    return np.concatenate(parts, axis=1)


def least_ess(chains: Array) -> float:
    """Smallest bulk or tail effective size of chains (chains, steps, dimensions)."""
    from arviz import ess

    if chains.shape[1] < 8:
        return 0.0
    return min(
        float(ess(chains[:, :, j], method=method))
        for j in range(chains.shape[2])
        for method in ("bulk", "tail")
    )


def run_emcee(target: Target, clock: Clock) -> tuple[Array, float, str]:
    """emcee with its default stretch move, four walkers per dimension."""
    import emcee

    walkers = 4 * target.size
    sampler = emcee.EnsembleSampler(walkers, target.size, target.many, vectorize=True)
    begin = target.start[np.arange(walkers) % len(target.start)]
    return _ensemble(target, clock, begin, lambda x: sampler.run_mcmc(x, BLOCK), sampler.get_chain)


def run_zeus(target: Target, clock: Clock) -> tuple[Array, float, str]:
    """zeus with its default differential slice move, two walkers per dimension."""
    import zeus

    walkers = 2 * target.size
    sampler = zeus.EnsembleSampler(
        walkers, target.size, target.many, vectorize=True, verbose=False, light_mode=False
    )
    begin = target.start[np.arange(walkers) % len(target.start)]

    def advance(x: Any) -> Any:
        sampler.run_mcmc(x, 5, progress=False)
        return sampler.get_last_sample()

    return _ensemble(target, clock, begin, advance, sampler.get_chain)


def _ensemble(
    target: Target,
    clock: Clock,
    begin: Array,
    advance: Callable[[Any], Any],
    chain: Callable[[], Array],
) -> tuple[Array, float, str]:
    """Blocks of steps until the effective size or the budget is reached."""
    state: Any = begin
    ess, checked = 0.0, 0
    target.given = len(begin)
    while not clock.spent and ess < TARGET:
        state = advance(state)
        steps = len(chain())
        if steps > 1.5 * checked + 8:
            checked = steps
            ess = least_ess(np.moveaxis(chain(), 0, 1))
    draws = chain()
    ess = least_ess(np.moveaxis(draws, 0, 1))
    return draws[..., : target.walked].reshape(-1, target.walked), ess, f"{len(draws)} steps"


def run_nuts(target: Target, clock: Clock) -> tuple[Array, float, str]:
    """NumPyro's NUTS with a dense mass matrix, 300 warm-up steps, one chain."""
    import jax
    from numpyro.infer import NUTS

    # no budget reaches into a step: the depth keeps one to some seconds
    kernel = NUTS(potential_fn=target.potential(), dense_mass=True, max_tree_depth=10)
    first = jax.numpy.asarray(target.start[0])
    state = kernel.init(jax.random.PRNGKey(1), WARM_UP, first, (), {})
    step = jax.jit(lambda s: kernel.sample(s, (), {}))
    jax.block_until_ready(step(state).z)
    clock.restart()  # compilation apart
    draws, count, checked = [], 0, 0
    ess = 0.0
    while not clock.spent and ess < TARGET:
        state = step(state)
        count += 1
        if count <= WARM_UP:
            jax.block_until_ready(state.z)
            warm_s = clock.processor_s
            continue
        draws.append(np.asarray(state.z))
        if len(draws) > 1.3 * checked + 100:
            checked = len(draws)
            ess = least_ess(np.array(draws)[None])
    if not draws:
        return np.empty((0, target.walked)), 0.0, f"{count} of {WARM_UP} warm-up steps"
    chain = np.array(draws)[None]
    ess = least_ess(chain)
    note = f"{len(draws)} draws after {warm_s:.0f} s of warm-up"
    return chain[0, :, : target.walked], ess, note


def run_dynesty(target: Target, clock: Clock) -> tuple[Array, float, str]:
    """dynesty's nested sampler, 500 live points, its default choice of proposals."""
    import dynesty

    sampler = dynesty.NestedSampler(
        _guarded(target.likelihood, clock),
        scipy.special.ndtri,
        target.size,
        nlive=LIVE,
        rstate=np.random.default_rng(1),
    )
    try:
        sampler.run_nested(print_progress=False)
    except OutOfBudgetError:
        return np.empty((0, target.walked)), 0.0, f"stopped at iteration {sampler.it}"
    found = sampler.results
    weights = np.exp(found.logwt - found.logz[-1])
    ess = float(weights.sum() ** 2 / (weights**2).sum())
    draws = found.samples_equal(rstate=np.random.default_rng(2))
    return draws[:, : target.walked], ess, f"{found.niter} iterations"


def run_nautilus(target: Target, clock: Clock) -> tuple[Array, float, str]:
    """nautilus with 1,000 live points until the effective size is reached."""
    from nautilus import Prior, Sampler

    prior = Prior()
    for i in range(target.size):
        prior.add_parameter(f"x{i}", dist=scipy.stats.norm())
    sampler = Sampler(
        prior,
        _guarded(target.likelihood, clock),
        n_live=NESTED_POINTS,
        pass_dict=False,
        vectorized=True,
        seed=1,
    )
    try:
        sampler.run(n_eff=TARGET, verbose=False)
    except OutOfBudgetError:
        return np.empty((0, target.walked)), 0.0, f"stopped after {sampler.n_like} calls"
    points, log_weights, _ = sampler.posterior()
    weights = np.exp(log_weights - log_weights.max())
    chosen = np.random.default_rng(2).choice(len(points), 4_000, p=weights / weights.sum())
    return points[chosen, : target.walked], float(sampler.n_eff), f"{sampler.n_like} calls"


def _guarded(function: Callable[[Array], Any], clock: Clock) -> Callable[[Array], Any]:
    def call(x: Array) -> Any:
        if clock.spent:
            raise OutOfBudgetError
        return function(x)

    return call


PEERS: Mapping[str, Callable[[Target, Clock], tuple[Array, float, str]]] = {
    "emcee, stretch move": run_emcee,
    "zeus": run_zeus,
    "NumPyro NUTS": run_nuts,
    "dynesty": run_dynesty,
    "nautilus": run_nautilus,
}


def _most_effective(draws: Array, target: Target) -> int:
    """Draws that may be effective at most: those of a chain, else as many as are wanted."""
    return len(draws) if len(draws) and target.given == 0 else TARGET


def peer_row(
    name: str, fast: bool, noise: bool, folders: list[Any], budget_s: float, reference: Array
) -> Row:
    """One sampler on one form of the posterior."""
    events = reduced_events(folders[:1], noise)
    model = model_of(events, noise)
    problem = plain.make_problem(model, events[0])
    target = Target(problem, fast, reference)
    clock = Clock(budget_s)
    draws, ess, note = PEERS[name](target, clock)
    processor, wall = clock.processor_s, clock.wall_s
    is_mixed = ess >= LEAST_ESS or (target.given > 0 and ess >= 1.0)
    row: Row = {
        "sampler": name,
        "likelihood": "fast" if fast else "plain",
        "torque_noise": noise,
        "dimensions": target.size,
        "processor_s": processor,
        "wall_s": wall,
        "ess": ess,
        "bound": ess < max(2.0 * target.given, LEAST_ESS),
        "given": target.given,
        "ess_per_s": (ess if is_mixed else _most_effective(draws, target)) / processor,
        "reached": ess >= TARGET,
        "note": note,
    }
    if ess >= LEAST_ESS:
        scale = reference.std(0)
        shift = np.abs(draws.mean(0) - reference.mean(0)) / scale
        row["largest_shift_sd"] = float(shift.max())
        row["largest_sd_ratio_change"] = float(np.abs(draws.std(0) / scale - 1.0).max())
    return row
