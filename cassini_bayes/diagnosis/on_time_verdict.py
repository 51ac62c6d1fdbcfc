"""What the ideal on-time calculation gets wrong: causes weighed, paired, and measured.

``none`` is the ideal calculation of :mod:`cassini_bayes.diagnosis.on_times`, a cause is it with one
effect of the catalogue, ``unknown`` adds to every on-time a noise of its own whose size is
log-normal. Evidence is that of :mod:`cassini_bayes.diagnosis.gauss_newton`, checked by importance
sampling where it matters.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp
from scipy.stats import chi2, norm

from cassini_bayes.diagnosis.gauss_newton import (
    Fit,
    Model,
    evidence_with_noise,
    fit,
    importance_draws,
    normal_log_density,
    predict_left_out,
)
from cassini_bayes.diagnosis.naming import CONFOUNDED_NATS
from cassini_bayes.diagnosis.on_times import (
    Hypothesis,
    OnTimeCase,
    hypothesis,
    parameters_at,
)
from cassini_bayes.diagnosis.score import summed
from cassini_bayes.effects.catalogue import Catalogue, Effect
from cassini_bayes.errors import InputError
from cassini_bayes.priors.distributions import Distribution

Array = NDArray[np.float64]
Say = Callable[[str], None]

WIDTHS: Final = (0.5, 1.0, 2.0)
NEAR_NATS: Final = 10.0
MOST_NEAR: Final = 6
FAR_NATS: Final = 50.0  # causes so far behind keep their evidence at other widths
SECOND_NATS: Final = 4.0
DRAWS: Final = 500
BAD_TAIL: Final = 0.7
SIZE_DRAWS: Final = 4000
COVERAGE: Final = 0.9
NOISE_GRID: Final = np.linspace(-6.0, 6.0, 801)
NOISE_LOOKS: Final = 3
BASE: Final = {"tau_fall_s": "tau_rise_s"}  # rectangular pulses: the fall is as the rise


@dataclass(frozen=True)
class Weighed:
    """One hypothesis: its fit, log evidence with Monte Carlo error (NaN: by linearisation)."""

    name: str
    own: Hypothesis
    fit: Fit
    log_evidence: float
    log_evidence_se: float = float("nan")
    draws: Array | None = None  # (n, d) of the posterior


@dataclass(frozen=True)
class HeldOut:
    """Each event predicted from the others: log scores (E,), residuals and sd (E, U) s."""

    log_score: Array
    residual_s: Array
    sd_s: Array

    @property
    def half_width_s(self) -> Array:
        """Half widths (E, U) of central 90 % prediction intervals."""
        return np.asarray(norm.ppf(0.5 + COVERAGE / 2) * self.sd_s)

    @property
    def coverage(self) -> float:
        """Share of the on-times within those intervals."""
        return float((np.abs(self.residual_s) <= self.half_width_s).mean())

    @property
    def rmse_s(self) -> float:
        """Root mean square of the residuals."""
        return float(np.sqrt((self.residual_s**2).mean()))


@dataclass(frozen=True)
class OnTimeVerdict:
    """Causes of a discrepancy of on-times.

    ``weighed`` by name at default width; ``probability`` by width and name. ``second`` is the best
    pair with the first cause (None where the first is no cause of the catalogue), ``second_alike``
    the causes whose pairs are within 3 nats of it, ``pair_nats`` what each gains beside the first
    (log evidence by linearisation). ``p_value`` is that of the baseline's χ² under
    its linearised prior prediction.
    """

    case: OnTimeCase
    weighed: Mapping[str, Weighed]
    probability: Mapping[float, Mapping[str, float]]
    second: Weighed | None
    second_alike: tuple[str, ...]
    pair_nats: Mapping[str, float]
    p_value: float

    @property
    def first(self) -> str:
        """The most probable hypothesis at default width."""
        return max(self.probability[1.0], key=lambda name: self.probability[1.0][name])

    @property
    def second_nats(self) -> float:
        """Log evidence that the second cause gains; NaN without one."""
        return max(self.pair_nats.values(), default=float("nan"))

    def log_bayes_factor(self, name: str) -> float:
        """Log evidence against ``none``, nats."""
        return self.weighed[name].log_evidence - self.weighed["none"].log_evidence

    def confounded_with(self, name: str) -> tuple[str, ...]:
        """Other causes of the catalogue whose evidence is within 3 nats of a cause's."""
        own = self.weighed[name].log_evidence
        return tuple(
            other
            for other, found in self.weighed.items()
            if other not in (name, "none", "unknown")
            and abs(found.log_evidence - own) <= CONFOUNDED_NATS
        )


