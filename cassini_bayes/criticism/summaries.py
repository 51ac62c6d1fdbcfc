"""Diagnosis of published summary estimates: thrusts with their pulse statistics, no telemetry.

What was estimated is y = F R(τ_f) k (1 + ε): F the thrust, R the ratio of delivered to commanded
impulse of the pulses that were fired (1 where the estimate was corrected already), k the error of
geometry and inertia that all estimates share. Every hypothesis is a prior on these; its evidence is
the mean likelihood over draws from it, which needs no approximation with so few parameters.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from cassini_bayes.pulses import PulseShape

Array = NDArray[np.float64]
Draw = Callable[[np.random.Generator, int], "Prediction"]
DRAWS: Final = 400_000


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
    """One hypothesis: name, prior probability, draws from its prior."""

    name: str
    prior_probability: float
    draw: Draw


@dataclass(frozen=True)
class SummaryVerdict:
    """Evidence, probability and posterior summaries of one hypothesis."""

    name: str
    log_evidence: float
    log_evidence_se: float
    probability: float
    parameters: Mapping[str, tuple[float, float]]  # posterior mean and standard deviation
    residual_n: Array  # estimates less posterior mean prediction


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
        Of the draws from each prior.
    """
    found = []
    for cause in causes:
        prediction = cause.draw(rng, draws)
        variance = sd_n**2 + prediction.own_sd_n**2
        score = -0.5 * ((estimate_n - prediction.estimate_n) ** 2 / variance).sum(-1)
        score = score - 0.5 * np.log(2.0 * np.pi * variance).sum(-1)
        total = float(logsumexp(score))
        weights = np.exp(score - total)
        effective = 1.0 / float((weights**2).sum())
        parameters = {}
        for name, values in prediction.parameters.items():
            mean = float(weights @ values)
            parameters[name] = (mean, float(np.sqrt(weights @ (values - mean) ** 2)))
        found.append(
            (
                cause,
                total - float(np.log(draws)),
                float(np.sqrt(max(1.0 / effective - 1.0 / draws, 0.0))),
                parameters,
                estimate_n - weights @ prediction.estimate_n,
            )
        )
    scores = np.array([row[1] + np.log(row[0].prior_probability) for row in found])
    shares = np.exp(scores - float(logsumexp(scores)))
    verdicts = [
        SummaryVerdict(cause.name, evidence, se, float(share), parameters, residual)
        for (cause, evidence, se, parameters, residual), share in zip(found, shares, strict=True)
    ]
    return sorted(verdicts, key=lambda verdict: -verdict.probability)
