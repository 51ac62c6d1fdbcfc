"""On-times that the ideal calculation gets wrong, as a case to diagnose.

``none`` is the ideal calculation of :mod:`cassini_bayes.diagnosis.on_times`, a cause is it with one
effect of the catalogue, ``unknown`` adds to every on-time a noise of its own whose size is
log-normal. Evidence is that of :mod:`cassini_bayes.diagnosis.gauss_newton`, checked by importance
sampling where it matters.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.special import logsumexp
from scipy.stats import chi2, norm

from cassini_bayes.computing.arrays import Array
from cassini_bayes.diagnosis.case import (
    NONE,
    TRUSTED_K,
    UNKNOWN,
    Case,
    Log,
    Ranking,
    Size,
    Weighed,
    silent,
)
from cassini_bayes.diagnosis.crew import Crew
from cassini_bayes.diagnosis.gauss_newton import (
    Fit,
    Model,
    evidence_with_noise,
    fit,
    importance_draws,
    linearised,
    normal_log_density,
    predict_left_out,
)
from cassini_bayes.diagnosis.modes import Mode
from cassini_bayes.diagnosis.on_times import (
    OnTimeHypothesis,
    OnTimes,
    hypothesis,
    parameters_at,
)
from cassini_bayes.diagnosis.score import LEAST_PIECES, WITHIN, HeldOut
from cassini_bayes.diagnosis.separation import separating_measurement
from cassini_bayes.diagnosis.sizes import effect_draws, summarised
from cassini_bayes.effects.catalogue import Catalogue
from cassini_bayes.effects.effect import Effect
from cassini_bayes.effects.registry import Kinds

Candidate = Weighed[OnTimeHypothesis]
NEAR_NATS: Final = 10.0  # behind the best, up to which importance draws decide
MOST_NEAR: Final = 6  # of these: judgement, every one takes some seconds
FAR_NATS: Final = 50.0
"""Behind the best, where causes keep their evidence at other widths: a prior half or twice as wide
changes it by a few nats (docs/results/diagnosis-published.md)."""
DRAWS: Final = 500  # the linearised evidence is off by 0.2 nats (docs/results/published-cases.md)
SIZE_DRAWS: Final = 4_000  # ends of an interval scatter by a thirtieth of a standard deviation
NOISE_GRID: Final = np.linspace(-6.0, 6.0, 801)  # standard normals of the noise of unknown
NOISE_FITS: Final = 3  # mode and noise in turn: the noise settles to a node of the grid (judgement)
BASE: Final = {"tau_fall_s": "tau_rise_s"}  # rectangular pulses: the fall is as the rise


@dataclass(frozen=True)
class OnTimeCase(Case[OnTimeHypothesis]):
    """Printed on-times, and the causes that may make them differ from the calculation."""

    data: OnTimes
    catalogue: Catalogue
    unit = "s"

    @property
    def event_ids(self) -> tuple[str, ...]:
        """All events."""
        return self.data.event_ids

    def weigh(self, rng: np.random.Generator, log: Log, _: Crew) -> list[Candidate]:
        """Evidence by linearisation, by importance draws near the best."""
        effects = self.catalogue.effects
        none = self._fitted(())
        weighed = [none]
        for i, effect in enumerate(effects):
            weighed.append(self._fitted((effect,), none.mode.point))
            if i % 10 == 0:
                log(f"on-times: cause {i + 1} of {len(effects)}")
        unknown = self._unknown(none)
        best = max(w.log_evidence for w in (*weighed, unknown))
        near = [i for i, w in enumerate(weighed) if w.log_evidence > best - NEAR_NATS]
        for i in sorted(near, key=lambda i: -weighed[i].log_evidence)[:MOST_NEAR]:
            weighed[i] = self._sampled(weighed[i], rng)
        return [*weighed, unknown]

    def _fitted(self, effects: tuple[Effect, ...], start: Array | None = None) -> Candidate:
        """A hypothesis fitted from ``start``, the place of another that lacks its last effects."""
        prior = self.catalogue.odds.none
        if effects:
            prior = float(np.prod([effect.prior_probability for effect in effects]))
        with_effects = hypothesis(self.data, effects, prior)
        if start is not None and len(start) < with_effects.model.dimension:
            extra = np.zeros(with_effects.model.dimension - len(start))
            place = len(start) - self.data.thrusters  # individual thrusts stand last
            start = np.concatenate([start[:place], extra, start[place:]])
        return _weighed(with_effects, fit(self.data.printed_s, with_effects.model, start))

    def _sampled(self, weighed: Candidate, rng: np.random.Generator) -> Candidate:
        """With evidence and draws by importance sampling, where these can be relied upon."""
        y, model = self.data.printed_s, weighed.hypothesis.model
        fitted = linearised(y, model, weighed.mode.point)
        draws = importance_draws(y, model, fitted, rng, DRAWS)
        if not draws.pareto_k < TRUSTED_K:
            return weighed
        return replace(
            weighed,
            log_evidence=draws.log_evidence,
            log_evidence_se=draws.log_evidence_se,
            z=draws.resample(rng, SIZE_DRAWS),
            log_weights=np.full(SIZE_DRAWS, -np.log(SIZE_DRAWS)),
            pareto_k=draws.pareto_k,
        )

    def _unknown(self, none: Candidate) -> Candidate:
        """The baseline with a noise of its own in every on-time, its size integrated out."""
        prior, y = self.catalogue.unknown.on_time_noise, self.data.printed_s
        sizes = prior.quantile_of_standard(NOISE_GRID)
        weights = norm.logpdf(NOISE_GRID) + np.log(NOISE_GRID[1] - NOISE_GRID[0])
        base, point = none.hypothesis.model, none.mode.point
        size = float(prior.quantile_of_standard(0.0))
        for _ in range(NOISE_FITS):
            fitted = fit(y, noisier(base, size), point)
            plain = replace(fitted, noise=fitted.noise - size**2 * np.eye(y.shape[1]))
            scores = weights + evidence_with_noise(y, plain, sizes)
            size, point = float(sizes[int(np.argmax(scores))]), fitted.mode
        noisy = replace(
            none.hypothesis,
            name=UNKNOWN,
            prior_probability=self.catalogue.odds.unknown,
            model=noisier(base, size),
        )
        return replace(_weighed(noisy, fitted), log_evidence=float(logsumexp(scores)))

    def scores_at(
        self, width: float, verdict: Ranking[OnTimeHypothesis], _: np.random.Generator
    ) -> Mapping[str, float]:
        """Fits anew of causes near the best; what sampling added to their evidence is kept."""
        best = max(cause.log_evidence for cause in verdict.weighed)
        scores = {NONE: verdict.named(NONE).score}
        for effect in self.catalogue.effects:
            cause = verdict.named(effect.name)
            if cause.log_evidence > best - FAR_NATS:
                other = self._fitted((effect.scaled(width),), cause.mode.point)
                cause = replace(cause, log_evidence=_corrected(other, cause))
            scores[effect.name] = cause.score
        return scores | {UNKNOWN: verdict.named(UNKNOWN).score}

    def pairs(
        self, first: Candidate, _: float, __: np.random.Generator, ___: Crew
    ) -> list[Candidate]:
        """By linearisation."""
        (effect,) = first.hypothesis.effects
        others = [other for other in self.catalogue.effects if other.name != effect.name]
        fitted = [self._fitted((effect, other), first.mode.point) for other in others]
        return [replace(other, log_evidence=_corrected(other, first)) for other in fitted]

    def confirmed(self, pair: Candidate, rng: np.random.Generator) -> Candidate:
        """With importance draws."""
        return self._sampled(pair, rng)

    @property
    def kinds(self) -> Kinds:
        """Those of its catalogue."""
        return self.catalogue.kinds

    def sizes(self, weighed: Candidate, rng: np.random.Generator) -> Mapping[str, Size]:
        """From importance draws, or those of the linear form."""
        return summarised(*self.size_draws(weighed, rng))

    def size_draws(
        self, weighed: Candidate, rng: np.random.Generator
    ) -> tuple[dict[str, Array], Array]:
        """Draws (n,) of the effects' parameters by key, and their weights (n,).

        A departure is given as the parameter's value.
        """
        z, weights = effect_draws(weighed, rng, SIZE_DRAWS)
        parameters = parameters_at(weighed.hypothesis.space, z)
        values: dict[str, Array] = {}
        for effect in weighed.hypothesis.effects:
            for p in effect.parameters:
                values[p.key] = parameters[p.name]
                if p.is_departure:
                    values[p.key] = values[p.key] + parameters.get(BASE.get(p.key, p.key), 0.0)
        return values, weights

    def held_out(
        self, weighed: Candidate, _: np.random.Generator, log: Log = silent
    ) -> HeldOut | None:
        """Every event predicted from the others."""
        y, model = self.data.printed_s, weighed.hypothesis.model
        if len(y) < LEAST_PIECES:
            return None
        scores, residuals, sds = [], [], []
        for event, name in enumerate(self.event_ids):
            log(f"{weighed.name}: {name} held out")
            mean, covariance = predict_left_out(y, model, event, weighed.mode.point)
            scores.append(normal_log_density(y[event], mean, covariance)[0])
            residuals.append(y[event] - mean)
            sds.append(np.sqrt(np.diagonal(covariance)))
        residual, half_width = np.array(residuals), WITHIN * np.array(sds)
        inside = float((np.abs(residual) <= half_width).mean())
        rmse = float(np.sqrt((residual**2).mean()))
        return HeldOut(np.array(scores), rmse, inside, residual, half_width)

    def rmse(self, weighed: Candidate) -> float:
        """Of printed less predicted on-times at the mode, s."""
        mean = weighed.hypothesis.model.forward(weighed.mode.point[None])[0]
        return float(np.sqrt(((self.data.printed_s - mean) ** 2).mean()))

    def p_value(self, weighed: Candidate, _: np.random.Generator) -> float:
        """Of χ² under the linearised prior prediction."""
        y = self.data.printed_s
        fitted = linearised(y, weighed.hypothesis.model, weighed.mode.point)
        return float(chi2.sf(fitted.chi_square, y.size))

    def separation(self, one: str, other: str) -> str:
        """What the kinds say, or events that fire other thrusters."""
        return separating_measurement(self.catalogue.kinds, self.data.priors, one, other)


def _weighed(hypothesis: OnTimeHypothesis, fitted: Fit) -> Candidate:
    factor = np.asarray(np.linalg.cholesky(fitted.covariance), dtype=np.float64)
    return Weighed(hypothesis, Mode(fitted.mode, factor, fitted.log_evidence), fitted.log_evidence)


def _corrected(candidate: Candidate, sampled: Candidate) -> float:
    """Log evidence by linearisation, with what importance sampling added to that of another."""
    return candidate.log_evidence + sampled.log_evidence - sampled.mode.log_evidence


def noisier(model: Model, size_s: float) -> Model:
    """A model with independent noise of a size, s, on every on-time."""

    def noise(z: Array) -> Array:
        covariance = model.noise(z)
        return np.asarray(covariance + size_s**2 * np.eye(covariance.shape[-1]))

    return Model(model.forward, noise, model.dimension)