def weigh_on_times(
    case: OnTimeCase, catalogue: Catalogue, rng: np.random.Generator, say: Say | None = None
) -> OnTimeVerdict:
    """Evidence and probability of every cause, at half and double width too, and the best pair.

    Raises
    ------
    InputError
        The catalogue does not say how large the noise of ``unknown`` is.
    """
    middle = _weigh(case, catalogue, rng, say)
    probability = {1.0: _probabilities(catalogue, middle)}
    best = max(found.log_evidence for found in middle.values())
    for width in WIDTHS:
        if width != 1.0:
            near = {
                effect.name: _one(case, (effect.scaled(width),), middle[effect.name].fit.mode)
                for effect in catalogue.effects
                if middle[effect.name].log_evidence > best - FAR_NATS
            }
            probability[width] = _probabilities(catalogue, {**middle, **_corrected(near, middle)})
    none = middle["none"].fit
    first = max(probability[1.0], key=lambda name: probability[1.0][name])
    pairs = _pairs(case, catalogue, middle, first, say)
    second = max(pairs, key=lambda w: w.log_evidence, default=None)
    alike = (
        ()
        if second is None
        else tuple(
            w.own.effects[1].name
            for w in pairs
            if w is not second and w.log_evidence > second.log_evidence - CONFOUNDED_NATS
        )
    )
    return OnTimeVerdict(
        case,
        middle,
        dict(sorted(probability.items())),
        second,
        alike,
        {w.own.effects[1].name: w.fit.log_evidence - middle[first].fit.log_evidence for w in pairs},
        float(chi2.sf(none.chi_square, case.seen_s.size)),
    )


def _weigh(
    case: OnTimeCase, catalogue: Catalogue, rng: np.random.Generator, say: Say | None
) -> dict[str, Weighed]:
    none = _one(case, ())
    found = {"none": none}
    for i, effect in enumerate(catalogue.effects):
        found[effect.name] = _one(case, (effect,), none.fit.mode)
        if say is not None and i % 10 == 0:
            say(f"on-times: cause {i + 1} of {len(catalogue.effects)}")
    found["unknown"] = _unknown(case, none, catalogue.unknown.on_time_noise_s)
    best = max(w.log_evidence for w in found.values())
    near = [w for w in found.values() if w.log_evidence > best - NEAR_NATS and w.name != "unknown"]
    for w in sorted(near, key=lambda w: -w.log_evidence)[:MOST_NEAR]:
        draws = importance_draws(case.seen_s, w.own.model, w.fit, rng, DRAWS)
        if draws.pareto_k < BAD_TAIL:
            found[w.name] = replace(
                w,
                log_evidence=draws.log_evidence,
                log_evidence_se=draws.log_evidence_se,
                draws=draws.resample(rng, SIZE_DRAWS),
            )
    return found


def _one(case: OnTimeCase, effects: tuple[Effect, ...], start: Array | None = None) -> Weighed:
    """A hypothesis fitted from ``start``, the place of another that lacks its last effects."""
    own = hypothesis(case, effects)
    if start is not None and len(start) < own.model.dimension:
        extra = np.zeros(own.model.dimension - len(start))
        place = len(start) - case.thrusters  # individual thrusts stand last
        start = np.concatenate([start[:place], extra, start[place:]])
    found = fit(case.seen_s, own.model, start)
    name = " + ".join(effect.name for effect in effects) or "none"
    return Weighed(name, own, found, found.log_evidence)


