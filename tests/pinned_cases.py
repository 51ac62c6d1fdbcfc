"""What is pinned, and how it is asked for: where modules move, this file changes and the pins stay.

The tables at the end are all that tests/test_pinned.py and tests/make_pinned.py use: no other
file of the pins imports the package.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import event_cases
import numpy as np
import spacecraft_cases
import telemetry_cases
import totals_cases

from cassini_bayes.balance.statistics import EventStatistics
from cassini_bayes.computing.arrays import Array
from cassini_bayes.diagnosis.balance_case import BalanceCase
from cassini_bayes.diagnosis.estimate_case import EstimateCase
from cassini_bayes.diagnosis.events import Events
from cassini_bayes.diagnosis.evidence import weigh_extensions
from cassini_bayes.diagnosis.gauss_newton import evidence_with_noise, predict_left_out
from cassini_bayes.diagnosis.gauss_newton import fit as fit_on_times
from cassini_bayes.diagnosis.hypotheses import (
    Hypothesis,
    compact,
    extend,
    none_hypothesis,
    unknown_hypothesis,
)
from cassini_bayes.diagnosis.modes import Mode, mode_at
from cassini_bayes.diagnosis.modes import find_mode as mode_with_curvature
from cassini_bayes.diagnosis.on_time_case import OnTimeCase
from cassini_bayes.diagnosis.on_times import OnTimeHypothesis, OnTimes, read_on_times
from cassini_bayes.diagnosis.on_times import hypothesis as on_time_hypothesis
from cassini_bayes.diagnosis.read import read_estimate_case, read_events
from cassini_bayes.diagnosis.search import newton_search
from cassini_bayes.diagnosis.verdict import ranked, weigh
from cassini_bayes.effects.catalogue import Catalogue, read_catalogue
from cassini_bayes.effects.oscillation import Oscillation
from cassini_bayes.events.totals import read_totals
from cassini_bayes.model import (
    Model,
    ReducedEvent,
    build_model,
    collapse,
    conditional_thrusts,
    log_posterior,
    reduce_event,
)
from cassini_bayes.model.telemetry import unknowns_of
from cassini_bayes.prediction.beliefs import read_beliefs
from cassini_bayes.priors.chaining import EarlierFit
from cassini_bayes.priors.distributions import Distribution
from cassini_bayes.priors.reader import Priors, read_priors
from cassini_bayes.sampling.warmstart import Proposal, find_mode, importance, laplace, warm_start
from cassini_bayes.simulation import scenario_of
from cassini_bayes.spacecraft.pulses import PULSE_SHAPES
from cassini_bayes.studies.published_cases import a_branch, flight_2004, fsds
from cassini_bayes.studies.scenario import Simulation, simulate_file, write_simulation

Density = Callable[[Array], Array]
Numbers = Callable[[], Array]

ROOT: Final = Path(__file__).parents[1]
ESTIMATES: Final = ROOT / "priors" / "cassini_a_branch_2004_estimates"
SEED: Final = 7


@dataclass(frozen=True)
class Subject:
    """A log density of walked parameters (names in order) at points z (n, d).

    ``moments`` are what the collapsed blocks say there: name → numbers at z.
    """

    names: tuple[str, ...]
    density: Density
    moments: Mapping[str, Callable[[Array], Array]] = field(default_factory=dict)


def by_name(names: Sequence[str], n: int) -> Array:
    """Points z (n, d), every coordinate from a stream of its name: their order does not matter."""
    streams = [np.random.default_rng(zlib.crc32(name.encode())) for name in names]
    return np.stack([0.5 * rng.standard_normal(n) for rng in streams], axis=-1)


# Totals rows.


def of_model(model: Model) -> Subject:
    """A model of any events."""
    moments = {
        f"own unknowns of {term.id}": partial(own_means, model, place)
        for place, term in enumerate(model.telemetry, start=len(model.totals))
    }
    if model.fired_ids:
        moments |= {
            "thrust mean, N": lambda z: conditional_thrusts(model, z)[0],
            "thrust variance, N2": lambda z: conditional_thrusts(model, z)[1],
        }
    return Subject(model.space.names, partial(log_posterior, model), moments)


class Still(np.random.Generator):
    """A generator whose normal deviates are all zero: draws are then means."""

    def __init__(self) -> None:
        super().__init__(np.random.PCG64(0))

    def standard_normal(self, size: Any = None, *_: Any) -> Any:
        """Zeros."""
        return np.zeros(size)


def own_means(model: Model, place: int, z: Array) -> Array:
    """Mean of an event's initial momentum, torque and cut tails, thrusts at their means."""
    fired = model.fired_of_term[place]
    thrusts = conditional_thrusts(model, z)[0][:, fired]
    drawn = collapse(model, z).terms[place].draw(thrusts, Still())
    return unknowns_of(thrusts[:, :0], drawn)


