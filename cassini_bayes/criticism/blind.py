"""Blind trials: an effect is hidden in simulated telemetry and the diagnosis has to find it.

A trial draws truth, geometry, cause and size, flies the scenario, diagnoses it without a hint and
keeps what was said. Sizes are in σ = √(δᵀV⁻¹δ), δ the mean shift of the data and V their
prior-predictive covariance: the curvature of the marginal likelihood along the effect.
"""

from __future__ import annotations

import hashlib
import json
import time
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from cassini_bayes.criticism.catalogue import Catalogue, Effect, read_catalogue
from cassini_bayes.criticism.evidence import STEP, Mode, Weighed, baseline_mode
from cassini_bayes.criticism.extended import (
    Case,
    TelemetrySource,
    compact,
    extend,
    none_hypothesis,
    prepare,
)
from cassini_bayes.criticism.naming import (
    Oscillation,
    Verdict,
    effect_draws,
    effect_values,
    flexible_case,
    name_causes,
    weighted_interval,
)
from cassini_bayes.criticism.p_value import p_value
from cassini_bayes.parameter_space import ParameterSpace
from cassini_bayes.priors import Priors, read_priors
from cassini_bayes.scenario import (
    Simulation,
    draw_truth,
    draw_wheel_rates,
    simulate_file,
    simulated_samples,
)
from cassini_bayes.simulation import SimulatedEvent, scenario_of
from cassini_bayes.storage import write_text

Array = NDArray[np.float64]
# name, number of trials in a full campaign
STRATA: Final = (
    ("prior", 150),
    ("null", 100),
    ("clear", 80),
    ("faint", 60),
    ("uncatalogued", 40),
    ("two", 40),
)
SIGMAS: Final[Mapping[str, tuple[float, float]]] = {
    "clear": (5.0, 10.0),
    "faint": (2.0, 3.0),
    "two": (5.0, 10.0),
}
LARGEST_IN_PRIOR_SCALES: Final = 4.0
NULL_VALUES: Final[Mapping[str, float]] = {"thrust_factor": 1.0}
KEPT_CAUSES: Final = 8
NEWTON_STEPS: Final = 3
SHIFT: Final = 5e-3  # prior scales: small enough for the noise levels to stay where they are
NO_DIAGNOSIS: Final = ("cli", "plots", "report", "templates")
"""Folders of the package whose code no verdict depends on."""
_LEAST_FACTOR: Final = 0.15


@dataclass(frozen=True)
class Hidden:
    """An effect to hide: name as the simulation spells it, its parameters, its size in σ."""

    name: str
    parameters: Mapping[str, float]
    sigma: float


@dataclass(frozen=True)
class Blind:
    """A campaign: scenario, priors, seed, and which of its events are flown."""

    scenario: Path
    priors: Path
    seed: int
    events: tuple[str, ...]

    def document(self, rng: np.random.Generator) -> dict[str, Any]:
        """The scenario with wheel rates of this trial."""
        document = tomllib.loads(self.scenario.read_text(encoding="utf-8"))
        document["event"] = [e for e in document["event"] if e["id"] in self.events]
        draw_wheel_rates(document["event"], rng)
        return document


def stratum_of(index: int) -> str:
    """Stratum of a trial: any first part of the campaign holds all strata in proportion."""
    total = sum(count for _, count in STRATA)
    slots = [((i + 0.5) / count, name) for name, count in STRATA for i in range(count)]
    return sorted(slots)[index % total][1]


def source_of(event: SimulatedEvent) -> TelemetrySource:
    """A simulated event's telemetry as rows, wheel rates in rad/s."""
    samples, thrusters = simulated_samples(event)
    kind, numbers = event.plan.event.kind, tuple(event.plan.wheel_numbers)
    return TelemetrySource(event.plan.event.id, kind, numbers, thrusters, samples)


def fly(
    campaign: Blind, document: dict[str, Any], seed: int, priors: Priors, hidden: Sequence[Hidden]
) -> Simulation:
    """One flight of the scenario with effects hidden in it; same seed, same noise and truth."""
    effects = [{"name": h.name, "parameters": dict(h.parameters)} for h in hidden]
    scenario = scenario_of(
        {**document, "effect": effects}, campaign.scenario.parent, str(campaign.scenario)
    )
    return simulate_file(scenario, seed, priors=priors)


def truth_of(
    campaign: Blind, document: dict[str, Any], seed: int, priors: Priors
) -> dict[str, float]:
    """The truth's parameters without any effect."""
    scenario = scenario_of(document, campaign.scenario.parent, str(campaign.scenario))
    return dict(draw_truth(scenario, seed, priors).parameters)


