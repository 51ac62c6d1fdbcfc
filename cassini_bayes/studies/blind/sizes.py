"""Effects to hide, with sizes in σ = √(δᵀV⁻¹δ).

A first guess of the size is the curvature of the marginal likelihood on the flight without the
effect. Controllers answer an effect and counters show only whole readings, so that the size that
counts is measured on the flight that has it (:mod:`cassini_bayes.studies.blind.shift`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.stats import chi

from cassini_bayes.computing.arrays import Array
from cassini_bayes.computing.cached import cached_property
from cassini_bayes.diagnosis.events import Events
from cassini_bayes.diagnosis.hypotheses import Hypothesis, compact, none_hypothesis
from cassini_bayes.diagnosis.modes import Mode, highest_mode, mode_near
from cassini_bayes.diagnosis.second_reckoning import acts_on_pulses
from cassini_bayes.effects.effect import Effect
from cassini_bayes.effects.line_shapes import SIZES
from cassini_bayes.effects.oscillation import FASTEST
from cassini_bayes.errors import InputError
from cassini_bayes.priors.parameter_space import ParameterSpace
from cassini_bayes.simulation import Truth
from cassini_bayes.studies.blind.flights import PHASE_STEP, Hidden, Scene
from cassini_bayes.studies.blind.oscillations import hidden_line, hidden_oscillation
from cassini_bayes.studies.blind.rate_information import RATE_KINDS
from cassini_bayes.studies.blind.shift import (
    View,
    added_size,
    at_truth,
    changed_size,
    held,
    in_noise_of,
    modelled_size,
)

LARGEST_IN_PRIOR_SCALES: Final = 2.5
"""What is larger is not believed: one prior draw in eighty. Truths that priors exclude measure how
hard a prior pulls, not whether intervals are right."""
NULL_VALUES: Final[Mapping[str, float]] = {"thrust_factor": 1.0}
NEWTON_STEPS: Final = 3
STEP: Final = 0.05  # standard deviations, for slopes
SHIFT: Final = 5e-3  # prior scales: small enough for the noise levels to stay where they are
BESIDE_NONE: Final = 4.0 * SHIFT  # prior scales: SHIFT to either side is on one side of none
SEEN_AT: Final[Mapping[str, float]] = {"time_offset": 0.3}
"""Prior scales at which a kind is first seen: pulses that a record has just hidden have given
nothing, so that beside none it has no curvature."""
STARTS_ANEW: Final = 0.5  # of oscillations, as a diagnosis believes
MOST_FLIGHTS: Final = 6
MOST_DRAWS: Final = 50
SAME_SIZE: Final = 0.05
_LEAST_FACTOR: Final = 0.15
_LEAST_TAU_S: Final = 0.005
_ONE_SIDED: Final[Mapping[str, float]] = {
    "thruster_leak": 1.0,
    "thrust_warmup": 1.0,
    "thruster_degraded": -1.0,
}


@dataclass(frozen=True)
class Stage:
    """A trial before anything is hidden: its flight, baseline and truth."""

    scene: Scene
    events: Events
    base: Mode
    truth: Truth

    @cached_property
    def plain(self) -> View:
        """The flight without noise and without any effect."""
        return self._seen(())

    @property
    def fires(self) -> bool:
        """Whether any thruster fires in its events."""
        return any(event.fires for event in self.events.telemetry)

    def view(self, hidden: Hidden) -> View:
        """The flight without noise that has this effect."""
        return self._seen((hidden,))

    def _seen(self, hidden: Sequence[Hidden]) -> View:
        quiet = at_truth(self.scene.fly_quietly(hidden), self.truth)
        if self.scene.condition is None:
            return quiet
        return in_noise_of(quiet, self.scene.fly(hidden), self.truth)


def stage(scene: Scene, events: Events, base: Mode) -> Stage:
    """Set up what a size is measured on."""
    return Stage(scene, events, base, scene.truth())


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
    """A direction drawn like the prior: s = 1 is one prior scale, of all parameters together."""
    constant, scales = {}, {}
    for parameter in effect.parameters:
        if parameter.distribution.name == "lognorm":  # a time constant has no null
            constant[parameter.key] = float(parameter.distribution.sample(rng, 1)[0])
        else:
            scales[parameter.key] = parameter.distribution.scale
    shares = np.abs(rng.standard_normal(len(scales)))
    shares /= np.linalg.norm(shares)
    side = _ONE_SIDED.get(effect.kind.name)
    signs = rng.choice([-1.0, 1.0], len(scales)) if side is None else np.full(len(scales), side)
    each = zip(scales.items(), (signs * shares).tolist(), strict=True)
    return Growth(effect, {key: scale * share for (key, scale), share in each}, constant)


def draw_from_prior(effect: Effect, rng: np.random.Generator) -> Growth:
    """Values drawn from the catalogue's priors: they are those at s = 1."""
    drawn = {p.key: float(p.distribution.sample(rng, 1)[0]) for p in effect.parameters}
    return _through(effect, drawn)