@cache
def flight_priors() -> Priors:
    """Priors of the eight flight biases."""
    return read_priors(totals_cases.B_BRANCH)


def flight(priors: Priors | None = None, events: int = 8, **choices: Any) -> Subject:
    """The flight biases, with other priors or choices of the model."""
    rows, own = totals_cases.flight(events)
    return of_model(build_model(rows, priors or own, **choices))


def with_wider(priors: Priors, name: str, factor: float) -> Priors:
    """One prior wider by a factor."""
    own = priors.parameters[name].distribution
    assert own is not None
    keywords = {**own.keywords, "scale": factor * own.keywords["scale"]}
    return priors.with_distribution(name, replace(own, keywords=keywords))


def with_student(priors: Priors) -> Priors:
    """The common thrust with a prior that cannot be integrated out."""
    own = priors.parameters["thrust_common_n"].distribution
    assert own is not None
    student = Distribution("t", {"df": 6.0, "loc": own.mean(), "scale": own.sd()})
    return priors.with_distribution("thrust_common_n", student)


def chained() -> Subject:
    """Two flight biases after an earlier fit, whose draws are made up: levels lean on the tail."""
    priors, rng = flight_priors(), np.random.default_rng(SEED)
    names = ("cm_x_m", "cm_y_m", "thruster_lx_m", "tau_fall_s")
    found = [priors.parameters[name].distribution for name in names]
    thrusters = priors.spacecraft.thruster_names(priors.branch)
    root = 0.4 * np.eye(4) + 0.1 * rng.standard_normal((4, 4))
    z = 0.2 + rng.standard_normal((2_000, 4)) @ root.T
    levels = 0.76 - 0.02 * z[:, 3:] + 0.004 * z[:, 3:] ** 2 - 0.01 * z[:, :1]
    levels = levels + 0.015 * rng.standard_normal((2_000, len(thrusters)))
    distributions = tuple(own for own in found if own is not None)
    earlier = EarlierFit(names, distributions, thrusters, z, levels, "made-up.nc", "")
    return flight(replace(priors, earlier=earlier), 2, delta_v="ignore")


def twelve() -> Subject:
    """Another spacecraft: three made-up biases of one with twelve thrusters."""
    priors = spacecraft_cases.priors_of("twelve")
    values = spacecraft_cases.middle("twelve")
    count = len(priors.spacecraft.thruster_names(priors.branch))
    thrust = np.full((3, count), values["thrust_common_n"])
    rng = np.random.default_rng(SEED)
    events = spacecraft_cases.balanced_events("twelve", priors.branch, values, thrust, rng, 3)
    return of_model(build_model(events, priors))


# Telemetry, with totals rows or without.


def telemetry(*names: str, priors: Priors | None = None) -> Subject:
    """Events of tests/event_cases.py, with other priors."""
    return of_model(build_model(event_cases.events(*names), priors or event_cases.priors()))


def mixed(delta_v: Any) -> Subject:
    """Two flight biases as totals rows beside a bias and slews as telemetry."""
    rows, _ = totals_cases.flight(2)
    events = (*rows, *event_cases.events("bias", "slews"))
    return of_model(build_model(events, event_cases.priors(), delta_v=delta_v))


