"""Single cut tails, unlike pulses and roundings, as columns of the innovations' linear model.

Counters show neither which pulses were a control cycle apart, nor what rounding took off. The
likelihood has the share of close pulses, the mean of every quarter of an event, and the rest as
noise of every band (docs/topics/telemetry-likelihood.md §7). Each leaves a step in the momentum, up
to fifteen standard deviations by all rows after it: rows can have a column for every one.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from cassini_bayes.balance.open_counters import patterns_at, step_variances
from cassini_bayes.balance.telemetry_noise import open_scales
from cassini_bayes.computing.arrays import Array
from cassini_bayes.diagnosis.hypotheses import Hypothesis

_LEAST: Final = 1e-12  # s², of a tail's variance: an unknown of no width has no precision


def single_cuts(hypothesis: Hypothesis, z: Array, place: int) -> tuple[Array, Array]:
    """What cut tails, unlike pulses and roundings change in an event's rows, by the model at z.

    A cut tail takes F d (τ_f − τ_r) exp(−g/τ_f) off the momentum, g the time to the next pulse and
    d the couple's lever arm, and unlike pulses deliver more or less than is expected of their sum;
    a rounding gives about F d times itself until the next firing. Its size is known: the factor
    on what coarse counters leave open counts only where it makes it larger. The longest roundings
    are unknowns of the likelihood, so that here is what that factor lacks of them.

    Parameters
    ----------
    z
        (d,) point of the hypothesis.
    place
        Number of the event among those with telemetry.

    Returns
    -------
    Columns (n, 3, s) in N m, and the variances (s,) of their unknowns in s², whose means are 0.
    """
    model, term = hypothesis.model, hypothesis.model.telemetry[place]
    counters, sampling = term.event.statistics.counters, term.event.sampling
    time_s = term.event.usable_rows.time_s
    columns, variances = [np.zeros((len(time_s), 3, 0))], [np.zeros(0)]
    physics = term.physics(model.points(z[None]))
    # few roundings may be small by chance, in bands of many rows; each by itself is what it is
    lacking = float(np.maximum(1.0 - physics.open_factor, 0.0).max())
    physics = replace(physics, open_factor=np.maximum(physics.open_factor, 1.0))
    scales = open_scales(term.balance, physics)
    for g, (steps, intervals, levels) in enumerate(
        patterns_at(counters, sampling.duration_s, time_s)
    ):
        torque = scales.torque_n_m[0, :, g, None]
        rounded = np.einsum("rcl,c->rl", levels, scales.pulse_weights[0])
        columns += [steps[:, None] * torque, rounded[:, None] * torque]
        variance = step_variances(counters, g, scales)[0, intervals]
        variances += [np.maximum(variance, _LEAST), np.ones(levels.shape[2])]
    if lacking > 0.0:  # the longest roundings are in the model already, with that factor
        long = counters.long_levels
        gained = term.balance.pattern.level_units(scales.pulse_weights)[0]
        torques = scales.torque_n_m[0][:, long.couple] * gained * np.sqrt(lacking)
        columns.append(long.at(time_s)[:, None] * torques)
        variances.append(np.ones(len(long.couple)))
    return np.concatenate(columns, axis=2), np.concatenate(variances)
