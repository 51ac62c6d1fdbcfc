"""Diagnosis of published summary estimates: thrusts with their pulse statistics, no telemetry.

What was estimated is y = F R(τ_f) k (1 + ε): F the thrust, R the ratio of delivered to commanded
impulse of the pulses that were fired (1 where the estimate was corrected already), k the error of
geometry and inertia that all estimates share. Every hypothesis is a prior on these, written as a
function of standard normals z.

The evidence is the mean of prior times likelihood over proposal q(z), half the draws of which are
the prior's and half a Student-t's about the mode. The prior's alone miss a posterior that lies many
prior standard deviations out; the t's alone would miss another mode. With both no weight exceeds
twice its likelihood.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp, ndtr, ndtri

from cassini_bayes.diagnosis.modes import baseline_mode
from cassini_bayes.sampling.warmstart import Proposal, importance, pareto_k, refined
from cassini_bayes.spacecraft.pulses import PulseShape

Array = NDArray[np.float64]
Predict = Callable[[Array], "Prediction"]
DRAWS: Final = 100_000
LEFT_OUT_DRAWS: Final = 300_000  # the error of log Z(all) is in every event's score
DOF: Final = 5.0
FARTHEST: Final = 37.0  # standard deviations beyond which a probability is zero
WIDER: Final = 2.0  # than the posterior itself: ridges bend, and k̂ then stays below 0.2
PILOTS: Final = 2
PILOT_DRAWS: Final = 4_000
WORST_PARETO_K: Final = 0.7
FEWEST_DRAWS: Final = 400.0


@dataclass(frozen=True)
class Prediction:
    """What a hypothesis predicts: estimates and the parameters behind them, each (n,).

    ``own_sd_n`` is the spread of every estimate about its prediction that nothing shares.
    """

    estimate_n: Array  # (n, E)
    own_sd_n: Array  # (n, E)
    parameters: Mapping[str, Array]


@dataclass(frozen=True)
class SummaryCause:
    """One hypothesis: name, prior probability, and what it predicts at standard normals (n, d)."""

    name: str
    prior_probability: float
    dimension: int
    predict: Predict


@dataclass(frozen=True)
class SummaryVerdict:
    """Evidence, probability and posterior summaries of one hypothesis."""

    name: str
    log_evidence: float
    log_evidence_se: float
    effective_draws: float
    pareto_k: float  # of the weights; above 0.7 neither evidence nor its error can be relied upon
    probability: float
    parameters: Mapping[str, tuple[float, float]]  # posterior mean and standard deviation
    residual_n: Array  # estimates less posterior mean prediction

    @property
    def trusted(self) -> bool:
        """Whether the draws cover the posterior: 400 effective draws, Pareto k̂ up to 0.7."""
        return self.effective_draws >= FEWEST_DRAWS and self.pareto_k <= WORST_PARETO_K


def positive_normal(z: Array, mean: float, sd: float) -> Array:
    """N(mean, sd²) cut off at zero (mean ≥ 0), as a rising function of a standard normal z.

    Rising, so that a posterior has one mode where the absolute value of a normal would have two.
    """
    if sd == 0.0:
        return np.full_like(z, mean)
    kept, cut = float(ndtr(mean / sd)), float(ndtr(-mean / sd))
    inside = np.clip(z, -FARTHEST, FARTHEST)
    above, below = kept * ndtr(-inside), cut + kept * ndtr(inside)
    # each tail by its own small probability: the other's would be one less that
    white = np.where(above < 0.5, -ndtri(above), ndtri(below))
    return np.asarray(mean + sd * white)


def pulse_ratio(
    shape: PulseShape, widths_s: Array, counts: Array, rise_s: float, fall_s: Array
) -> Array:
    """Delivered over commanded impulse R (n,) of a set of pulses at tail-off times (n,)."""
    fall = np.asarray(fall_s, dtype=np.float64)[..., None]
    effective = shape.effective_time(widths_s, 0.005, rise_s, fall)
    return np.asarray((effective * counts).sum(-1) / (widths_s @ counts))


def weigh_summaries(
    estimate_n: Array,
    sd_n: Array,
    causes: Sequence[SummaryCause],
    rng: np.random.Generator,
    draws: int = DRAWS,
) -> list[SummaryVerdict]:
    """Posterior probability of every hypothesis, most probable first.

    Parameters
    ----------
    estimate_n, sd_n
        (E,) published estimates and their independent errors, N.
    causes
        Hypotheses with prior probabilities (normalised here).
    rng, draws
        Of the draws for each hypothesis.

    Raises
    ------
    CassiniBayesError
        A hypothesis whose likelihood is not finite at the centre of its prior.
    """
    found = [_weighed(estimate_n, sd_n, cause, rng, draws) for cause in causes]
    scores = np.array(
        [
            verdict.log_evidence + np.log(cause.prior_probability)
            for verdict, cause in zip(found, causes, strict=True)
        ]
    )
    shares = np.exp(scores - float(logsumexp(scores)))
    verdicts = [
        replace(verdict, probability=float(share))
        for verdict, share in zip(found, shares, strict=True)
    ]
    return sorted(verdicts, key=lambda verdict: -verdict.probability)


@dataclass(frozen=True)
class LeftOut:
    """Every estimate left out in turn: its log score given the others, and what it misses by."""

    log_scores: Array  # (E,) log Z(all) − log Z(others), nats
    residual_n: Array  # (E,) estimate less the others' mean prediction

    @property
    def rmse_n(self) -> float:
        """Root mean square of the residuals."""
        return float(np.sqrt((self.residual_n**2).mean()))


def leave_out(
    estimate_n: Array,
    sd_n: Array,
    cause: SummaryCause,
    rng: np.random.Generator,
    draws: int = LEFT_OUT_DRAWS,
) -> LeftOut:
    """Log score and residual of every estimate under one hypothesis fitted to the others."""
    whole = _weighed(estimate_n, sd_n, cause, rng, draws).log_evidence
    scores, residuals = [], []
    for place in range(len(estimate_n)):
        kept = np.arange(len(estimate_n)) != place
        others = replace(cause, predict=_parts(cause.predict, kept))
        z, log_proposal = _proposed(estimate_n[kept], sd_n[kept], others, rng, draws)
        prediction = cause.predict(z)
        seen = _log_likelihood(estimate_n[kept], sd_n[kept], others.predict(z))
        log_ratio = _log_prior(z) + seen - log_proposal
        total = float(logsumexp(log_ratio))
        scores.append(whole - total + float(np.log(draws)))
        weights = np.exp(log_ratio - total)
        residuals.append(estimate_n[place] - weights @ prediction.estimate_n[:, place])
    return LeftOut(np.array(scores), np.array(residuals))


def _parts(predict: Predict, kept: NDArray[np.bool_]) -> Predict:
    """The prediction of some of the estimates."""

    def part(z: Array) -> Prediction:
        own = predict(z)
        return Prediction(own.estimate_n[:, kept], own.own_sd_n[:, kept], own.parameters)

    return part


def untrusted(verdicts: Sequence[SummaryVerdict]) -> str:
    """Sentence that names the hypotheses whose draws do not cover their posterior; may be empty."""
    named = [
        f"{v.name} ({v.effective_draws:.0f} effective draws, Pareto k̂ {v.pareto_k:.2f})"
        for v in verdicts
        if not v.trusted
    ]
    return f"Evidence not to be relied upon: {', '.join(named)}." if named else ""


def _weighed(
    estimate_n: Array, sd_n: Array, cause: SummaryCause, rng: np.random.Generator, draws: int
) -> SummaryVerdict:
    """One hypothesis's evidence and posterior; its probability is left at that of its prior."""
    z, log_proposal = _proposed(estimate_n, sd_n, cause, rng, draws)
    prediction = cause.predict(z)
    log_ratio = _log_prior(z) + _log_likelihood(estimate_n, sd_n, prediction) - log_proposal
    total = float(logsumexp(log_ratio))
    weights = np.exp(log_ratio - total)
    effective = 1.0 / float((weights**2).sum())
    parameters = {}
    for name, values in prediction.parameters.items():
        mean = float(weights @ values)
        parameters[name] = (mean, float(np.sqrt(weights @ (values - mean) ** 2)))
    return SummaryVerdict(
        name=cause.name,
        log_evidence=total - float(np.log(draws)),
        log_evidence_se=float(np.sqrt(max(1.0 / effective - 1.0 / draws, 0.0))),
        effective_draws=effective,
        pareto_k=pareto_k(log_ratio),
        probability=cause.prior_probability,
        parameters=parameters,
        residual_n=estimate_n - weights @ prediction.estimate_n,
    )