@cache
def with_measured_delta_v() -> ReducedEvent:
    """The bias with a measured velocity change."""
    content = event_cases.document()
    content["event"] = content["event"][:1]
    content["telemetry"] |= {"delta_v": "measured", "delta_v_noise_m_s": 3.0e-5}
    with TemporaryDirectory() as folder:
        write_simulation(simulate_file(scenario_of(content), SEED), Path(folder))
        return reduce_event(Path(folder) / "bias", event_cases.priors(), "first_order")


def measured() -> Subject:
    """The model of that bias."""
    event = with_measured_delta_v()
    assert event.delta_v is not None
    return of_model(build_model([event], event_cases.priors()))


def made_up() -> Subject:
    """Telemetry that no simulation made: with firing and without, long, and sparse."""
    rng = np.random.default_rng(SEED)
    samples = [
        telemetry_cases.made_up_samples(rng, 60),
        telemetry_cases.made_up_samples(rng, 300, fires=False),
        telemetry_cases.made_up_samples(rng, 110, every_s=4.0),
    ]
    priors = event_cases.priors()
    return of_model(
        build_model(
            [telemetry_cases.event_of(own, priors, f"e{i}") for i, own in enumerate(samples)],
            priors,
        )
    )


# A diagnosis of telemetry, and one of totals rows.

LINE: Final = Oscillation(frequency_hz=0.05, damping=0.003, direction=(0.0, 1.0, 0.0), span_s=400.0)
TELEMETRY_CAUSES: Final = (
    "thruster_leak:z3",
    "tail_off",
    "thrust_warmup",
    "rate_scale:y",
    "time_offset",
    "flexible_mode",
)
TOTALS_CAUSES: Final = ("thrust_scale", "center_of_mass:y", "external_torque")
LEAK: Final = "thruster_leak:z3"
LEAKING_CAUSES: Final = (LEAK, "external_torque", "thruster_degraded:z3")
NAMED: Final = (LEAK, "thruster_degraded:z3")


@cache
def telemetry_case() -> Events:
    """The bias of tests/event_cases.py, read as a diagnosis reads it."""
    return read_events([str(event_cases.simulated() / "bias")], event_cases.PRIORS)


@cache
def leaking_case() -> Events:
    """The same bias with a leaking valve, far from what the baseline can follow."""
    content = event_cases.document()
    content["event"] = content["event"][:1]
    content["effect"] = [{"name": LEAK, "parameters": {"leak_n": 4e-4}}]
    with TemporaryDirectory() as folder:
        write_simulation(simulate_file(scenario_of(content), SEED), Path(folder))
        return read_events([str(Path(folder) / "bias")], event_cases.PRIORS)


@cache
def totals_case() -> Events:
    """The eight flight biases as totals rows."""
    return read_events([str(totals_cases.FLIGHT)], totals_cases.B_BRANCH)


def causes_of(events: Events, names: Sequence[str]) -> dict[str, Hypothesis]:
    """``none``, ``unknown`` and some causes of the catalogue."""
    found = {
        "none": compact(none_hypothesis(events)),
        "unknown": compact(unknown_hypothesis(events)),
    }
    for name in names:
        effect = events.catalogue.effect(name)
        if effect.needs_search:
            effect = replace(effect, search_result=LINE)
        own = events.with_columns_of([effect])
        found[name] = compact(extend(none_hypothesis(own), [effect]))
    return found


@cache
def telemetry_causes() -> dict[str, Hypothesis]:
    """Hypotheses on the bias."""
    return causes_of(telemetry_case(), TELEMETRY_CAUSES)


@cache
def leaking_causes() -> dict[str, Hypothesis]:
    """Hypotheses on the bias with a leak."""
    return causes_of(leaking_case(), LEAKING_CAUSES)


@cache
def totals_causes() -> dict[str, Hypothesis]:
    """Hypotheses on the flight biases."""
    return causes_of(totals_case(), TOTALS_CAUSES)


@dataclass(frozen=True)
class Cause:
    """A hypothesis of a diagnosis: density, evidence by Laplace at a mode, and its search."""

    hypotheses: Callable[[], dict[str, Hypothesis]]
    name: str

    def subject(self) -> Subject:
        """Walked parameters and density."""
        own = self.hypotheses()[self.name]
        return Subject(own.model.space.names, own.log_density)

    def laplace(self, point: Array, factor: Array) -> float:
        """Log evidence at a point (d,) with a factor (d, d) of the Laplace covariance."""
        return mode_at(self.hypotheses()[self.name].log_density, point, factor).log_evidence

    def sought(self) -> tuple[Array, Array, float]:
        """Point (d,), factor (d, d) and log evidence where the search ends."""
        found = sought(self)
        return found.point, found.factor, found.log_evidence