def path_to(effect: Effect, values: Mapping[str, float], truth: Mapping[str, float]) -> Growth:
    """The way of an effect to values as they are flown, beside the truth without it, at s = 1."""
    departures = {
        p.key: float(values[p.key]) - (truth[p.baseline] if p.is_departure else 0.0)
        for p in effect.parameters
    }
    return _through(effect, departures)


def _through(effect: Effect, values: Mapping[str, float]) -> Growth:
    """The way of an effect through values (departures or values, by key), which it has at s = 1."""
    direction, constant = {}, {}
    for parameter in effect.parameters:
        value = values[parameter.key]
        if parameter.distribution.name == "lognorm":
            constant[parameter.key] = value
        else:
            direction[parameter.key] = value - NULL_VALUES.get(parameter.key, 0.0)
    return Growth(effect, direction, constant)


def sensitivity(
    events: Events, base: Mode, path: Growth, at: float = 0.0, beside: float = 0.0
) -> float:
    """σ per unit of s along a path, by the curvature of the marginal likelihood at a size.

    ``base`` is the baseline's mode with the effect at size ``at``, zero on data without it. The
    curvature is taken so much ``beside`` that.
    """
    none = none_hypothesis(events)
    values = [_marginal(none, base, path, at, beside + s) for s in (SHIFT, 0.0, -SHIFT)]
    bend = float((2.0 * values[1] - values[0] - values[2]) / SHIFT**2)
    return float(np.sqrt(bend)) if bend > 0 else 0.0


def _marginal(none: Hypothesis, base: Mode, path: Growth, at: float, shift: float) -> float:
    """Log marginal density at a fixed effect, the nuisances integrated out about the mode.

    ``base`` is the mode where the effect has the size ``at``. Data tell the sum of a departure and
    its parameter, often far better than the departure moves: what it gains the parameter loses.
    """
    hypothesis = held(none, path.effect, path.values(at + shift))
    moves = STEP * base.factor.T
    offsets = np.vstack([0.0 * moves[:1], moves, -moves])
    added = {p.baseline: path.direction[p.key] for p in path.effect.parameters if p.is_departure}
    point, d = base.point - shift * taken_up(none.model.space, added), len(base.point)
    for _ in range(NEWTON_STEPS):
        values = hypothesis.log_density(point + offsets)
        gradient = (values[1 : d + 1] - values[d + 1 :]) / (2.0 * STEP)
        point = point + base.factor @ gradient
    values = hypothesis.log_density(point + offsets)
    gradient = (values[1 : d + 1] - values[d + 1 :]) / (2.0 * STEP)
    return float(values[0] + 0.5 * gradient @ gradient)


def taken_up(space: ParameterSpace, added: Mapping[str, float]) -> Array:
    """What is added to parameters by name, in standard values (d,); some may not be walked."""
    result = np.zeros(len(space.names))
    for name, value in added.items():
        if name in space.names:
            place = space.names.index(name)
            result[place] = value / space.distributions[place].sd()
    return result


def hide(path: Growth, s: float, truth: Mapping[str, float], sigma: float) -> Hidden | None:
    """The effect as the simulation takes it; None where such a size is not physical."""
    values = path.values(s)
    parameters = {}
    for parameter in path.effect.parameters:
        value = values[parameter.key]
        low, high = parameter.distribution.support
        if not low <= value <= high:
            return None
        if parameter.is_departure:
            value += truth[parameter.baseline]
        if parameter.key.endswith("inertia_kg_m2") and value <= 0.0:
            return None
        parameters[parameter.key] = float(value)
    if parameters.get("tau_fall_s", 1.0) < _LEAST_TAU_S:
        return None
    if parameters.get("thrust_factor", 1.0) < _LEAST_FACTOR:
        return None
    return Hidden(path.effect.name, parameters, sigma)