@dataclass(frozen=True)
class Growth:
    """A way to make an effect grow: parameter values null + s × direction."""

    effect: Effect
    direction: Mapping[str, float]
    constant: Mapping[str, float]

    def values(self, s: float) -> dict[str, float]:
        """Parameters (departures or values) at size s."""
        return {
            **{k: NULL_VALUES.get(k, 0.0) + s * v for k, v in self.direction.items()},
            **self.constant,
        }


def draw_path(effect: Effect, rng: np.random.Generator) -> Growth:
    """A direction drawn like the prior: s = 1 is one prior scale."""
    direction, constant = {}, {}
    for parameter in effect.parameters:
        keywords = parameter.distribution.keywords
        if parameter.key == "warmup_time_s":
            constant[parameter.key] = float(parameter.distribution.sample(rng, 1)[0])
            continue
        scale = float(keywords["scale"])
        if effect.kind in ("thruster_leak", "thrust_warmup"):
            sign = 1.0
        elif effect.kind == "thruster_degraded":
            sign = -1.0
        else:
            sign = float(rng.choice([-1.0, 1.0]))
        share = 1.0 if len(effect.parameters) == 1 else abs(float(rng.standard_normal()))
        direction[parameter.key] = sign * scale * (share if not constant else 1.0)
    if effect.kind == "thrust_warmup":
        scale = float(effect.parameters[0].distribution.keywords["scale"])
        direction = {"warmup_deficit": scale}
    return Growth(effect, direction, constant)


def sensitivity(case: Case, catalogue: Catalogue, base: Mode, path: Growth) -> float:
    """σ per unit of s along a path, by the curvature of the marginal likelihood on null data."""
    none = none_hypothesis(case, catalogue)
    values = [_marginal(case, none, base, path, s) for s in (SHIFT, 0.0, -SHIFT)]
    bend = float((2.0 * values[1] - values[0] - values[2]) / SHIFT**2)
    return float(np.sqrt(bend)) if bend > 0 else 0.0


def _marginal(case: Case, none: Any, base: Mode, path: Growth, s: float) -> float:
    """Log marginal density at a fixed effect, the nuisances integrated out about the mode."""
    extended = extend(none, [path.effect], case)
    values = path.values(s)
    space = extended.model.space
    old = none.model.space
    fixed = {p.name: float(values[p.key]) for p in path.effect.parameters}
    narrowed = ParameterSpace(old.names, {**space.fixed, **fixed}, old.distributions, old.blocks)
    hypothesis = replace(extended, model=replace(extended.model, space=narrowed))
    moves = STEP * base.factor.T
    offsets = np.vstack([0.0 * moves[:1], moves, -moves])
    point, d = base.point, len(base.point)
    for _ in range(NEWTON_STEPS):
        found = hypothesis.log_density(point + offsets)
        gradient = (found[1 : d + 1] - found[d + 1 :]) / (2.0 * STEP)
        point = point + base.factor @ gradient
    found = hypothesis.log_density(point + offsets)
    gradient = (found[1 : d + 1] - found[d + 1 :]) / (2.0 * STEP)
    return float(found[0] + 0.5 * gradient @ gradient)


def hide(
    effect: Effect,
    path: Growth,
    s: float,
    truth: Mapping[str, float],
    sigma: float,
) -> Hidden | None:
    """The effect as the simulation takes it; None where such a size is not physical."""
    values = path.values(s)
    parameters = {}
    for parameter in effect.parameters:
        value = values[parameter.key]
        if parameter.is_departure:
            value += truth[parameter.key]
        low, high = parameter.distribution.support
        if not parameter.is_departure and not low <= value <= high:
            return None
        parameters[parameter.key] = float(value)
    if effect.kind == "tail_off" and parameters["tau_fall_s"] < 0.005:
        return None
    if parameters.get("thrust_factor", 1.0) < _LEAST_FACTOR:
        return None
    return Hidden(effect.name, parameters, sigma)


def draw_effect(catalogue: Catalogue, rng: np.random.Generator) -> Effect:
    """A cause drawn by its prior probability among the catalogue's."""
    weights = np.array([effect.prior_probability for effect in catalogue.effects])
    return catalogue.effects[int(rng.choice(len(weights), p=weights / weights.sum()))]