@cache
def sought(cause: Cause) -> Mode:
    """Where a diagnosis ends its search: from the prior's centre, or beside the baseline."""
    own = cause.hypotheses()[cause.name]
    if cause.name in ("none", "unknown"):
        return mode_with_curvature(own.log_density, own.dimension)
    base = sought(replace(cause, name="none"))
    (found,) = weigh_extensions([own], [newton_search(own, base)], base, lambda _: None)
    return found.mode


def verdict() -> Array:
    """Log evidences and probabilities of none, unknown and two causes of the leak."""
    events = leaking_case()
    case = BalanceCase(replace(events, catalogue=few(events.catalogue, NAMED)))
    found = weigh(case, np.random.default_rng(1), pairs=False)
    names = ("none", "unknown", *NAMED)
    evidence = {own.name: own.net_evidence for own in found.weighed}
    return np.array([[evidence[name], found.probabilities[name]] for name in names])


def few(catalogue: Catalogue, names: Sequence[str]) -> Catalogue:
    """A catalogue of some of its effects."""
    return replace(catalogue, effects=tuple(catalogue.effect(name) for name in names))


# Importance draws and the warm start.


def evidence_draws(subject: Subject, point: Array, factor: Array) -> Array:
    """Log evidence, its error and efficiency of seeded draws from a given proposal."""
    proposal = Proposal(point, factor, 15.0)
    found = importance(subject.density, proposal, np.random.default_rng(SEED), 1_000)
    return np.array([found.log_evidence, found.log_evidence_se, found.efficiency])


def warm_evidence() -> Array:
    """Log evidence of two flight biases by the warm start: importance draws, and Laplace."""
    subject = flight(None, 2, delta_v="ignore")
    rng = np.random.default_rng(SEED)
    found = warm_start(subject.density, len(subject.names), rng, draws=2_000)
    return np.array([found.draws.log_evidence, found.laplace_log_evidence])


def mode_and_factor(subject: Subject) -> tuple[Array, Array]:
    """Mode and Laplace factor: only for choosing points."""
    return laplace(subject.density, find_mode(subject.density, np.zeros(len(subject.names))))


# On-times of the ideal calculation.

ON_TIME_CAUSES: Final = ("thrust_scale", "tail_off", "center_of_mass:y", "firing_logic")


@cache
def on_times() -> OnTimes:
    """Four flight biases."""
    rows = read_totals(totals_cases.FLIGHT, flight_priors().spacecraft, "flight")
    return read_on_times((*rows[:2], rows[3], rows[5]), flight_priors(), read_beliefs())


@cache
def on_time_catalogue() -> Catalogue:
    """A few causes of wrong on-times."""
    return few(read_catalogue(flight_priors(), (1, 2, 4), ("on_times",)), ON_TIME_CAUSES)


def on_time_model(name: str) -> OnTimeHypothesis:
    """The ideal calculation, with one cause or none."""
    effects = () if name == "none" else (on_time_catalogue().effect(name),)
    return on_time_hypothesis(on_times(), effects)


def on_time_points(own: OnTimeHypothesis) -> Array:
    """Points (3, d): walked parameters, then departures of the thrusters."""
    thrusters = [f"thruster {i}" for i in range(on_times().thrusters)]
    return by_name([*own.space.names, *thrusters], 3)


def predicted_on_times(name: str) -> Array:
    """On-times (3, E, U)."""
    own = on_time_model(name)
    return own.model.forward(on_time_points(own))


def on_time_noise(name: str) -> Array:
    """Covariance (E, U, U) of on-times at a point."""
    own = on_time_model(name)
    return own.model.noise(on_time_points(own)[0])


