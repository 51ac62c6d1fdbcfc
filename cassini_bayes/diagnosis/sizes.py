"""Sizes of causes: posterior draws of an effect's parameters, and their intervals."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cassini_bayes.balance.statistics.columns import Rows
from cassini_bayes.balance.telemetry_terms import CONTROL_CYCLE_S
from cassini_bayes.diagnosis.evidence import TRUSTED_K, Weighed
from cassini_bayes.diagnosis.extended import Case, Hypothesis, Oscillation
from cassini_bayes.diagnosis.innovations import linearise, with_unknowns
from cassini_bayes.diagnosis.oscillation import case_of
from cassini_bayes.diagnosis.unresolved import unresolved

Array = NDArray[np.float64]
SUMMARY_DRAWS: Final = 2_000
LATE: Final = "time_offset_s"


def size_draws(
    case: Case, weighed: Weighed, rng: np.random.Generator, rows: Sequence[Rows] | None = None
) -> tuple[dict[str, Array], Array]:
    """Draws (n,) of every effect parameter by key, and their weights (n,).

    ``rows`` are those of the case where they are at hand.

    What counters leave open is in them (:func:`with_unresolved`). Pulses start with control cycles,
    and rows with a pulse under way do not enter the balance: those that do cannot tell records late
    by τ from records late by the whole cycles in τ. So is what a term's form leaves out
    (``form_error`` of its entry in the catalogue).
    """
    z, weights = effect_draws(weighed, rng)
    own = case_of(case, weighed.hypothesis)
    known = rows if own is case else None
    z = with_unresolved(own, weighed.hypothesis, weighed.mode.point, z, rng, known)
    values = effect_values(weighed, z)
    if LATE in values:
        values[LATE] = values[LATE] + rng.uniform(0.0, CONTROL_CYCLE_S, len(z))
    for effect in weighed.hypothesis.effects:
        for key, share in effect.form_error:
            values[key] = values[key] * (1.0 + share * rng.standard_normal(len(z)))
    return values, weights


def effect_draws(weighed: Weighed, rng: np.random.Generator) -> tuple[Array, Array]:
    """Posterior draws (n, d) in z and their weights (n,): importance or Laplace draws.

    Importance draws of a Pareto k̂ above 0.7 are a few that outweigh all others: an interval of
    theirs would be far too narrow.
    """
    if weighed.z is not None and weighed.log_weights is not None and weighed.pareto_k < TRUSTED_K:
        return weighed.z, np.exp(weighed.log_weights)
    mode = weighed.mode
    white = rng.standard_normal((SUMMARY_DRAWS, len(mode.point)))
    return mode.point + white @ mode.factor.T, np.full(SUMMARY_DRAWS, 1.0 / SUMMARY_DRAWS)


def effect_values(weighed: Weighed, z: Array) -> dict[str, Array]:
    """The effect parameters' values (n,) at z: departures added to the baseline's parameter.

    An oscillation is given as it shows itself: amplitude, frequency and damping.
    """
    model = weighed.hypothesis.model
    parameters = model.space.to_parameters(z)
    means = dict(zip("xyz", model.torque_mean_n_m, strict=True))
    values = {}
    for effect in weighed.hypothesis.effects:
        for parameter in effect.parameters:
            value = np.asarray(parameters[parameter.name], dtype=np.float64)
            if parameter.is_departure and parameter.key in parameters:
                value = value + parameters[parameter.key]
            elif parameter.is_departure and parameter.key.startswith("external_torque_"):
                value = value + means[parameter.key.split("_")[2]]
            values[parameter.key] = value
    if weighed.hypothesis.oscillation is not None:
        return _seen_from_outside(values, weighed.hypothesis.oscillation)
    return values


def _seen_from_outside(values: dict[str, Array], line: Oscillation) -> dict[str, Array]:
    """An oscillation's values as the free body shows it: amplitude, frequency, damping.

    A body that gives makes its appendage faster by 1/√(1 − φ). What it gives is in its rates, but
    of a swing between rows straight lines show the share sinc² fΔ only, so that the line is found
    with the rest of that already in it.
    """
    by_line, by_damping = values.pop("frequency_shift"), values.pop("damping_shift")
    frequency = line.frequency_hz + by_line / line.span_s
    damping = line.damping + by_damping / (2.0 * np.pi * line.frequency_hz * line.span_s)
    seen = np.sinc(line.frequency_hz * line.step_s) ** 2
    free = np.sqrt(1.0 - seen * values["inertia_fraction"])
    amplitude = np.hypot(values.pop("cosine_rad_s"), values.pop("sine_rad_s"))
    shown = {"frequency_hz": frequency / free, "damping": np.maximum(damping, 0.0) / free}
    return {**values, **shown, "amplitude_rad_s": amplitude}


def weighted_interval(
    values: Array, weights: Array, probability: float = 0.9
) -> tuple[float, float]:
    """Shortest interval with at least this probability of values (n,) with weights (n,)."""
    order = np.argsort(values)
    ordered, cumulative = values[order], np.cumsum(weights[order])
    starts = np.concatenate([[0.0], cumulative[:-1]])
    ends = np.searchsorted(cumulative, starts + probability * cumulative[-1] - 1e-12)
    valid = ends < len(ordered)
    widths = ordered[ends[valid]] - ordered[valid]
    first = int(np.argmin(widths))
    return float(ordered[valid][first]), float(ordered[ends[valid]][first])


def with_unresolved(
    case: Case,
    hypothesis: Hypothesis,
    mode: Array,
    z: Array,
    rng: np.random.Generator,
    rows: Sequence[Rows] | None = None,
) -> Array:
    """Posterior draws z (n, d) about a mode (d,), moved and widened by what counters leave open.

    With X the linear model's columns, U those of what is open (:mod:`unresolved`), r what the
    model leaves at its mode, G and G' the Gram matrices of X and of (X, U) with their priors'
    precision, draws move by Δ and are widened by N(0, Σ' − Σ), where

        (Δ, u) = G'⁻¹ (0, Uᵀ r),  Σ = (G⁻¹)_zz,  Σ' = (G'⁻¹)_zz,

    and (−Xᵀ m, Uᵀ (r − m)) in place of (0, Uᵀ r) where what is open has a mean m. Stay as they are:
    hypotheses of gyro errors, of which attitudes speak that are not in the rows, and cases with
    totals rows, whose information the linear model does not have.
    """
    if not case.sources or case.totals or hypothesis.rates is not None:
        return z
    linear, rows, factors = linearise(case, hypothesis, mode, known=rows)
    opened = [unresolved(case, hypothesis, mode, i, own.time_s) for i, own in enumerate(rows)]
    wide = with_unknowns(linear, opened, factors)
    d, own = len(mode), linear.columns.shape[1]
    gram = linear.gram()
    pull = np.zeros(own)
    pull[:d] = mode  # of the prior, whose centre is not the mode
    rest = linear.columns.T @ linear.target - pull
    answer = np.linalg.solve(gram, rest)
    left = linear.target - linear.columns @ answer
    slope = wide.columns.T @ (wide.target - linear.columns @ answer)
    slope[:own] -= linear.columns.T @ left
    wider = wide.gram()
    move = np.linalg.solve(wider, slope)[:d]
    added = np.linalg.inv(wider)[:d, :d] - np.linalg.inv(gram)[:d, :d]
    values, vectors = np.linalg.eigh(0.5 * (added + added.T))
    spread = vectors * np.sqrt(np.maximum(values, 0.0))
    return np.asarray(z + move + rng.standard_normal(z.shape) @ spread.T)