def choose_hidden(
    stratum: str,
    case: Case,
    catalogue: Catalogue,
    base: Mode,
    truth: Mapping[str, float],
    rng: np.random.Generator,
) -> tuple[Hidden, ...]:
    """What a trial of this stratum hides, sized on the same flight without it."""
    if stratum == "null":
        return ()
    if stratum == "uncatalogued":
        return (draw_uncatalogued(case, rng),)
    if stratum == "prior":
        total = catalogue.none_probability + sum(e.prior_probability for e in catalogue.effects)
        if rng.uniform() < catalogue.none_probability / total:
            return ()
    found: list[Hidden] = []
    while len(found) < (2 if stratum == "two" else 1):
        effect = draw_effect(catalogue, rng)
        if any(h.name.partition(":")[0] == effect.kind for h in found):
            continue
        made = _sized(stratum, effect, case, catalogue, base, truth, rng)
        if made is not None:
            found.append(made)
    return tuple(found)


def _sized(
    stratum: str,
    effect: Effect,
    case: Case,
    catalogue: Catalogue,
    base: Mode,
    truth: Mapping[str, float],
    rng: np.random.Generator,
) -> Hidden | None:
    if effect.kind == "flexible_mode":
        return _flexible(stratum, effect, case, catalogue, base, rng)
    path = draw_path(effect, rng)
    rate = sensitivity(case, catalogue, base, path)
    if stratum == "prior":
        s = float(abs(rng.standard_normal()))
        if len(path.direction) > 1:
            s = 1.0  # every component has its own draw already
        return hide(effect, path, s, truth, s * rate)
    sigma = float(rng.uniform(*SIGMAS[stratum]))
    if rate * LARGEST_IN_PRIOR_SCALES < sigma:
        return None  # these events cannot show it at a size that is believable
    return hide(effect, path, sigma / rate, truth, sigma)


def _flexible(
    stratum: str,
    effect: Effect,
    case: Case,
    catalogue: Catalogue,
    base: Mode,
    rng: np.random.Generator,
) -> Hidden | None:
    frequency = float(10.0 ** rng.uniform(-2.0, -0.5))
    damping, axis = float(rng.choice([0.0, 0.001, 0.003])), int(rng.integers(3))
    shown = flexible_case(case, Oscillation(frequency, damping, axis, 0.0))
    path = Growth(effect, {"cosine_rad_s": 1e-5, "sine_rad_s": 0.0}, {})
    rate = sensitivity(shown, catalogue, base, path)
    if stratum == "prior":
        s = float(np.hypot(*rng.standard_normal(2)))
        sigma = s * rate
    else:
        sigma = float(rng.uniform(*SIGMAS[stratum]))
        s = sigma / rate
    parameters = {
        "frequency_hz": frequency,
        "damping": damping,
        "amplitude_rad_s": s * 1e-5,
        "axis": float(axis),
    }
    return Hidden(effect.name, parameters, sigma)


def draw_uncatalogued(case: Case, rng: np.random.Generator) -> Hidden:
    """Something outside the catalogue, of a size drawn over two decades."""
    kind = str(
        rng.choice(
            ["atmospheric_torque", "pressure_surge", "tachometer_scale", "plume_impingement"]
        )
    )
    event = next(source for source in case.sources if source.thrusters)
    if kind == "atmospheric_torque":
        size = 10.0 ** rng.uniform(-4.7, -3.3) * rng.standard_normal(3)
        parameters = {f"peak_{a}_n_m": float(v) for a, v in zip("xyz", size, strict=True)}
        parameters |= {
            "centre_s": float(rng.uniform(0.2, 0.8) * event.duration_s),
            "width_s": float(rng.uniform(50.0, 250.0)),
        }
        return Hidden(kind, parameters, float("nan"))
    if kind == "pressure_surge":
        surge = {
            "thrust_fraction": float(10.0 ** rng.uniform(-1.5, -0.5)),
            "start_s": float(rng.uniform(0.1, 0.6) * event.duration_s),
            "decay_s": float(rng.uniform(100.0, 500.0)),
        }
        return Hidden(kind, surge, float("nan"))
    if kind == "tachometer_scale":
        slope = float(rng.choice([-1.0, 1.0]) * 10.0 ** rng.uniform(-6.0, -4.5))
        return Hidden(kind, {"slope_per_rpm": slope}, float("nan"))
    thruster = str(rng.choice(event.thrusters))
    lever = float(10.0 ** rng.uniform(-1.5, -0.3))
    return Hidden(f"{kind}:{thruster}", {"lever_m": lever}, float("nan"))