def on_time_evidence(name: str) -> Array:
    """Log evidence, χ², and log evidence with noise of two sizes added."""
    seen = on_times().printed_s
    found = fit_on_times(seen, on_time_model(name).model)
    noisy = evidence_with_noise(seen, found, np.array([0.3, 1.0]))
    return np.array([found.log_evidence, found.chi_square, *noisy])


def on_time_left_out() -> Array:
    """The second bias predicted from the others: means and covariance (U, 1 + U)."""
    model = on_time_model("firing_logic").model
    mean, covariance, _ = predict_left_out(
        on_times().printed_s, model, 1, np.zeros(model.dimension)
    )
    return np.column_stack([mean, covariance])


def on_time_verdict() -> Array:
    """Log evidences and probabilities of none, unknown and the few causes; last row p-value."""
    case = OnTimeCase(on_times(), on_time_catalogue())
    found = weigh(case, np.random.default_rng(1))
    names = ("none", "unknown", *ON_TIME_CAUSES)
    rows = [[found.named(n).log_evidence, found.probabilities[n]] for n in names]
    first = found.best.mode.log_evidence
    second = max((own.mode.log_evidence - first for own in found.pairs), default=np.nan)
    return np.array([*rows, [second, case.p_value(found.none, np.random.default_rng(0))]])


# Printed estimates.


@cache
def estimates() -> Mapping[str, EstimateCase]:
    """Published cases and the example file."""
    example = read_estimate_case(
        [str(ESTIMATES.with_suffix(".csv"))], ESTIMATES.with_suffix(".toml")
    )
    published = {"flight 2004": flight_2004(), "test bed": fsds(), "A branch": a_branch()[1]}
    return {**published, "example file": example}


def predicted_estimates(name: str) -> Array:
    """Estimates and their own spread of every hypothesis at two points, (C, 2, 2, E)."""
    rng, parts = np.random.default_rng(SEED), []
    for cause in estimates()[name].hypotheses(1.0):
        own = cause.predict(rng.standard_normal((2, cause.dimension)))
        parts.append(np.stack([own.estimate_n, own.independent_sd_n]))
    return np.stack(parts)


def weighed_estimates(name: str) -> Array:
    """Log evidence and probability of every hypothesis, (C, 2)."""
    case = estimates()[name]
    found = case.weighed(case.hypotheses(1.0), np.random.default_rng(SEED), 4_000)
    shares = ranked(found).probabilities
    return np.array([[own.log_evidence, shares[own.name]] for own in found])


# Simulated telemetry and its reduction.

HIDDEN: Final[Mapping[str, Mapping[str, float]]] = {
    "thruster_leak:z3": {"leak_n": 2e-4},
    "tail_off": {"tau_fall_s": 0.065},
    "thrust_warmup": {"warmup_deficit": 0.3, "warmup_time_s": 2.0},
    "pulse_shape": {"impulse_time_offset_s": 0.012},
    "center_of_mass:y": {"cm_y_m": 0.10},
    "wheel_alignment:4": {"rwa4_tilt_u_rad": 0.05, "rwa4_tilt_v_rad": 0.02},
    "external_torque": {f"external_torque_{axis}_n_m": 2e-5 for axis in "xyz"},
    "rate_bias:z": {"rate_bias_z_rad_s": 1e-5},
    "rate_scale:x": {"rate_scale": 0.02},
    "time_offset": {"time_offset_s": 0.5},
    "flexible_mode": {
        "frequency_hz": 0.13,
        "damping": 0.002,
        "amplitude_rad_s": 1e-5,
        "inertia_fraction": 0.002,
    },
}
KEPT_ROWS: Final = (0, 1, 57, 200, -1)


@cache
def simulated(hidden: bool) -> Simulation:
    """Bias and slews of tests/event_cases.py, as they are or with effects of many kinds."""
    content = event_cases.document()
    if hidden:
        content["effect"] = [{"name": k, "parameters": dict(v)} for k, v in HIDDEN.items()]
        content["telemetry"] |= {"delta_v": "measured", "pressure": True, "drop_out": 0.01}
        content["telemetry"] |= {"wheel_resolution_rpm": 0.1}
    return simulate_file(scenario_of(content), SEED)


