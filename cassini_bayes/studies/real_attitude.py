"""What real attitude records show: noise of rates and attitudes, their steps, and gyro errors.

Reconstructed Cassini attitudes and rates (:mod:`cassini_bayes.published.attitude`) are the source
of the priors of both noise levels. White noise is told by high differences, in which smooth motion
cancels: of rates by second ones (variance 6 σ²), of angles by third and fourth ones (20 and 70 σ²),
by medians, so that firings do not count. A gyro's bias b and scale s follow from rates integrated
over blocks, g = (1 + s) φ + b t + e, and turns of the attitude, m = φ + ε. With the true turns φ at
their most likely values what is left to minimise is

    Σ (g − (1 + s) m − b t)² / (V_e + (1 + s)² V_ε)

(Deming's regression). Regressing g − m on m instead takes ε for motion: errors in variables.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

import numpy as np
import pandas as pd
from scipy.optimize import minimize

from cassini_bayes.balance.statistics.preparation import channel_step
from cassini_bayes.balance.statistics.turns import turns_between
from cassini_bayes.computing.arrays import Array
from cassini_bayes.published.attitude import AttitudeRecord, attitude_records
from cassini_bayes.report.study_page import markdown_table, table_of
from cassini_bayes.spacecraft.attitude import direction_cosines
from cassini_bayes.studies.study import Study

MODULE: Final = "studies.real_attitude"
BLOCK_ROWS: Final = 16  # 64 s: the turn of a block is known ten times better than by its rates
LARGEST_ERROR: Final = 0.1  # standard error of a scale beyond which a record says nothing of it
NORMAL_MEDIAN: Final = 0.6745  # of |x|, in standard deviations
AXES: Final = "xyz"
NOISES: Final[Mapping[str, str]] = {
    "rates, µrad/s": "rate_noise_rad_s",
    "attitudes, µrad, third differences": "attitude_noise_third_rad",
    "attitudes, µrad, fourth differences": "attitude_noise_fourth_rad",
}


def high_difference_noise(values: Array, order: int) -> Array:
    """Standard deviation (c,) of white noise in columns (n, c) by differences of some order."""
    differences = np.diff(values, n=order, axis=0)
    variance = sum(math.comb(order, k) ** 2 for k in range(order + 1))
    return np.asarray(np.median(np.abs(differences), axis=0) / NORMAL_MEDIAN / np.sqrt(variance))


def even_stretch(record: AttitudeRecord) -> AttitudeRecord:
    """The longest stretch of a record in even steps of time."""
    steps = np.diff(record.time_s)
    usual = np.median(steps)
    breaks = np.flatnonzero(np.abs(steps - usual) > 0.01 * usual)
    edges = np.concatenate([[-1], breaks, [len(steps)]])
    longest = int(np.argmax(np.diff(edges)))
    part = slice(int(edges[longest]) + 1, int(edges[longest + 1]) + 1)
    return AttitudeRecord(
        record.name, record.time_s[part], record.attitude[part], record.rate_rad_s[part]
    )


def gyro_errors(
    integrated: Array, turned: Array, time_s: Array, variance: tuple[float, float]
) -> tuple[Array, Array]:
    """Scale and bias (2,) of one axis by maximum likelihood, and their standard errors.

    Parameters
    ----------
    integrated, turned, time_s
        (m,) rates integrated over blocks, rad, turns of the attitude, rad, lengths of blocks, s.
    variance
        Of an integrated rate and of a turn, rad².
    """
    span = float(np.mean(time_s))
    unit = np.array([1e-3, 1e-6])  # scale, rad/s: makes both of order one

    def cost(x: Array) -> float:
        scale, bias = x * unit
        total = variance[0] + (1.0 + scale) ** 2 * variance[1]
        missed = integrated - (1.0 + scale) * turned - bias * time_s
        return float(0.5 * (missed**2).sum() / total)

    result = minimize(cost, np.zeros(2), method="BFGS")
    design = np.stack([turned, time_s], axis=1) * unit
    gram = design.T @ design / (variance[0] + variance[1])
    noise = len(turned) * variance[1] / (variance[0] + variance[1]) * unit[0] ** 2
    gram[0, 0] = max(gram[0, 0] - noise, 1e-12 * span)  # noise of the turns tells nothing
    return result.x * unit, np.sqrt(np.diagonal(np.linalg.inv(gram))) * unit


def measured(record: AttitudeRecord) -> pd.DataFrame:
    """One row per body axis of a record."""
    record = even_stretch(record)
    step = float(np.median(np.diff(record.time_s)))
    turns = turns_between(direction_cosines(record.attitude))
    angles = np.concatenate([np.zeros((1, 3)), np.cumsum(turns, axis=0)])
    rate = high_difference_noise(record.rate_rad_s, 2)
    by_third, by_fourth = (high_difference_noise(angles, order) for order in (3, 4))
    count = (len(record.time_s) - 1) // BLOCK_ROWS
    mean = 0.5 * step * (record.rate_rad_s[1:] + record.rate_rad_s[:-1])
    blocks = mean[: count * BLOCK_ROWS].reshape(count, BLOCK_ROWS, 3).sum(axis=1)
    turned = turns[: count * BLOCK_ROWS].reshape(count, BLOCK_ROWS, 3).sum(axis=1)
    time = np.full(count, BLOCK_ROWS * step)
    rows = []
    for axis, name in enumerate(AXES):
        variance = (BLOCK_ROWS * (step * rate[axis]) ** 2, 2.0 * by_third[axis] ** 2)
        result, error = gyro_errors(blocks[:, axis], turned[:, axis], time, variance)
        naive = np.polyfit(turned[:, axis], blocks[:, axis] - turned[:, axis], 1)[0]
        rows.append(
            {
                "record": record.name,
                "axis": name,
                "rows": len(record.time_s),
                "rate_noise_rad_s": rate[axis],
                "rate_step_rad_s": channel_step(np.round(record.rate_rad_s[:, axis], 9)),
                "attitude_noise_third_rad": by_third[axis],
                "attitude_noise_fourth_rad": by_fourth[axis],
                "rate_scale": result[0],
                "rate_scale_se": error[0],
                "rate_bias_rad_s": result[1],
                "rate_bias_se_rad_s": error[1],
                "naive_scale": naive,
            }
        )
    return pd.DataFrame(rows)


def _scale_text(scale: float, error: float) -> str:
    """In 10⁻³, where the record turns enough to tell."""
    return "not determined" if error > LARGEST_ERROR else f"{1e3 * scale:+.2f} ± {1e3 * error:.2f}"


def study_real_attitude(study: Study) -> None:
    """Measure all records and write page and table."""
    table = pd.concat([measured(record) for record in attitude_records()], ignore_index=True)
    scales = zip(table["rate_scale"], table["rate_scale_se"], strict=True)
    micro = table.filter(regex="_rad(_s)?$") * 1e6
    rows = table_of(
        table.assign(
            **micro, scale=[_scale_text(*both) for both in scales], naive=1e3 * table["naive_scale"]
        ),
        "record | axis | rows | rate noise, µrad/s"
        " | attitude noise, µrad (third, fourth differences) | gyro scale, 10⁻³"
        " | gyro bias, µrad/s | scale by naive regression, 10⁻³",
        "{record} | {axis} | {rows} | {rate_noise_rad_s:.1f} | {attitude_noise_third_rad:.1f},"
        " {attitude_noise_fourth_rad:.1f} | {scale} | {rate_bias_rad_s:+.2f} ±"
        " {rate_bias_se_rad_s:.2f} | {naive:+.2f}",
    )
    noise = markdown_table(
        ("noise", "least", "median", "most"),
        (
            [what, *(f"{micro[column].quantile(share):.0f}" for share in (0.0, 0.5, 1.0))]
            for what, column in NOISES.items()
        ),
    )
    body = f"""\
How noisy are real rates and attitudes? Measured on three stretches of reconstructed Cassini
records, every 4 s (US Geological Survey, public domain; `cassini_bayes.published.attitude` says
where they come from). Noise is one standard deviation of white noise, by high differences. Gyro
errors are ± one standard error.

{noise}

The higher the difference, the less motion is in it, and the more of the records' own smoothing. The
shipped priors of `rate_noise_rad_s` and `attitude_noise_rad` are of this size.

No record shows a gyro error. A plain regression on measured turns agrees where the body turns;
where it hardly does, it takes noise for a scale.

{rows}
"""
    study.publish("Noise of real attitude records", body, MODULE, {"": table}, {})