def trial(campaign: Blind, index: int, priors: Priors | None = None) -> dict[str, Any]:
    """One trial, as the record that is kept."""
    own = read_priors(campaign.priors) if priors is None else priors
    rng = np.random.default_rng(np.random.SeedSequence((campaign.seed, index)))
    stratum = stratum_of(index)
    document = campaign.document(rng)
    seed = int(rng.integers(2**62))
    began, worked = time.monotonic(), time.process_time()
    flight = fly(campaign, document, seed, own, ())
    case = prepare([source_of(event) for event in flight.events], own)
    catalogue = read_catalogue(own, case.wheels, case.inputs)
    hidden: tuple[Hidden, ...] = ()
    if stratum != "null":
        none = compact(none_hypothesis(case, catalogue))
        base = baseline_mode(none.log_density, none.dimension)
        truth = truth_of(campaign, document, seed, own)
        hidden = choose_hidden(stratum, case, catalogue, base, truth, rng)
    if hidden:
        flight = fly(campaign, document, seed, own, hidden)
        case = prepare([source_of(event) for event in flight.events], own)
    prepared = time.process_time()
    verdict = name_causes(case, catalogue, rng, pairs=stratum == "two")
    record = _record(verdict, hidden, rng)
    return {
        "index": index,
        "seed": campaign.seed,
        "events": list(campaign.events),
        "code": code_digest(),
        "stratum": stratum,
        **record,
        "cpu_prepare_s": prepared - worked,
        "cpu_diagnose_s": time.process_time() - prepared,
        "wall_s": time.monotonic() - began,
    }


def _record(verdict: Verdict, hidden: Sequence[Hidden], rng: np.random.Generator) -> dict[str, Any]:
    probabilities = verdict.probabilities
    none = verdict.none.log_evidence
    causes = [
        {
            "name": w.name,
            "probability": probabilities[w.name],
            "log_bayes_factor": float(w.log_evidence - w.hypothesis.log_penalty - none),
        }
        for w in verdict.weighed[:KEPT_CAUSES]
    ]
    p = float("nan")
    if verdict.linear is not None:
        p = p_value(verdict.linear, [own.time_s for own in verdict.rows], rng)
    return {
        "hidden": [
            {"name": h.name, "parameters": dict(h.parameters), "sigma": h.sigma} for h in hidden
        ],
        "causes": causes,
        "confounded_with": list(verdict.confounded_with(verdict.best.name)),
        "probability_of_none": probabilities["none"],
        "probability_of_unknown": probabilities["unknown"],
        "probability_of_truth": [probabilities.get(h.name, 0.0) for h in hidden]
        or [probabilities["none"]],
        "rank_of_truth": [_rank(verdict, h.name) for h in hidden],
        "sizes": [s for h in hidden for s in _sizes(verdict, h, rng)],
        "pair": None if verdict.pair is None else verdict.pair.name,
        "pair_gain": None
        if verdict.pair is None
        else float(verdict.pair.log_evidence - verdict.best.log_evidence),
        "p_value": p,
    }


def _rank(verdict: Verdict, name: str) -> int | None:
    """Place of a name among the real causes, from 0; None outside the catalogue."""
    real = [w.name for w in verdict.weighed if w.hypothesis.effects]
    return real.index(name) if name in real else None


def _sizes(
    verdict: Verdict, hidden: Hidden, rng: np.random.Generator
) -> list[dict[str, float | str | bool]]:
    """Whether the 90 % interval of the true cause's parameters holds what was hidden."""
    found: Weighed | None = next((w for w in verdict.weighed if w.name == hidden.name), None)
    if found is None:
        return []
    z, weights = effect_draws(found, rng)
    result: list[dict[str, float | str | bool]] = []
    for key, values in effect_values(found, z).items():
        if key not in hidden.parameters:
            continue
        low, high = weighted_interval(values, weights)
        true = float(hidden.parameters[key])
        result.append(
            {
                "parameter": key,
                "true": true,
                "low": low,
                "high": high,
                "covers": low <= true <= high,
            }
        )
    return result


def code_digest() -> str:
    """SHA-256 over the package's modules and tables that a verdict can depend on."""
    root = Path(__file__).parents[1]
    total = hashlib.sha256()
    for path in sorted([*root.rglob("*.py"), *root.rglob("*.toml")]):
        place = path.relative_to(root)
        if place.parts[0] not in NO_DIAGNOSIS:
            total.update(place.as_posix().encode() + b"\0" + path.read_bytes())
    return total.hexdigest()[:16]


def trial_file(folder: Path, index: int) -> Path:
    """Where a trial's record is kept."""
    return folder / f"trial_{index:04d}.json"


def is_done(campaign: Blind, index: int, folder: Path, code: str) -> bool:
    """Whether the trial's record is there and was made by this campaign and code."""
    path = trial_file(folder, index)
    if not path.exists():
        return False
    found = json.loads(path.read_text(encoding="utf-8"))
    return bool(found["seed"] == campaign.seed and found["code"] == code)


def run_trial(campaign: Blind, index: int, folder: Path) -> None:
    """Run a trial and keep its record."""
    write_text(trial_file(folder, index), json.dumps(trial(campaign, index)) + "\n")