def measured(stage: Stage, path: Growth, s: float) -> Hidden | None:
    """The effect at size s with its σ on the flight that has it; None if it cannot be flown."""
    hidden = hide(path, s, stage.truth.parameters, float("nan"))
    if hidden is None:
        return None
    try:
        sigma = _flown_size(stage, hidden, path, s)
    except InputError:
        return None  # not a spacecraft, or not a motion, that the simulation accepts
    return Hidden(hidden.name, hidden.parameters, sigma)


def _flown_size(stage: Stage, hidden: Hidden, path: Growth, s: float) -> float:
    """σ on the flight that has the effect at size s.

    Late records show nothing up to a control cycle, and then much: theirs is what they change.
    """
    if path.effect.kind.name == "time_offset":
        return changed_size(stage.view(hidden), stage.plain)
    if stage.scene.condition is None:
        return modelled_size(stage.view(hidden), path.effect, path.values(s))
    return size_on(stage.scene.fly((hidden,)), path, s, stage.base)


def size_on(events: Events, path: Growth, s: float, start: Mode | None = None) -> float:
    """σ of an effect at size s on events that have it, under the conditions that they have.

    V has all that these change: what coarse counters leave open, and what attitudes tell of rates
    that are coarser. What acts on pulses is measured by what it adds to rows and turns, where V is
    a linear model's. It bends what is not known: 0.7 of a thrust has 0.7 of its scatter, so that
    the curvature there would be too large by 1.4. Body, wheels and gyro make the channels that the
    linear model smooths, and have the curvature of the marginal likelihood.

    ``start``: a mode of the baseline to search from.
    """
    with_it, near = _flown_with(events, path, s, start)
    none = compact(none_hypothesis(events))
    if acts_on_pulses(none, with_it, near.point):
        return added_size(none, with_it, near.point)
    return s * sensitivity(events, near, path, s)


def sized_from_prior(stage: Stage, effect: Effect, rng: np.random.Generator) -> Hidden | None:
    """An effect with its size from the catalogue's prior; None if no draw can be flown."""
    if effect.kind.search is not None:
        return _flexible(stage, effect, None, rng)
    for _ in range(MOST_DRAWS):
        path = draw_from_prior(effect, rng)
        if effect.kind.name in RATE_KINDS:
            rate = sensitivity(stage.events, stage.base, path)
            hidden = hide(path, 1.0, stage.truth.parameters, rate)
        else:
            hidden = measured(stage, path, 1.0)
        if hidden is not None:
            return hidden
    return None


def sized_between(
    stage: Stage, effect: Effect, low: float, high: float, rng: np.random.Generator
) -> Hidden | None:
    """An effect of low to high σ; None where no size that is believable and flies is that large.

    Between these bounds sizes are distributed as the prior has them.
    """
    if effect.kind.search is not None:
        return _flexible(stage, effect, (float(rng.uniform(low, high)), (low, high)), rng)
    path = draw_path(effect, rng)
    # over conditions beside none: a kinked effect has no curvature there
    beside = 0.0 if stage.scene.condition is None else BESIDE_NONE
    beside = SEEN_AT.get(effect.kind.name, beside)
    rate = sensitivity(stage.events, stage.base, path, beside=beside)
    if rate <= 0.0 or low / rate > LARGEST_IN_PRIOR_SCALES:
        return None
    size = chi(len(path.direction))
    most = min(high / rate, LARGEST_IN_PRIOR_SCALES)
    start = float(size.isf(rng.uniform(size.sf(most), size.sf(low / rate))))
    sigma = start * rate
    if effect.kind.name in RATE_KINDS:
        return hide(path, start, stage.truth.parameters, sigma)
    return search_size(lambda s: measured(stage, path, s), start, sigma, (low, high))


def search_size(
    at: Callable[[float], Hidden | None],
    start: float,
    sigma: float,
    span: tuple[float, float],
    largest: float = LARGEST_IN_PRIOR_SCALES,
) -> Hidden | None:
    """Find s whose measured σ is within 5 % of ``sigma``, or, at the end, inside ``span``.

    Secant steps in log s, a factor of four at most: σ of a time offset rises in steps.
    """
    s, best = start, None
    pairs: list[tuple[float, float]] = []
    for _ in range(MOST_FLIGHTS):
        hidden = at(s)
        if hidden is None:
            return best
        reached = max(hidden.sigma, 1e-3)
        if span[0] <= reached <= span[1] and (
            best is None or abs(reached - sigma) < abs(best.sigma - sigma)
        ):
            best = hidden
        if abs(reached - sigma) < SAME_SIZE * sigma:
            break
        pairs.append((s, reached))
        following = _next(pairs, sigma, largest)
        if following is None:
            break
        s = following
    return best