def channels(hidden: bool, event: int) -> Array:
    """Every column of an event's telemetry: rows, mean, mean square, some rows; (C, 3 + k).

    What was not sampled counts as −1.
    """
    seen = simulated(hidden).events[event].telemetry
    found = []
    for values in (seen.time_s, *(seen.columns[name] for name in sorted(seen.columns))):
        whole = np.nan_to_num(values, nan=-1.0)
        sizes = [len(whole), whole.mean(), (whole**2).mean()]
        found.append([*sizes, *whole[list(KEPT_ROWS)]])
    return np.array(found)


def sizes_of(statistics: EventStatistics) -> tuple[Array, Array]:
    """Order of the columns by name, vector columns and scalar ones, and their norms (3, A)."""
    layout = statistics.layout
    names = np.array([*layout.vector, *layout.scalar])
    squares = np.array([np.diagonal(statistics.gram[c, c]) for c in range(3)])
    return np.argsort(names), np.sqrt(squares)


def gram(statistics: EventStatistics) -> Array:
    """Norms of the columns (3, A) in order of their names, and counts."""
    order, norms = sizes_of(statistics)
    counts = [statistics.rows, statistics.duration_s, statistics.counter_interval_s]
    return np.concatenate([norms[:, order].reshape(-1), counts, statistics.cuts])


def projected(statistics: EventStatistics) -> Array:
    """Random projections of the Gram matrices (of columns of unit length): (4, 9 + 3 + 1)."""
    order, norms = sizes_of(statistics)
    rng = np.random.default_rng(SEED)
    inverse = np.where(norms > 0.0, 1.0 / np.where(norms > 0.0, norms, 1.0), 0.0)[:, order]
    whole = statistics.gram[:, :, order[:, None], order]
    waves = statistics.projection[:, :, order]
    found = []
    for _ in range(4):
        left, right = rng.standard_normal((2, len(order)))
        wave, other = rng.standard_normal((2, len(waves)))
        pairs = np.einsum("ca,cdab,db->cd", inverse * left, whole, inverse * right)
        mixed = np.einsum("m,mca,ca->c", wave, waves, inverse * right)
        found.append([*pairs.reshape(-1), *mixed, wave @ statistics.mode_gram @ other])
    return np.array(found)


def of_event(name: str) -> EventStatistics:
    """An event reduced for a fit."""
    return event_cases.events(name)[0].statistics


def of_diagnosis() -> EventStatistics:
    """The bias reduced with all columns that effects need."""
    events = telemetry_case()
    line = replace(events.catalogue.effect("flexible_mode"), search_result=LINE)
    return events.with_columns_of([line]).telemetry[0].statistics


# What random numbers everything above leans on.


def draws_of_numpy() -> Array:
    """The first draws of a seed, of every kind that the package takes."""
    rng = np.random.default_rng(SEED)
    child = rng.spawn(1)[0]
    return np.array(
        [
            *rng.standard_normal(3),
            *rng.chisquare(8.0, 3),
            *rng.random(3),
            *rng.uniform(-3.0, 3.0, 3),
            *rng.permutation(9),
            *rng.integers(1_000, size=3),
            *child.standard_normal(3),
        ]
    )


# The tables.

SUBJECTS: Final[Mapping[str, Callable[[], Subject]]] = {
    "totals, ΔV as declared": cache(partial(flight, delta_v="as-declared")),
    "totals, ΔV ignored": cache(partial(flight, delta_v="ignore")),
    "totals, ΔV as measured": cache(partial(flight, delta_v="as-measured")),
    **{
        f"totals, {shape} pulses": cache(partial(flight, None, 4, pulse_shape=shape))
        for shape in sorted(set(PULSE_SHAPES) - {"first_order"})
    },
    "totals, common thrust walked": cache(lambda: flight(with_student(flight_priors()))),
    "totals, after an earlier fit": cache(chained),
    "totals, twelve thrusters": cache(twelve),
    "telemetry, bias": cache(partial(telemetry, "bias")),
    "telemetry, slews": cache(partial(telemetry, "slews")),
    "telemetry, both": cache(partial(telemetry, "bias", "slews")),
    "telemetry, common thrust walked": cache(
        lambda: telemetry("bias", priors=with_student(event_cases.priors()))
    ),
    "telemetry, measured ΔV": cache(measured),
    "telemetry, made up": cache(made_up),
    "mixed, ΔV as declared": cache(partial(mixed, "as-declared")),
    "mixed, ΔV as measured": cache(partial(mixed, "as-measured")),
}
"""Densities: what they are called → how they are made."""

