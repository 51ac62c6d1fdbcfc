"""Simulation-based calibration of the joint model on closed-loop telemetry.

Parameters are drawn from the priors, wheel biases and slews are flown by the simulation (which
knows nothing of regressions), the telemetry is reduced and fitted, and the rank of each true value
among its posterior draws is kept. Variants change which events are fitted, how often channels are
sampled and how noisy the wheels are; controls are likelihoods that must fail.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np

from cassini_bayes.balance.statistics import reduce_chunks
from cassini_bayes.balance.statistics.reduction import Preparation
from cassini_bayes.computing.arrays import Array
from cassini_bayes.errors import InputError
from cassini_bayes.files.code import identity
from cassini_bayes.files.toml_file import read_toml
from cassini_bayes.model.draws import draw
from cassini_bayes.model.event_reduction import ReducedEvent, reduce_samples, sampling_of
from cassini_bayes.model.posterior import Model, build_model, log_posterior, shared_of
from cassini_bayes.model.telemetry import telemetry_parameters
from cassini_bayes.model.terms import TORQUE
from cassini_bayes.priors.distributions import Distribution
from cassini_bayes.priors.reader import Priors, read_priors
from cassini_bayes.results.ranks import rank
from cassini_bayes.sampling.ensembles import SamplerSettings, sample
from cassini_bayes.sampling.warmstart import warm_start
from cassini_bayes.simulation import SimulatedEvent, scenario_of
from cassini_bayes.spacecraft.parameters import CLOSE_SHARE
from cassini_bayes.studies.conditions import CONTROLLERS
from cassini_bayes.studies.scenario import (
    Simulation,
    draw_wheel_rates,
    simulate_file,
    simulated_samples,
)

LogDensity = Any
Control = Literal["none", "balance-residual", "pulse-blind", "rounding-ignored", "cuts-ignored"]

TRUSTED_K: Final = 0.5
RANK_DRAWS: Final = 999
# Degrees of freedom, pilots and number of importance draws, cheap first: the noise levels have long
# tails that a heavier proposal covers. A chain stands in when all fail.
EFFORTS: Final = ((15.0, 1, 2_500), (6.0, 3, 6_000), (5.0, 4, 12_000))
# Some forty autocorrelation times of several hundred walkers: enough for 999 draws.
CHAIN_STEPS: Final = 300
MODULE: Final = "studies.telemetry_calibration"
"""Whose code, with all that it imports, a repetition runs through."""


@dataclass(frozen=True)
class Variant:
    """One way of looking at the calibration scenario.

    ``events`` are the ids that are fitted; ``telemetry`` replaces keys of the scenario's telemetry
    table, ``rcs`` of its controller; ``wheel_noise_rpm`` is the median of a narrow prior of the
    wheel noise in place of the priors file's wide one.
    """

    name: str
    label: str
    events: tuple[str, ...]
    telemetry: Mapping[str, float]
    wheel_noise_rpm: float | None = None
    control: Control = "none"
    rcs: Mapping[str, float | str] = field(default_factory=dict)


_ALL: Final = ("bias-1", "bias-2", "slews")
_SLOW: Final = {"attitude_every_s": 4.0, "rate_every_s": 4.0, "wheel_every_s": 4.0}
VARIANTS: Final = (
    Variant("joint", "two biases and slews, 1 Hz", _ALL, {}),
    Variant("bias", "one bias, 1 Hz", _ALL[:1], {}),
    Variant("slew", "slews, 1 Hz", _ALL[2:], {}),
    Variant("mixed", "rates 4 s, on-times 10 s", _ALL, {**_SLOW, "counter_every_s": 10.0}),
    Variant("slow", "all channels 4 s", _ALL, {**_SLOW, "counter_every_s": 4.0}),
    Variant("quiet-wheels", "wheel noise 0.2 rpm", _ALL, {}, 0.2),
    Variant("noisy-wheels", "wheel noise 1 rpm", _ALL, {}, 1.0),
    # its pulses are short and follow each other closely: many tails are cut
    Variant(
        "adapted", "one bias, widths adapted", _ALL[:1], {}, rcs=dict(CONTROLLERS["widths adapted"])
    ),
)
CONTROLS: Final = (
    replace(
        VARIANTS[6],
        name="balance-residual",
        label="control: Gaussian balance residual",
        control="balance-residual",
    ),
    replace(
        VARIANTS[0],
        name="pulse-blind",
        label="control: rows during pulses kept",
        control="pulse-blind",
    ),
    replace(
        VARIANTS[0],
        name="rounding-ignored",
        label="control: counters of 10 ms taken as exact",
        telemetry={"on_time_resolution_s": 0.01},
        control="rounding-ignored",
    ),
    replace(
        VARIANTS[7],
        name="cuts-ignored",
        label="control: cut tails ignored",
        control="cuts-ignored",
    ),
)


@dataclass(frozen=True)
class TelemetryCampaign:
    """Repetitions of one variant: scenario, priors, seed."""

    scenario_path: str
    priors_path: str
    seed: int
    variant: Variant

    @property
    def per_file(self) -> int:
        """Repetitions that one checkpoint file holds."""
        return 5

    def identity(self) -> str:
        """What finished repetitions depend on: variant, seed, scenario, priors, model code."""
        settings = ["telemetry-sbc", asdict(self.variant), self.seed]
        return identity(settings, [self.scenario_path, self.priors_path], MODULE)

    def names(self) -> tuple[str, ...]:
        """Names of the ranked scalars: walked parameters, thrusts and torques of the events."""
        priors = self.priors()
        thrusters = priors.spacecraft.thruster_names(priors.branch)
        fires = any(_fires(event) for event in self.variant.events)
        # how often pulses are close is what the controller did: no parameter of the truth
        walked = [name for name in _walked(priors, fires=fires) if name != CLOSE_SHARE]
        thrusts = [
            f"thrust_n[{event},{thruster}]"
            for event in self.variant.events
            if _fires(event)
            for thruster in thrusters
        ]
        first = self.variant.events[0]
        torques = [f"external_torque_n_m[{first},{axis}]" for axis in "xyz"]
        return (*walked, *thrusts, *torques)

    def priors(self) -> Priors:
        """The priors file, with the variant's own wheel noise."""
        priors = read_priors(self.priors_path)
        if self.variant.wheel_noise_rpm is None:
            return priors
        narrow = Distribution("lognorm", {"s": 0.3, "scale": self.variant.wheel_noise_rpm})
        return priors.with_distribution("wheel_noise_rpm", narrow)

    def repetition(self, index: int) -> dict[str, Array | float | bool]:
        """Draw, fly, reduce, fit, rank: ranks (P,), Pareto k̂, and whether a chain stood in.

        Where the package declines the events ranks and k̂ are not a number. What it declines
        depends on the data alone, so the ranks of the others are as even as those of all.
        """
        rng = np.random.default_rng(np.random.SeedSequence((self.seed, index)))
        priors = self.priors()
        simulation = self.simulate(priors, rng)
        try:
            model = model_of(simulation, self.variant, priors)
        except InputError:
            unknown = np.full(len(self.names()), np.nan)
            return {"ranks": unknown, "pareto_k": np.nan, "by_chain": False}
        z, pareto_k, by_chain = posterior_draws(log_density_of(model, self.variant), model, rng)
        drawn = flat_draws(model, z, rng)
        truth = flat_truth(simulation)
        ranks = [rank(drawn[name], truth[name], rng) for name in self.names()]
        return {"ranks": np.array(ranks), "pareto_k": pareto_k, "by_chain": by_chain}

    def simulate(self, priors: Priors, rng: np.random.Generator) -> Simulation:
        """Fly the scenario once, with wheel rates and truth of this repetition."""
        path = Path(self.scenario_path)
        document = read_toml(path, "a scenario file")
        document["telemetry"] |= self.variant.telemetry
        document["rcs"] |= self.variant.rcs
        document["torque_noise"] = True
        document["event"] = [e for e in document["event"] if e["id"] in self.variant.events]
        draw_wheel_rates(document["event"], rng)
        scenario = scenario_of(document, path.parent, str(path))
        return simulate_file(scenario, int(rng.integers(2**62)), priors=priors)


