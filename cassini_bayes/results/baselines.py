"""The estimates this package replaces: least squares with hand-picked perturbation bars.

Paper 003 eqs. (5)-(8) estimate four Z thrusts and two Y-pair thrusts by a pseudo-inverse of the
momentum balance with rectangular pulses, then divide by a correction factor for rise and tail-off.
Paper 000 eq. (23) estimates one mean thrust of all thrusters. Error bars come from perturbing each
assumed parameter by a hand-picked amount. Totals give one time step per event: per event the
pseudo-inverse is a minimum-norm answer to fewer equations than thrusters, pooled over events it is
an ordinary least-squares fit. The papers used the time history within each event, which totals do
not carry; their numbers are not reproduced here, their method is.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
import pandas as pd

from cassini_bayes.balance.totals_terms import TotalsStack, wheel_momentum
from cassini_bayes.computing.arrays import Array
from cassini_bayes.model.posterior import Model
from cassini_bayes.model.terms import Points
from cassini_bayes.spacecraft.parameters import ParameterSpec
from cassini_bayes.spacecraft.pulses import PULSE_SHAPES

MINIMUM_ON_TIME_S: Final = 5.0  # paper 003 §IV: estimates from shorter on-times are not valid
PER_EVENT: Final = "pseudo-inverse, per event"
POOLED: Final = "pseudo-inverse, pooled"
MEAN: Final = "mean of all thrusters, per event"

# Paper 003 §IV. Inertia does not act on totals rows: they have no rates.
PERTURBED_BLOCKS: Final[Mapping[str, float]] = {
    "centre of mass": 0.10,
    "geometry": 0.01,
    "wheel inertia": 0.01,
    "inertia": 0.50,  # products
}
PERTURBED: Final[Mapping[str, float]] = {
    **{f"inertia_{axis}{axis}_kg_m2": 0.05 for axis in "xyz"},
    "tau_fall_s": 0.10,
}
"""Shares of single parameters, in place of those of their blocks."""
ALIGNMENT_PERTURBATION_RAD: Final = 0.01  # 1 % of the column of T


def perturbation_bars(model: Model, nominal: Mapping[str, float]) -> pd.DataFrame:
    """Every baseline estimate from totals rows with its perturbation bars.

    Parameters
    ----------
    model
        Its totals rows are used; their pulse shape is not: the papers' correction factor is.
    nominal
        Assumed value of every walked or fixed parameter, e.g. the priors' means.

    Returns
    -------
    DataFrame with columns method, event ("" when pooled), thruster, estimate_n, bar_rss_n (root sum
    square of the shifts), bar_worst_n (sum of their absolute values), on_time_s, valid, note.
    """
    points = assumed_points(model, nominal)
    rows: list[dict[str, object]] = []
    for term in model.totals:
        stack = term.stack
        for (method, event), values in _estimates(stack, points).items():
            each = stack.on_time_s[[not event or name == event for name in stack.event_ids]].sum(0)
            counted = np.full_like(each, each.sum()) if method == MEAN else each
            rows += estimate_rows(method, event, stack.thrusters, values, counted, each)
    return pd.DataFrame(rows)


def assumed_points(model: Model, nominal: Mapping[str, float]) -> Points:
    """The assumed parameters, then one point per perturbation of paper 003."""
    points = [dict(nominal), *perturbed(model.specs, nominal)]
    batch = {name: np.array([point[name] for point in points]) for name in nominal}
    return model.points_at(batch, len(points))


def estimate_rows(
    method: str,
    event: str,
    thrusters: Sequence[str],
    values: Array,
    counted_s: Array,
    on_time_s: Array,
) -> list[dict[str, object]]:
    """Table rows of one method: estimates (n, K), those after the first with perturbations.

    ``counted_s`` (K,) is the on-time by which an estimate is called valid.
    """
    shifts = values[1:] - values[0]
    rss, worst = np.sqrt((shifts**2).sum(0)), np.abs(shifts).sum(0)
    valid = (counted_s >= MINIMUM_ON_TIME_S) & np.isfinite(values[0])
    return [
        {
            "method": method,
            "event": event,
            "thruster": name,
            "estimate_n": values[0, k],
            "bar_rss_n": rss[k],
            "bar_worst_n": worst[k],
            "on_time_s": on_time_s[k],
            "valid": bool(valid[k]),
            "note": "" if valid[k] else f"on-time below {MINIMUM_ON_TIME_S:g} s",
        }
        for k, name in enumerate(thrusters)
    ]


def perturbed(
    specs: Mapping[str, ParameterSpec], nominal: Mapping[str, float]
) -> list[dict[str, float]]:
    """One point per hand-picked perturbation of paper 003's list."""
    points = []
    for name, value in nominal.items():
        block = specs[name].block
        share = PERTURBED.get(name, PERTURBED_BLOCKS.get(block))
        if block == "wheel alignment":
            points.append({**nominal, name: value + ALIGNMENT_PERTURBATION_RAD})
        elif share is not None:
            points.append({**nominal, name: value * (1.0 + share)})
    return points


