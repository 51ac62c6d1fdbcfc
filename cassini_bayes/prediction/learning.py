"""What past events teach a prediction: physics and firing logic jointly, and small regressions.

The likelihood of a fit leaves a constant factor for the on-times that do not answer momentum
(docs/topics/totals-likelihood.md §3). The firing model gives that factor a form, p(M, N | physics,
β), so the joint posterior is the fit's times it. Draws: every draw of the physics is paired with a
draw of β from a Student-t about the mode, weighted by p(M, N | physics, β) p(β) / t(β), and
resampled.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cassini_bayes.computing.arrays import Array, mapped, picked
from cassini_bayes.errors import InputError
from cassini_bayes.events.totals import TotalsEvent
from cassini_bayes.model.posterior import Model
from cassini_bayes.prediction.beliefs import Beliefs
from cassini_bayes.prediction.demand import PairLayout, pair_layout
from cassini_bayes.prediction.firing import (
    Features,
    Observation,
    firing_space,
    log_likelihood,
    observe,
)
from cassini_bayes.prediction.ground_knowledge import (
    PRINTED_ACCELERATION_SD_M_S2,
    PRINTED_MASS_SD_KG,
    PRINTED_THRUST_SD_N,
    Trend,
    hydrazine_regression,
    lateral_variance,
    manager_regression,
    mean_pulse_rate,
    no_trend,
    pulse_regression,
    trend_of,
)
from cassini_bayes.prediction.physics import PhysicsDraws, demand_of, features_of, solver_of
from cassini_bayes.prediction.regressions import Regression
from cassini_bayes.prediction.wheel_profile import WheelManager
from cassini_bayes.sampling.warmstart import (
    ImportanceDraws,
    LogDensity,
    Proposal,
    find_mode,
    refined,
)

PROPOSAL_DOF: Final = 5.0
PILOT_DRAWS: Final = 2_000
MOST_PILOTS: Final = 12  # lots of draws that refine the proposal until it is good
GOOD_EFFICIENCY: Final = 0.3  # effective draws per draw, at which the proposal is good (judgement)
FEW_DRAWS: Final = 200
FAR: Final = 8.0  # standard normals: 1e-15 lies beyond, where quantiles lose their digits
PAIRINGS: Final = 4  # firing draws per draw of the physics: features cost more than densities


@dataclass(frozen=True)
class Learned:
    """Everything a prediction needs, as joint draws.

    ``firing`` are the firing parameters by name (n,), ``pulses`` the regression of pulse counts
    (pulses per second; variance over the mean), ``hydrazine`` that of grams on impulse (1/I_sp,
    its departure for the couple axis, offset), ``manager`` and ``manager_draws`` the wheel profile
    at its mean and the draws (ramps of ``ramp_wheels``, loop time) behind the duration.
    """

    model: Model
    layout: PairLayout
    physics: PhysicsDraws
    firing: Mapping[str, Array | float]
    pulses: Regression
    hydrazine: Regression | None
    manager: WheelManager
    manager_draws: Regression
    ramp_wheels: tuple[int, ...]
    thrust_trend: Trend
    acceleration: Trend | None
    mass: Trend | None
    lateral_square: Array
    last_epoch: datetime
    effective_draws: float

    @property
    def size(self) -> int:
        """Number of joint draws."""
        return self.physics.size

    def thrust_moved_n(self, epoch: datetime) -> Array:
        """What printed thrusts drift by up to an epoch, (n,) N."""
        return self.thrust_trend.at(epoch) - self.thrust_trend.centre


def learn(
    model: Model,
    events: tuple[TotalsEvent, ...],
    physics: PhysicsDraws,
    beliefs: Beliefs,
    rng: np.random.Generator,
    size: int = 2_000,
) -> Learned:
    """Condition everything on the given events (those of the model) and nothing else.

    Raises
    ------
    InputError
        The events are not those of the model, or the layout of the thrusters is another.
    """
    if tuple(event.id for event in events) != model.totals_rows.stack.event_ids:
        raise InputError("events", "the events of the fit", "others", "name the fit's own events")
    layout = pair_layout(model.spacecraft, model.branch)
    ramp_wheels = tuple(sorted({n for event in events for n in event.wheels}))
    manager_draws = manager_regression(events, ramp_wheels, beliefs, rng, size)
    means = manager_draws.coefficients.mean(0)
    manager = WheelManager(dict(zip(ramp_wheels, means[:-1], strict=True)), float(means[-1]))
    rate = mean_pulse_rate(events, layout)
    features = training_features(model, events, physics, manager, rate)
    seen = [observe(event.on_time_s, layout) for event in events]
    firing, index, effective = joint_draws(features, seen, beliefs, rng, physics.size, size)
    chosen = picked(physics, index)
    pulses = pulse_regression(events, layout, beliefs, rng, size)
    hydrazine = hydrazine_regression(model, events, chosen, layout, beliefs, rng)
    thrust_trend, acceleration, mass = _trends(events, rng, size)
    return Learned(
        model=model,
        layout=layout,
        physics=chosen,
        firing=firing,
        pulses=pulses,
        hydrazine=hydrazine,
        manager=manager,
        manager_draws=manager_draws,
        ramp_wheels=ramp_wheels,
        thrust_trend=thrust_trend,
        acceleration=acceleration,
        mass=mass,
        lateral_square=lateral_variance(model, events, rng, size),
        last_epoch=max(event.epoch for event in events),
        effective_draws=effective,
    )


def _trends(
    events: tuple[TotalsEvent, ...], rng: np.random.Generator, size: int
) -> tuple[Trend, Trend | None, Trend | None]:
    """Drift of the printed thrust, of thrust over mass, and of mass."""
    epochs = [event.epoch for event in events]
    thrusts = [event.thrust_predicted_n for event in events]
    masses = [event.mass_kg for event in events]
    ratios = [f / m if f and m else None for f, m in zip(thrusts, masses, strict=True)]
    thrust = trend_of(epochs, thrusts, PRINTED_THRUST_SD_N, rng, size)
    acceleration = trend_of(epochs, ratios, PRINTED_ACCELERATION_SD_M_S2, rng, size)
    mass = trend_of(epochs, masses, PRINTED_MASS_SD_KG, rng, size)
    return thrust or no_trend(epochs, size), acceleration, mass


def training_features(
    model: Model,
    events: tuple[TotalsEvent, ...],
    physics: PhysicsDraws,
    manager: WheelManager,
    pulses_per_second: float,
) -> list[Features]:
    """Features of the fitted events at their own thrusts."""
    result = []
    for row, event in enumerate(events):
        solver = solver_of(model, physics, physics.thrust_n[:, row], pulses_per_second)
        rates = (event.rwa_start_rpm, event.rwa_end_rpm)
        demand = demand_of(model, physics, manager, event.wheels, rates, event.duration_s)
        result.append(features_of(model, solver, demand, event.duration_s))
    return result


def joint_draws(
    features: list[Features],
    seen: list[Observation],
    beliefs: Beliefs,
    rng: np.random.Generator,
    given: int,
    size: int,
    pairings: int = PAIRINGS,
) -> tuple[dict[str, Array | float], NDArray[np.int64], float]:
    """Firing parameters and the draws of the physics that they go with, weighted and resampled.

    Parameters
    ----------
    features
        Per event, over the ``given`` draws of the physics.
    seen
        Data of the firing logic in the events' totals.
    given, size, pairings
        Draws of the physics, draws wanted, firing draws per draw of the physics.

    Returns
    -------
    Parameters by name (size,), indices of the physics (size,), and the effective number of draws.
    """
    space = firing_space(beliefs)

    def density(z: Array, which: list[Features]) -> Array:
        terms = space.log_prior_terms(z).sum(-1)
        # far out in a proposal's tails quantiles overflow; the prior has 1e-15 there
        inside = np.clip(z, -FAR, FAR)
        value = log_likelihood(space.to_parameters(inside), which, seen) + terms
        return np.where((inside == z).all(-1), value, -np.inf)

    typical = [mapped(lambda values: np.full(1, np.mean(values)), f) for f in features]
    proposal = _firing_proposal(lambda z: density(z, typical), space.dimension, rng)
    owner = np.tile(np.arange(given), pairings)
    z = proposal.sample(rng, len(owner))
    repeated = [mapped(lambda values: np.tile(values, pairings), f) for f in features]
    log_weight = density(z, repeated) - proposal.log_density(z)
    weight = np.exp(log_weight - log_weight.max())
    weight /= weight.sum()
    index = _resample(weight, size, rng)
    return space.to_parameters(z[index]), owner[index], float(1.0 / (weight**2).sum())


def _resample(weight: Array, size: int, rng: np.random.Generator) -> NDArray[np.int64]:
    """Systematic resampling: ``size`` indices in random order."""
    edges = np.cumsum(weight)
    points = (np.arange(size) + rng.uniform()) / size * edges[-1]
    return rng.permutation(np.minimum(np.searchsorted(edges, points), len(weight) - 1))


def _firing_proposal(density: LogDensity, d: int, rng: np.random.Generator) -> Proposal:
    """Student-t for the firing parameters at typical physics: from the mode, refined until good.

    It begins as wide as the prior: eight events narrow seven parameters little.
    """
    proposal = Proposal(find_mode(density, np.zeros(d)), np.eye(d), PROPOSAL_DOF)
    for _ in range(MOST_PILOTS):
        z = proposal.sample(rng, PILOT_DRAWS)
        log_ratio = density(z) - proposal.log_density(z)
        log_weights = log_ratio - log_ratio.max()
        log_weights -= np.log(np.exp(log_weights).sum())
        efficiency = 1.0 / (PILOT_DRAWS * float(np.exp(2.0 * log_weights).sum()))
        nothing = float("nan")  # evidence and Pareto k̂ are not asked of a pilot
        draws = ImportanceDraws(z, log_weights, nothing, nothing, nothing, efficiency)
        proposal = refined(proposal, draws)
        if efficiency > GOOD_EFFICIENCY:
            break
    return proposal
