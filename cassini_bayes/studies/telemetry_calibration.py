"""Simulation-based calibration of the joint model on closed-loop telemetry.

Parameters are drawn from the priors, wheel biases and slews are flown by the simulation (which
knows nothing of regressions), the telemetry is reduced and fitted, and the rank of each true value
among its posterior draws is kept. Variants change which events are fitted, how often channels are
sampled and how noisy the wheels are; controls are likelihoods that must fail.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np

from cassini_bayes.balance.statistics import reduce_chunks
from cassini_bayes.balance.statistics.first_look import Preparation
from cassini_bayes.computing.arrays import Array
from cassini_bayes.errors import InputError
from cassini_bayes.files.toml_file import read_toml
from cassini_bayes.model.draws import draw
from cassini_bayes.model.event_reduction import ReducedEvent, reduce_samples, sampling_of
from cassini_bayes.model.posterior import Model, build_model, log_posterior, shared_of
from cassini_bayes.model.telemetry import telemetry_parameters
from cassini_bayes.model.terms import TORQUE
from cassini_bayes.priors.distributions import Distribution
from cassini_bayes.priors.reader import OF_CONTROLLERS, Priors, read_priors
from cassini_bayes.results.ranks import rank
from cassini_bayes.simulation import SimulatedEvent, scenario_of
from cassini_bayes.spacecraft.parameters import CLOSE_SHARE
from cassini_bayes.studies.conditions import CONTROLLERS
from cassini_bayes.studies.posterior_draws import LogDensity, posterior_draws
from cassini_bayes.studies.repeated import Repeated
from cassini_bayes.studies.scenario import (
    Simulation,
    draw_wheel_rates,
    simulate_file,
    simulated_samples,
)

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
    rcs: Mapping[str, float | str] = field(default_factory=dict)


_ALL: Final = ("bias-1", "bias-2", "slews")
_SLOW: Final = {"attitude_every_s": 4.0, "rate_every_s": 4.0, "wheel_every_s": 4.0}
_ADAPTED: Final = dict(CONTROLLERS["widths adapted"])
_HIGH_GAIN: Final = dict(CONTROLLERS["high gain, union"])
VARIANTS: Final = (
    Variant("joint", "two biases and slews, 1 Hz", _ALL, {}),
    Variant("bias", "one bias, 1 Hz", _ALL[:1], {}),
    Variant("slew", "slews, 1 Hz", _ALL[2:], {}),
    Variant("mixed", "rates 4 s, on-times 10 s", _ALL, {**_SLOW, "counter_every_s": 10.0}),
    Variant("slow", "all channels 4 s", _ALL, {**_SLOW, "counter_every_s": 4.0}),
    Variant("quiet-wheels", "wheel noise 0.2 rpm", _ALL, {}, 0.2),
    Variant("noisy-wheels", "wheel noise 1 rpm", _ALL, {}, 1.0),
    Variant("adapted", "one bias, widths adapted", _ALL[:1], {}, rcs=_ADAPTED),
    # its pulses follow each other closely: many tails are cut
    Variant("high-gain", "one bias, high gain", _ALL[:1], {}, rcs=_HIGH_GAIN),
)
_EXACT: Final = "rounding-ignored"
_UNCUT: Final = "cuts-ignored"
_BLIND: Final = "pulse-blind"
_NAIVE: Final = "balance-residual"
CONTROLS: Final = (
    Variant(_NAIVE, "control: Gaussian balance residual", _ALL, {}, 1.0),
    Variant(_BLIND, "control: rows during pulses kept", _ALL, {}),
    Variant(
        _EXACT, "control: counters of 10 ms taken as exact", _ALL, {"on_time_resolution_s": 0.01}
    ),
    Variant(_UNCUT, "control: cut tails ignored", _ALL[:1], {}, rcs=_HIGH_GAIN),
)


@dataclass(frozen=True)
class TelemetryCampaign(Repeated):
    """Repetitions of one variant: scenario, priors, seed."""

    scenario: Path
    priors_file: Path
    variant: Variant

    def names(self) -> tuple[str, ...]:
        """Names of the ranked scalars: walked parameters, thrusts and torques of the events."""
        priors = self.priors()
        thrusters = priors.spacecraft.thruster_names(priors.branch)
        fires = any(_fires(event) for event in self.variant.events)
        # how often pulses are close, and how alike, is what the controller did: no truth has it
        walked = [name for name in _walked(priors, fires=fires) if name not in OF_CONTROLLERS]
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
        priors = read_priors(self.priors_file)
        if self.variant.wheel_noise_rpm is None:
            return priors
        narrow = Distribution("lognorm", {"s": 0.3, "scale": self.variant.wheel_noise_rpm})
        return priors.with_distribution("wheel_noise_rpm", narrow)

    def repetition(self, index: int) -> dict[str, Array | float | bool]:
        """Draw, fly, reduce, fit, rank: ranks (P,), Pareto k̂, and whether a chain stood in.

        Where the package declines the events ranks and k̂ are not a number. What it declines
        depends on the data alone, so the ranks of the others are as even as those of all.
        """
        rng, priors = self.stream(index), self.priors()
        simulation = self.simulate(priors, rng)
        try:
            model = model_of(simulation, self.variant, priors)
        except InputError:
            unknown = np.full(len(self.names()), np.nan)
            return {"ranks": unknown, "pareto_k": np.nan, "by_chain": False}
        density = log_density_of(model, self.variant)
        z, pareto_k, by_chain = posterior_draws(density, model.starts, rng, EFFORTS, CHAIN_STEPS)
        drawn = flat_draws(model, z, rng)
        truth = flat_truth(simulation)
        ranks = [rank(drawn[name], truth[name], rng) for name in self.names()]
        return {"ranks": np.array(ranks), "pareto_k": pareto_k, "by_chain": by_chain}

    def simulate(self, priors: Priors, rng: np.random.Generator) -> Simulation:
        """Fly the scenario once, with wheel rates and truth of this repetition."""
        document = read_toml(self.scenario, "a scenario file")
        document["telemetry"] |= self.variant.telemetry
        document["rcs"] |= self.variant.rcs
        document["torque_noise"] = True
        document["event"] = [e for e in document["event"] if e["id"] in self.variant.events]
        draw_wheel_rates(document["event"], rng)
        scenario = scenario_of(document, self.scenario.parent, str(self.scenario))
        return simulate_file(scenario, int(rng.integers(2**62)), priors=priors)


def _fires(event: str) -> bool:
    return event.startswith("bias")


def _walked(priors: Priors, fires: bool) -> tuple[str, ...]:
    """Names of the walked parameters, in order, for events with or without thrusters."""
    shared = shared_of(priors, priors.wheels, fires=fires)
    return priors.space(telemetry_parameters(shared, priors.wheels, fires=fires)).names


def model_of(simulation: Simulation, variant: Variant, priors: Priors) -> Model:
    """The model of a simulation's telemetry, or that of a control, told by its name.

    One that is blind to pulses keeps every row; one that ignores cut tails has no close pulses.
    """
    if variant.name == _UNCUT:
        priors = priors.with_fixed(CLOSE_SHARE, 0.0)
    guard_s = 0.0 if variant.name == _BLIND else None
    exact = variant.name == _EXACT
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
        known.noise,
        gaps_s=tuple(counters.gaps_s.tolist()),
        paired_s=tuple(counters.paired_s.tolist()),
        widths_s=tuple(counters.widths_s.tolist()),
    )
    given = (known.event_id, known.kind, (samples,), known.layout, sampling)
    return replace(reduced, statistics=reduce_chunks(*given, prepared=prepared))


def log_density_of(model: Model, variant: Variant) -> LogDensity:
    """The log posterior; for the balance-residual control without its Jacobian."""
    if variant.name == _NAIVE:
        return partial(without_jacobian, model)
    return partial(log_posterior, model)


def without_jacobian(model: Model, z: Array) -> Array:
    """The naive likelihood: a density of the balance residual, which shrinks with everything.

    Takes N log det I off again (docs/topics/telemetry-likelihood.md §2).
    """
    rows = sum(term.event.statistics.rows for term in model.telemetry)
    inertia = model.points(z).physics(()).inertia_kg_m2
    return np.asarray(log_posterior(model, z) - rows * np.linalg.slogdet(inertia)[1])


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