def _fires(event: str) -> bool:
    return event.startswith("bias")


def _walked(priors: Priors, fires: bool) -> tuple[str, ...]:
    """Names of the walked parameters, in order, for events with or without thrusters."""
    shared = shared_of(priors, priors.wheels, fires=fires)
    return priors.space(telemetry_parameters(shared, priors.wheels, fires=fires)).names


def model_of(simulation: Simulation, variant: Variant, priors: Priors) -> Model:
    """The model of a simulation's telemetry, or that of a control.

    One that is blind to pulses keeps every row; one that ignores cut tails has no close pulses.
    """
    if variant.control == "cuts-ignored":
        priors = priors.with_fixed(CLOSE_SHARE, 0.0)
    guard_s = 0.0 if variant.control == "pulse-blind" else None
    exact = variant.control == "rounding-ignored"
    events = [
        reduced_simulation(event, priors, guard_s, exact_counters=exact)
        for event in simulation.events
    ]
    return build_model(events, priors)


def reduced_simulation(
    event: SimulatedEvent,
    priors: Priors,
    guard_s: float | None = None,
    *,
    exact_counters: bool = False,
) -> ReducedEvent:
    """A simulated event as a model takes it.

    ``guard_s`` replaces the guard time; ``exact_counters`` takes the counters at their word,
    whatever they are rounded to.
    """
    samples, thrusters = simulated_samples(event)
    sampling = sampling_of(priors, thrusters, float(samples.time_s[-1]), "first_order")
    if guard_s is not None:
        sampling = replace(sampling, guard_s=guard_s)
    declared, wheels = event.plan.event, event.plan.wheel_numbers
    reduced = reduce_samples(
        declared.id, declared.kind, wheels, thrusters, samples, sampling, declared.epoch
    )
    if not exact_counters:
        return reduced
    known = reduced.statistics
    counters = known.counters
    prepared = Preparation(
        known.steps,
        gaps_s=tuple(counters.gaps_s.tolist()),
        widths_s=tuple(counters.widths_s.tolist()),
    )
    given = (known.event_id, known.kind, (samples,), known.layout, sampling)
    return replace(reduced, statistics=reduce_chunks(*given, prepared=prepared))