def _unknown(case: OnTimeCase, none: Weighed, prior: Distribution | None) -> Weighed:
    """The baseline with a noise of its own in every on-time, its size integrated out."""
    if prior is None:
        raise InputError(
            "effects: unknown.on_time_noise_median_s",
            "the size of an unknown departure of on-times, s",
            "nothing",
            "add it and on_time_noise_log_sd",
        )
    sizes = prior.quantile_of_standard(NOISE_GRID)
    weights = norm.logpdf(NOISE_GRID) + np.log(NOISE_GRID[1] - NOISE_GRID[0])
    base, found = none.own.model, none.fit
    size = float(prior.quantile_of_standard(0.0))
    scores = np.zeros(len(sizes))
    for _ in range(NOISE_LOOKS):
        found = fit(case.seen_s, noisier(base, size), found.mode)
        plain = replace(found, noise=found.noise - size**2 * np.eye(case.seen_s.shape[1]))
        scores = weights + evidence_with_noise(case.seen_s, plain, sizes)
        size = float(sizes[int(np.argmax(scores))])
    return Weighed(
        "unknown", replace(none.own, model=noisier(base, size)), found, float(logsumexp(scores))
    )


def noisier(model: Model, size_s: float) -> Model:
    """A model with independent noise of a size, s, on every on-time."""

    def noise(z: Array) -> Array:
        own = model.noise(z)
        return np.asarray(own + size_s**2 * np.eye(own.shape[-1]))

    return Model(model.forward, noise, model.dimension)


def _corrected(own: Mapping[str, Weighed], middle: Mapping[str, Weighed]) -> dict[str, Weighed]:
    """Evidence by linearisation, with what importance sampling added to it at default width."""
    return {
        name: replace(
            w,
            log_evidence=w.log_evidence + middle[name].log_evidence - middle[name].fit.log_evidence,
        )
        for name, w in own.items()
    }


def _probabilities(catalogue: Catalogue, found: Mapping[str, Weighed]) -> dict[str, float]:
    prior = {"none": catalogue.none_probability, "unknown": catalogue.unknown_probability}
    prior |= {effect.name: effect.prior_probability for effect in catalogue.effects}
    scores = {name: w.log_evidence + float(np.log(prior[name])) for name, w in found.items()}
    total = float(logsumexp(list(scores.values())))
    return {name: float(np.exp(score - total)) for name, score in scores.items()}


def _pairs(
    case: OnTimeCase,
    catalogue: Catalogue,
    found: Mapping[str, Weighed],
    first: str,
    say: Say | None,
) -> list[Weighed]:
    """The first cause together with every other; empty where no cause is first."""
    if first in ("none", "unknown"):
        return []
    if say is not None:
        say(f"on-times: a second cause beside {first}")
    start = found[first].fit.mode
    own = catalogue.effect(first)
    return [
        _one(case, (own, effect), start) for effect in catalogue.effects if effect.name != first
    ]


def sizes(found: Weighed, rng: np.random.Generator) -> dict[str, Array]:
    """Posterior mean, sd and ends of the central 90 % interval (4,) of the effects' parameters.

    A departure is reported as the parameter's value.
    """
    z = found.draws
    if z is None:
        root = np.linalg.cholesky(found.fit.covariance)
        z = found.fit.mode + rng.standard_normal((SIZE_DRAWS, len(found.fit.mode))) @ root.T
    values = parameters_at(found.own, z)
    result = {}
    for parameter in (p for effect in found.own.effects for p in effect.parameters):
        own = values[parameter.name]
        if parameter.is_departure:
            own = own + values.get(BASE.get(parameter.key, parameter.key), 0.0)
        low, high = np.quantile(own, [0.5 - COVERAGE / 2, 0.5 + COVERAGE / 2])
        result[parameter.key] = np.array([own.mean(), own.std(), low, high])
    return result


def held_out(case: OnTimeCase, found: Weighed) -> HeldOut:
    """Every event predicted from the others by a hypothesis."""
    y = case.seen_s
    scores, residuals, sds = [], [], []
    for event in range(len(y)):
        mean, covariance = predict_left_out(y, found.own.model, event, found.fit.mode)
        scores.append(normal_log_density(y[event], mean, covariance)[0])
        residuals.append(y[event] - mean)
        sds.append(np.sqrt(np.diagonal(covariance)))
    return HeldOut(np.array(scores), np.array(residuals), np.array(sds))


def score_difference(before: HeldOut, after: HeldOut) -> tuple[float, float]:
    """Gain of the summed log scores and its standard error over events, nats."""
    return summed(after.log_score - before.log_score)