def _proposed(
    estimate_n: Array, sd_n: Array, cause: SummaryCause, rng: np.random.Generator, draws: int
) -> tuple[Array, Array]:
    """Draws (n, d), half from the prior and half about the mode, and their log density (n,)."""

    def density(z: Array) -> Array:
        return _log_prior(z) + _log_likelihood(estimate_n, sd_n, cause.predict(z))

    mode = baseline_mode(density, cause.dimension)
    about = Proposal(mode.point, mode.factor, DOF)
    for _ in range(PILOTS):
        about = refined(about, importance(density, about, rng, PILOT_DRAWS))
    about = replace(about, factor=WIDER * about.factor)
    near = about.sample(rng, draws // 2)
    z = np.vstack([near, rng.standard_normal((draws - len(near), cause.dimension))])
    share = len(near) / draws
    both = np.logaddexp(np.log(share) + about.log_density(z), np.log1p(-share) + _log_prior(z))
    return z, both


def _log_prior(z: Array) -> Array:
    return np.asarray(-0.5 * (z**2).sum(-1) - 0.5 * z.shape[1] * np.log(2.0 * np.pi))


def _log_likelihood(estimate_n: Array, sd_n: Array, prediction: Prediction) -> Array:
    variance = sd_n**2 + prediction.own_sd_n**2
    misfit = (estimate_n - prediction.estimate_n) ** 2 / variance
    return np.asarray(-0.5 * (misfit + np.log(2.0 * np.pi * variance)).sum(-1))