THRUSTS: Final = ("thrust mean, N", "thrust variance, N2")
OWN: Final = ("own unknowns of bias", "own unknowns of slews")
WITH_MOMENTS: Final[Mapping[str, Sequence[str]]] = {
    "totals, ΔV as declared": THRUSTS,
    "totals, ΔV as measured": THRUSTS,
    "totals, after an earlier fit": THRUSTS,
    "telemetry, both": (*THRUSTS, *OWN),
    "telemetry, measured ΔV": (*THRUSTS, OWN[0]),
    "mixed, ΔV as declared": (*THRUSTS, *OWN),
}
"""Densities whose collapsed blocks are pinned, and which moments of them."""

CAUSES: Final[Mapping[str, Cause]] = {
    **{
        f"telemetry, {name}": Cause(telemetry_causes, name)
        for name in ("none", "unknown", *TELEMETRY_CAUSES)
    },
    **{
        f"leak, {name}": Cause(leaking_causes, name)
        for name in ("none", "unknown", *LEAKING_CAUSES)
    },
    **{
        f"totals, {name}": Cause(totals_causes, name)
        for name in ("none", "unknown", *TOTALS_CAUSES)
    },
}
"""Hypotheses of diagnoses."""

DRAWN: Final = ("telemetry, thruster_leak:z3", "totals, none")
"""Those of the hypotheses whose evidence is drawn from the stored Laplace approximation."""

WIDER: Final[Mapping[str, Callable[[float], Subject]]] = {
    "totals, ΔV as declared": lambda factor: flight(with_wider(flight_priors(), "cm_y_m", factor)),
    "telemetry, both": lambda factor: telemetry(
        "bias", "slews", priors=with_wider(event_cases.priors(), "inertia_xx_kg_m2", factor)
    ),
}
"""Densities with one prior wider by a factor, for the negative control."""

EXACT: Final[Mapping[str, Numbers]] = {"numpy's draws": draws_of_numpy}
"""Numbers that are the same bit for bit."""

CLOSED: Final[Mapping[str, Numbers]] = {
    **{f"on-times, {n}": partial(predicted_on_times, n) for n in ("none", *ON_TIME_CAUSES)},
    **{f"on-times, noise, {n}": partial(on_time_noise, n) for n in ("none", "firing_logic")},
    **{
        f"estimates, {name}": partial(predicted_estimates, name)
        for name in ("flight 2004", "test bed", "A branch", "example file")
    },
    **{
        f"simulated {event}, {'effects' if hidden else 'nothing'} hidden": partial(
            channels, hidden, place
        )
        for hidden in (False, True)
        for place, event in enumerate(("bias", "slews"))
    },
    "columns of the bias": lambda: gram(of_event("bias")),
    "columns of the slews": lambda: gram(of_event("slews")),
    "columns of a diagnosis": lambda: gram(of_diagnosis()),
    "Gram matrices of the bias": lambda: projected(of_event("bias")),
    "Gram matrices of the slews": lambda: projected(of_event("slews")),
    "Gram matrices of a diagnosis": lambda: projected(of_diagnosis()),
}
"""Numbers of closed formulae."""

SOUGHT: Final[Mapping[str, Numbers]] = {
    **{f"on-times, evidence, {n}": partial(on_time_evidence, n) for n in ("none", *ON_TIME_CAUSES)},
    "on-times, a bias left out": on_time_left_out,
    "on-times, verdict": on_time_verdict,
    **{
        f"estimates, evidence, {name}": partial(weighed_estimates, name)
        for name in ("flight 2004", "test bed", "A branch", "example file")
    },
    "diagnosis of the leak, verdict": verdict,
    "warm start of two totals rows": warm_evidence,
}
"""Numbers at the end of a search (and of seeded draws about where it ended)."""
