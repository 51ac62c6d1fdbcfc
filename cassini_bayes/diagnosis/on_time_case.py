"""On-times that the ideal calculation gets wrong, as a case to diagnose.

``none`` is the ideal calculation of :mod:`cassini_bayes.diagnosis.on_times`, a cause is it with one
effect of the catalogue, ``unknown`` adds to every on-time a noise of its own whose size is
log-normal. Evidence is that of :mod:`cassini_bayes.diagnosis.gauss_newton`, checked by importance
sampling where it matters.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Final

import numpy as np
from scipy.special import logsumexp
from scipy.stats import chi2, norm

from cassini_bayes.balance.part_columns import PartColumns
from cassini_bayes.computing.arrays import Array
from cassini_bayes.computing.log import Log, silent
from cassini_bayes.diagnosis.case import (
    NONE,
    UNKNOWN,
    Case,
    Fits,
    Ranking,
    Size,
    Weighed,
    over_beginnings,
)
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
from cassini_bayes.diagnosis.onsets import (
    Beginnings,
    information_from_each,
    sizes_tried,
    without_event,
)
from cassini_bayes.diagnosis.score import LEAST_PIECES, WITHIN, HeldOut
from cassini_bayes.diagnosis.separation import separating_measurement
from cassini_bayes.diagnosis.sizes import effect_draws, mixed, summarised
from cassini_bayes.diagnosis.stages import StageRunner
from cassini_bayes.effects.catalogue import Catalogue
from cassini_bayes.effects.effect import Effect, onsets
from cassini_bayes.effects.registry import Kinds
from cassini_bayes.sampling.warmstart import TRUSTED_K

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

    def weigh(self, rng: np.random.Generator, log: Log, _: StageRunner) -> list[Candidate]:
        """Evidence by linearisation, by importance draws near the best."""
        effects = self.catalogue.effects
        none = self._fitted(())
        weighed = [none]
        beginnings = self._beginnings(none, effects)
        for i, effect in enumerate(likely := beginnings.likely()):
            weighed.append(self._fitted((effect,), none.mode.point))
            if i % 10 == 0:
                log(f"on-times: cause {i + 1} of {len(likely)}")
        gained = max(w.log_evidence for w in weighed) - none.log_evidence
        missed = beginnings.missed(gained)
        weighed += [self._fitted((effect,), none.mode.point) for effect in missed]
        unknown = self._unknown(none)
        best = max(w.log_evidence for w in (*weighed, unknown))
        near = [i for i, w in enumerate(weighed) if w.log_evidence > best - NEAR_NATS]
        for i in sorted(near, key=lambda i: -weighed[i].log_evidence)[:MOST_NEAR]:
            weighed[i] = self._sampled(weighed[i], rng)
        return [*beginnings.summed(weighed, weighed[0].net_evidence), unknown]

    def _beginnings(self, none: Candidate, effects: Sequence[Effect]) -> Beginnings:
        """Events that causes may begin with, and what they gain linearised about the baseline."""
        data, z = self.data, none.mode.point

        def information(choose: Sequence[Effect]) -> list[tuple[Array, Array]]:
            fitted = linearised(data.printed_s, none.hypothesis.model, z)
            place = len(z) - data.thrusters
            added = []
            for effect in choose:
                tried = sizes_tried(effect)
                same = np.tile(z, (len(tried), 1))
                points = np.concatenate([same[:, :place], tried, same[:, place:]], axis=1)
                added.append(hypothesis(data, (effect,)).model.forward(points) - fitted.mean)
            everything = np.concatenate(added)  # (S, E, U)
            in_time = [data.event_ids.index(name) for name in data.order]
            white = {i: np.linalg.inv(np.linalg.cholesky(fitted.noise[i])) for i in in_time}
            return information_from_each(
                [PartColumns.of(white[i] @ fitted.slope[i]) for i in in_time],
                [white[i] @ (data.printed_s[i] - fitted.mean[i]) for i in in_time],
                [white[i] @ everything[:, i].T for i in in_time],
                np.ones(len(z)),
                -z,
            )

        return Beginnings.of_information(effects, data.order, self.catalogue.odds, information)

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

        def change(cause: Candidate, _: float) -> float:
            effects = tuple(effect.scaled(width) for effect in cause.hypothesis.effects)
            other = self._fitted(effects, cause.mode.point)
            return other.log_evidence - cause.mode.log_evidence

        best = max(cause.log_evidence for cause in verdict.weighed)
        scores = {NONE: verdict.named(NONE).score}
        for effect in self.catalogue.effects:
            cause = verdict.named(effect.name)
            scores[effect.name] = cause.score
            if cause.log_evidence > best - FAR_NATS:
                scores[effect.name] += over_beginnings(cause, change)
        return scores | {UNKNOWN: verdict.named(UNKNOWN).score}

    def pairs(
        self, first: Candidate, _: float, __: np.random.Generator, ___: StageRunner
    ) -> list[Candidate]:
        """By linearisation."""
        (effect,) = first.hypothesis.effects
        prior = self.catalogue.effect(effect.name).prior_probability
        effect = replace(effect, prior_probability=prior)
        others = [other for other in self.catalogue.effects if other.name != effect.name]
        fitted = [self._fitted((effect, other), first.mode.point) for other in others]
        return [
            replace(other, log_evidence=_corrected(other, first), summed=first.summed)
            for other in fitted
        ]

    def confirmed(self, pair: Candidate, rng: np.random.Generator) -> Candidate:
        """With importance draws."""
        return self._sampled(pair, rng)

    @property
    def kinds(self) -> Kinds:
        """Those of its catalogue."""
        return self.catalogue.kinds

    def sizes(self, weighed: Candidate, rng: np.random.Generator) -> Mapping[str, Size]:
        """From importance draws, or those of the linear form."""
        return summarised(*mixed(partial(self.size_draws, rng=rng), weighed))

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
                    base = BASE.get(p.baseline, p.baseline)
                    values[p.key] = values[p.key] + parameters.get(base, 0.0)
        return values, weights

    def held_out(
        self,
        weighed: Candidate,
        _: np.random.Generator,
        log: Log = silent,
        fits: Sequence[Fits] | None = None,
    ) -> HeldOut | None:
        """Every event predicted from the others."""
        del fits
        y = self.data.printed_s
        if len(y) < LEAST_PIECES:
            return None
        scores, residuals, sds = [], [], []
        for event, name in enumerate(self.event_ids):
            log(f"{weighed.name}: {name} held out")
            ways = [
                (np.log(share), *predict_left_out(y, way.hypothesis.model, event, way.mode.point))
                for share, way in self._ways(weighed, name)
            ]
            known = np.array([share + evidence for share, _, _, evidence in ways])
            known -= logsumexp(known)
            own_scores = [normal_log_density(y[event], mean, cov)[0] for _, mean, cov, _ in ways]
            scores.append(float(logsumexp(known + own_scores)))
            means = np.array([mean for _, mean, _, _ in ways])
            variances = np.array([np.diagonal(cov) for _, _, cov, _ in ways])
            mean = np.exp(known) @ means
            residuals.append(y[event] - mean)
            sds.append(np.sqrt(np.exp(known) @ (variances + (means - mean) ** 2)))
        residual, half_width = np.array(residuals), WITHIN * np.array(sds)
        inside = float((np.abs(residual) <= half_width).mean())
        rmse = float(np.sqrt((residual**2).mean()))
        return HeldOut(np.array(scores), rmse, inside, residual, half_width)

    def _ways(self, weighed: Candidate, event: str) -> list[tuple[float, Candidate]]:
        """Every way in which a hypothesis may begin by all events but one, with its prior share."""
        if not weighed.beginnings:
            return [(1.0, weighed)]
        order = self.data.order
        shares, each = self.catalogue.odds.of_onsets(len(order)), (None, *onsets(order))
        result = []
        for first, own in without_event(weighed, order, event):
            effects = tuple(replace(e, onset=each[first]) for e in own.hypothesis.effects)
            moved = hypothesis(self.data, effects, own.hypothesis.prior_probability)
            result.append((shares[first], replace(own, hypothesis=moved)))
        return result

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
        """The advice of the kinds, or events that fire other thrusters."""
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
