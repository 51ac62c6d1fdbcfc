"""Published thrust estimates as a case to diagnose: no telemetry, pulse statistics alone.

The evidence of a hypothesis is the mean of prior times likelihood over proposal q(z), half the
draws of which are the prior's and half a Student-t's about the mode. The prior's alone miss a
posterior that lies many prior standard deviations out; the t's alone would miss another mode. With
both no weight exceeds twice its likelihood.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Final

import numpy as np
from scipy.special import logsumexp

from cassini_bayes.computing.arrays import Array, Flags
from cassini_bayes.computing.log import Log, silent
from cassini_bayes.diagnosis.case import Case, Fits, Ranking, Size, Weighed
from cassini_bayes.diagnosis.estimates import EstimateHypothesis, Estimates, Prediction
from cassini_bayes.diagnosis.modes import Mode, find_mode
from cassini_bayes.diagnosis.score import LEAST_PIECES, HeldOut
from cassini_bayes.diagnosis.separation import OTHERWISE, separating_measurement
from cassini_bayes.diagnosis.sizes import summarised
from cassini_bayes.diagnosis.stages import SERIAL, StageRunner
from cassini_bayes.effects.registry import Kinds, standard
from cassini_bayes.priors.reader import Priors
from cassini_bayes.sampling.warmstart import TRUSTED_K, Proposal, importance, pareto_k, refined

Candidate = Weighed[EstimateHypothesis]
DRAWS: Final = 100_000
"""Evidence good to 0.02 nats or better (docs/results/diagnosis-published.csv)."""
LEFT_OUT_DRAWS: Final = 300_000  # the error of log Z(all) is in every event's score
DOF: Final = 5.0  # of the Student-t about the mode: judgement, wide tails where half the draws are
WIDER: Final = 2.0  # than the posterior itself: ridges bend, and k̂ then stays below 0.2
BATCH: Final = 4_000  # draws (n, d) and predictions (n, E) that stay in a processor's cache
PILOTS: Final = 2  # refinements of the proposal by its own draws
PILOT_DRAWS: Final = 4_000  # of each: some hundred for every dimension
FEWEST_DRAWS: Final = 400.0  # effective, for means good to a twentieth of a standard deviation


@dataclass(frozen=True)
class EstimateCase(Case[EstimateHypothesis]):
    """Printed thrusts (E,) by name, with their own errors, N, and the hypotheses on them.

    ``hypotheses`` are ``none``, ``unknown`` and causes at a width of the effects' priors, ``pairs``
    those of a first cause with every other by its name. All are weighed with draws of their own, in
    order.
    """

    names: tuple[str, ...]
    estimate_n: Array
    sd_n: Array
    hypotheses: Callable[[float], list[EstimateHypothesis]] = field(repr=False)
    beside: Callable[[str], list[EstimateHypothesis]] = field(repr=False, default=lambda _: [])
    advice: Callable[[str, str], str] = field(repr=False, default=lambda _, __: "")
    known: Kinds = field(repr=False, default_factory=standard)

    unit = "n"

    @property
    def event_ids(self) -> tuple[str, ...]:
        """Names of the estimates."""
        return self.names

    def weigh(self, rng: np.random.Generator, log: Log, _: StageRunner = SERIAL) -> list[Candidate]:
        """Evidence by draws from prior and posterior together."""
        weighed = self.weighed(self.hypotheses(1.0), rng)
        log(f"{len(weighed)} hypotheses weighed")
        _warn_of(weighed)
        return weighed

    def weighed(
        self,
        hypotheses: Sequence[EstimateHypothesis],
        rng: np.random.Generator,
        draws: int = DRAWS,
    ) -> list[Candidate]:
        """Some hypotheses with their evidence, in order.

        Raises
        ------
        CassiniBayesError
            A hypothesis whose likelihood is not finite at the centre of its prior.
        """
        return [self._one(hypothesis, rng, draws) for hypothesis in hypotheses]

    def _one(
        self, hypothesis: EstimateHypothesis, rng: np.random.Generator, draws: int
    ) -> Candidate:
        kept = np.ones(len(self.estimate_n), dtype=bool)
        mode, z, log_ratio = self._draws(hypothesis, kept, rng, draws)
        total = float(logsumexp(log_ratio))
        log_weights = log_ratio - total
        effective = 1.0 / float((np.exp(log_weights) ** 2).sum())
        return Weighed(
            hypothesis,
            mode,
            total - float(np.log(draws)),
            float(np.sqrt(max(1.0 / effective - 1.0 / draws, 0.0))),
            z,
            log_weights,
            pareto_k(log_ratio),
        )

    def _draws(
        self,
        hypothesis: EstimateHypothesis,
        kept: Flags,
        rng: np.random.Generator,
        draws: int,
    ) -> tuple[Mode, Array, Array]:
        """Mode by the estimates kept, draws (n, d) and their log posterior over proposal (n,)."""
        estimate, sd = self.estimate_n[kept], self.sd_n[kept]

        def posterior(z: Array) -> Array:
            return _log_prior(z) + _log_likelihood(estimate, sd, hypothesis.predict(z), kept)

        def density(z: Array) -> Array:
            return np.concatenate([posterior(z[at : at + BATCH]) for at in range(0, len(z), BATCH)])

        mode = find_mode(density, hypothesis.dimension)
        about = Proposal(mode.point, mode.factor, DOF)
        for _ in range(PILOTS):
            about = refined(about, importance(density, about, rng, PILOT_DRAWS))
        about = replace(about, factor=WIDER * about.factor)
        near = about.sample(rng, draws // 2)
        z = np.vstack([near, rng.standard_normal((draws - len(near), hypothesis.dimension))])
        share = len(near) / draws
        both = np.logaddexp(np.log(share) + about.log_density(z), np.log1p(-share) + _log_prior(z))
        return mode, z, density(z) - both

    def scores_at(
        self, width: float, _: Ranking[EstimateHypothesis], rng: np.random.Generator
    ) -> Mapping[str, float]:
        """All hypotheses weighed anew."""
        weighed = self.weighed(self.hypotheses(width), rng)
        _warn_of(weighed)
        return {w.name: w.score for w in weighed}

    def pairs(
        self, first: Candidate, _: float, rng: np.random.Generator, __: StageRunner
    ) -> list[Candidate]:
        """Weighed as all others are."""
        return self.weighed(self.beside(first.name), rng)

    @property
    def kinds(self) -> Kinds:
        """Those that the hypotheses were made of."""
        return self.known

    def sizes(self, weighed: Candidate, rng: np.random.Generator) -> Mapping[str, Size]:
        """Of all parameters that are not fixed."""
        posterior = summarised(*self.size_draws(weighed, rng))
        return {key: size for key, size in posterior.items() if size.sd > 0.0}

    def size_draws(
        self, weighed: Candidate, _: np.random.Generator
    ) -> tuple[dict[str, Array], Array]:
        """Of all parameters."""
        assert weighed.z is not None
        assert weighed.log_weights is not None
        values = weighed.hypothesis.predict(weighed.z).parameters
        return dict(values), np.exp(weighed.log_weights)

    def residual_n(self, weighed: Candidate) -> Array:
        """Estimates less the posterior mean prediction (E,)."""
        assert weighed.z is not None
        assert weighed.log_weights is not None
        predicted = weighed.hypothesis.predict(weighed.z).estimate_n
        return np.asarray(self.estimate_n - np.exp(weighed.log_weights) @ predicted)

    def held_out(
        self,
        weighed: Candidate,
        rng: np.random.Generator,
        log: Log = silent,
        fits: Sequence[Fits] | None = None,
    ) -> HeldOut | None:
        """Every estimate left out in turn: log Z(all) − log Z(others), and what it misses by."""
        del fits
        hypothesis = weighed.hypothesis
        if len(self.estimate_n) < LEAST_PIECES:
            return None
        whole = self._one(hypothesis, rng, LEFT_OUT_DRAWS).log_evidence
        scores, residuals = [], []
        for place, name in enumerate(self.event_ids):
            log(f"{weighed.name}: {name} held out")
            kept = np.arange(len(self.estimate_n)) != place
            _, z, log_ratio = self._draws(hypothesis, kept, rng, LEFT_OUT_DRAWS)
            total = float(logsumexp(log_ratio))
            scores.append(whole - total + float(np.log(LEFT_OUT_DRAWS)))
            predicted = hypothesis.predict(z).estimate_n[:, place]
            residuals.append(self.estimate_n[place] - np.exp(log_ratio - total) @ predicted)
        residual = np.array(residuals)
        return HeldOut(np.array(scores), float(np.sqrt((residual**2).mean())), None, residual)

    def rmse(self, weighed: Candidate) -> float:
        """Of estimates less posterior mean prediction, N."""
        return float(np.sqrt((self.residual_n(weighed) ** 2).mean()))

    def separation(self, one: str, other: str) -> str:
        """What is known of these estimates."""
        return self.advice(one, other)


def estimate_case(
    estimates: Estimates, priors: Priors | None = None, kinds: Kinds | None = None
) -> EstimateCase:
    """Estimates with all that may be wrong with them, by the kinds of effect that there are.

    ``priors`` name the spacecraft, and with it the thrusters that only fire together.
    """
    known = standard() if kinds is None else kinds

    def advice(one: str, other: str) -> str:
        if priors is None:
            return OTHERWISE
        return separating_measurement(known, priors, one, other)

    return EstimateCase(
        tuple(row.id for row in estimates.rows),
        estimates.thrust_estimates_n,
        estimates.sd_n,
        partial(estimates.hypotheses, known),
        partial(estimates.pairs, known),
        advice,
        known,
    )


def untrusted(weighed: Sequence[Candidate]) -> str:
    """Sentence that names the hypotheses whose draws do not cover their posterior; may be empty."""
    named = [
        f"{w.name} ({w.effective_draws:.0f} effective draws, Pareto k̂ {w.pareto_k:.2f})"
        for w in weighed
        if w.effective_draws < FEWEST_DRAWS or w.pareto_k > TRUSTED_K
    ]
    return f"Evidence not to be relied upon: {', '.join(named)}." if named else ""


def _warn_of(weighed: Sequence[Candidate]) -> None:
    doubt = untrusted(weighed)
    if doubt:
        warnings.warn(doubt, RuntimeWarning, stacklevel=3)


def _log_prior(z: Array) -> Array:
    return np.asarray(-0.5 * (z**2).sum(-1) - 0.5 * z.shape[1] * np.log(2.0 * np.pi))


def _log_likelihood(estimate_n: Array, sd_n: Array, prediction: Prediction, kept: Flags) -> Array:
    variance = sd_n**2 + prediction.independent_sd_n[:, kept] ** 2
    misfit = (estimate_n - prediction.estimate_n[:, kept]) ** 2 / variance
    return np.asarray(-0.5 * (misfit + np.log(2.0 * np.pi * variance)).sum(-1))