def log_density_of(model: Model, variant: Variant) -> LogDensity:
    """The log posterior; for the balance-residual control without its Jacobian."""
    if variant.control == "balance-residual":
        return partial(without_jacobian, model)
    return partial(log_posterior, model)


def without_jacobian(model: Model, z: Array) -> Array:
    """The naive likelihood: a density of the balance residual, which shrinks with everything.

    Takes N log det I off again (docs/topics/telemetry-likelihood.md §2).
    """
    rows = sum(term.event.statistics.rows for term in model.telemetry)
    inertia = model.points(z).physics(()).inertia_kg_m2
    return np.asarray(log_posterior(model, z) - rows * np.linalg.slogdet(inertia)[1])


def posterior_draws(
    log_density: LogDensity, model: Model, rng: np.random.Generator
) -> tuple[Array, float, bool]:
    """Draws (n, d) by importance where Pareto k̂ allows, else of a chain; k̂; whether a chain's."""
    dimension = len(model.space.names)
    for dof, pilots, draws in EFFORTS:
        warm = warm_start(log_density, dimension, rng, dof=dof, pilots=pilots, draws=draws)
        if warm.draws.pareto_k < TRUSTED_K:
            return warm.draws.resample(rng, RANK_DRAWS), warm.draws.pareto_k, False
    settings = SamplerSettings(
        target_ess=RANK_DRAWS, max_steps=CHAIN_STEPS, seed=int(rng.integers(2**31))
    )
    chains = sample(log_density, warm.proposal, settings)
    z, _ = chains.thinned(4 * RANK_DRAWS)
    flat = z.reshape(-1, dimension)
    return flat[rng.permutation(len(flat))[:RANK_DRAWS]], warm.draws.pareto_k, True


def flat_draws(model: Model, z: Array, rng: np.random.Generator) -> dict[str, Array]:
    """Every inferred scalar as name → (n,)."""
    draws = draw(model, z, rng)
    flat = {name: np.asarray(draws.parameters[name]) for name in model.space.names}
    for e, event in enumerate(model.fired_ids):
        for k, thruster in enumerate(model.thrusters):
            flat[f"thrust_n[{event},{thruster}]"] = draws.thrusts.thrust_n[:, e, k]
    for term, integrated in zip(model.telemetry, draws.integrated, strict=True):
        for c, axis in enumerate("xyz"):
            flat[f"external_torque_n_m[{term.id},{axis}]"] = integrated[TORQUE][:, 0, c]
    return flat


def flat_truth(simulation: Simulation) -> dict[str, float]:
    """The true values behind :func:`flat_draws`."""
    truth = dict(simulation.events[0].plan.parameters)
    for event in simulation.events:
        name = event.plan.event.id
        truth |= {
            f"external_torque_n_m[{name},{axis}]": event.plan.parameters[
                f"external_torque_{axis}_n_m"
            ]
            for axis in "xyz"
        }
        if _fires(name):
            truth |= {
                f"thrust_n[{name},{thruster}]": thrust
                for thruster, thrust in event.plan.thrust_n.items()
            }
    return truth