def _estimates(stack: TotalsStack, points: Points) -> dict[tuple[str, str], Array]:
    """(method, event) → corrected thrust (n, K) for n sets of assumed parameters."""
    physics, batch = points.physics(()), points.parameters
    axes, inertias, arms = physics.wheel_axes, physics.wheel_inertia_kg_m2, physics.arms_m
    change = wheel_momentum(axes, inertias, stack.wheel_end_rad_s) - wheel_momentum(
        axes, inertias, stack.wheel_start_rad_s
    )
    # the thrusters of a couple always fire together: one unknown for the couple (000 eq. 21)
    columns = (arms[:, None] * stack.on_time_s[:, None, :]) @ stack.couples.T
    result: dict[tuple[str, str], Array] = {}
    for e, event in enumerate(stack.event_ids):
        factor = correction_factor(stack.on_time_s[e], stack.pulses[e], batch)
        each = _least_squares(columns[:, e], change[:, e]) @ stack.couples
        result[PER_EVENT, event] = np.where(stack.on_time_s[e] > 0, each, np.nan) / factor
        mean = _least_squares(columns[:, e].sum(-1, keepdims=True), change[:, e])
        weighted = (stack.on_time_s[e] * factor).sum(-1, keepdims=True) / stack.on_time_s[e].sum()
        result[MEAN, event] = np.broadcast_to(mean / weighted, each.shape)
    n = len(columns)
    pooled = _least_squares(columns.reshape(n, -1, columns.shape[-1]), change.reshape(n, -1))
    factor = correction_factor(stack.on_time_s.sum(0), stack.pulses.sum(0), batch)
    result[POOLED, ""] = (pooled @ stack.couples) / factor
    return result


def _least_squares(columns: Array, target: Array) -> Array:
    """Minimum-norm least squares F = pinv(U) V for stacked systems: (n, R, G), (n, R) → (n, G)."""
    return np.asarray((np.linalg.pinv(columns) @ target[..., None])[..., 0])


def correction_factor(on_time_s: Array, pulses: Array, parameters: Mapping[str, Array]) -> Array:
    """T of paper 003 eq. (7) per thruster at its mean pulse width: (t_c − τ_rise + τ_fall)/t_c.

    on_time_s, pulses (K,); parameters (n,) → (n, K); 1 where a thruster did not fire.
    """
    fired = pulses > 0
    width = np.where(fired, on_time_s / np.where(fired, pulses, 1.0), 1.0)
    effective = PULSE_SHAPES["published_2012"].effective_time(
        width,
        *(np.asarray(parameters[f"tau_{part}_s"])[..., None] for part in ("delay", "rise", "fall")),
    )
    return np.where(fired, effective / width, 1.0)