def _next(pairs: list[tuple[float, float]], sigma: float, largest: float) -> float | None:
    """Next s: between the nearest below and above, else by proportion; None beyond belief."""
    below = [pair for pair in pairs if pair[1] < sigma]
    above = [pair for pair in pairs if pair[1] > sigma]
    if below and above:
        (a, fa), (b, fb) = max(below), min(above)
        share = np.log(sigma / fa) / np.log(fb / fa)
        return float(np.exp(np.log(a) + np.clip(share, 0.15, 0.85) * np.log(b / a)))
    s, value = pairs[-1]
    if s >= largest and value < sigma:
        return None
    return min(s * float(np.clip(sigma / value, 0.25, 4.0)), largest)


def _flexible(
    stage: Stage,
    effect: Effect,
    wanted: tuple[float, tuple[float, float]] | None,
    rng: np.random.Generator,
) -> Hidden | None:
    """An oscillation between 10 and 316 mHz (log-uniform), size σ and its span given or by prior.

    It is no faster than rows show. Half of them start every event anew. Amplitude and moving
    inertia grow together: however little it swings at first, an appendage is driven by whatever
    moves the body.
    """
    samples = [event.samples for event in stage.events.telemetry]
    fastest = FASTEST / max(float(np.median(np.diff(s.time_s[s.has_state]))) for s in samples)
    known = {
        "frequency_hz": float(10.0 ** rng.uniform(-2.0, min(-0.5, np.log10(fastest)))),
        "damping": float(rng.choice([0.0, 0.001, 0.003])),
        "axis": float(rng.integers(3)),
    }
    if rng.random() < STARTS_ANEW:
        known[PHASE_STEP] = float(rng.uniform(0.0, 2.0 * np.pi))
    drawn = {p.key: float(p.distribution.sample(rng, 1)[0]) for p in effect.parameters}
    swing, moved = rng.choice(SIZES, 2)
    amplitude = float(swing * np.hypot(drawn["cosine_rad_s"], drawn["sine_rad_s"]))
    share = float(moved * drawn["inertia_fraction"])
    scales = {p.key: p.distribution.scale for p in effect.parameters}
    largest = LARGEST_IN_PRIOR_SCALES * min(
        scales["cosine_rad_s"] / amplitude, scales["inertia_fraction"] / share
    )

    def at(s: float) -> Hidden | None:
        parameters = {
            **known,
            "amplitude_rad_s": s * amplitude,
            "inertia_fraction": s * share,
        }
        hidden = Hidden(effect.name, parameters, float("nan"))
        try:
            return replace(hidden, sigma=_flown_oscillation(stage, effect, hidden))
        except InputError:
            return None  # not a motion that the simulation accepts

    if wanted is None:
        return at(1.0)
    sigma, span = wanted
    return search_size(at, min(1.0, largest), sigma, span, largest)


def _flown_with(
    events: Events, path: Growth, s: float, start: Mode | None
) -> tuple[Hypothesis, Mode]:
    """The baseline with the effect at size s, on the flight that has it, and its mode there."""
    with_it = compact(held(none_hypothesis(events), path.effect, path.values(s)))
    if start is not None and with_it.dimension == len(start.point):
        return with_it, mode_near(with_it.log_density, start.point, start.factor)
    # controllers answer an effect: rows have late pulses in one of the flights alone
    return with_it, highest_mode(with_it.log_density, with_it.model.starts)


def _flown_oscillation(stage: Stage, effect: Effect, hidden: Hidden) -> float:
    """σ of an oscillation on the flight that has it, its line known."""
    _, values = hidden_oscillation(hidden.parameters)
    if stage.scene.condition is not None:
        events = stage.scene.fly((hidden,))
        settled = replace(effect, search_result=hidden_line(stage.scene, events, hidden))
        events = events.with_columns_of([settled])
        path = Growth(settled, values, {})
        return sensitivity(events, _flown_with(events, path, 1.0, stage.base)[1], path, 1.0)
    view = stage.view(hidden)
    settled = replace(effect, search_result=hidden_line(stage.scene, view.events, hidden))
    events = view.events.with_columns_of([settled])
    with_line = replace(view, events=events, none=none_hypothesis(events))
    return modelled_size(with_line, settled, values)
