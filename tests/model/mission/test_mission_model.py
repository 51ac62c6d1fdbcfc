"""The mission model against a brute-force joint density, and against itself in two steps."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations

import numpy as np
import pytest
from mission_cases import mission_of, mission_table, mixed_events, values_at
from totals_cases import plain_log_likelihood

from cassini_bayes.computing.arrays import Array
from cassini_bayes.events.totals import TotalsEvent
from cassini_bayes.model.mission.model import MissionModel

REFERENCE_KPA = 1758.0


def event_values(
    event: TotalsEvent, mission: Mapping[str, float], pressure: float, years: float
) -> dict[str, float]:
    """Plain parameters of one event, written out from the mission's by hand."""
    own = {
        name: mission.get(f"{event.branch}.{name}", value)
        for name, value in mission.items()
        if "." not in name
    }
    branch = f"{event.branch}."
    own |= {k.removeprefix(branch): v for k, v in mission.items() if k.startswith(branch)}
    if event.branch == "B":
        own["cm_y_m"] += next(v for k, v in mission.items() if k.startswith("cm_y_m_since"))
    relative = pressure / REFERENCE_KPA
    own["tau_fall_s"] *= relative ** -own["tail_pressure_exponent"]
    own["tau_fall_s"] *= np.exp(own["tail_ageing_per_year"] * years)
    return own


def quadratic(event: TotalsEvent, own: Mapping[str, float], reference: float) -> tuple[Array, ...]:
    """Log density of one event's data as c + gᵀx + ½ xᵀHx of its 8 thrusts and 3 torques.

    By differences of the plain density, which is exactly quadratic in them.
    """
    scale = np.array([0.05] * 8 + [1e-4] * 3)
    base = np.array([reference] * 8 + [0.0] * 3)

    def at(*moved: int) -> float:
        x = base.copy()
        for i in moved:
            x[i] += scale[i]
        return plain_log_likelihood(
            (event,), own, x[None, :8], x[None, 8:], reference, expand_jacobian=True
        )

    c = at()
    one = np.array([at(i) for i in range(11)])
    two = np.array([at(i, i) for i in range(11)])
    hessian = np.diag(two - 2 * one + c)
    for i, j in combinations(range(11), 2):
        hessian[i, j] = hessian[j, i] = at(i, j) - one[i] - one[j] + c
    gradient = one - c - 0.5 * np.diagonal(hessian)
    hessian = hessian / np.outer(scale, scale)
    gradient = gradient / scale
    return (
        np.array(c - gradient @ base + 0.5 * base @ hessian @ base),
        gradient - hessian @ base,
        hessian,
    )


def brute_force(model: MissionModel, events: tuple[TotalsEvent, ...], z: Array) -> float:
    """Log density of all events' data: one dense Gaussian integral over 32 thrusts, 12 torques."""
    mission = values_at(model, z)
    tank, years = model.circumstances.tank, model.circumstances.years
    pressures = tank.pressures_kpa(np.ones(1))[0]
    size = 11 * len(events)
    mean, covariance = np.zeros(size), np.zeros((size, size))
    precision, linear, constant = np.zeros((size, size)), np.zeros(size), 0.0
    first = {b: min(y for e, y in zip(events, years, strict=True) if e.branch == b) for b in "AB"}
    share = mission["thrust_intercept_share"]
    u = share + (1.0 - share) * pressures / REFERENCE_KPA
    common = {"A": 0.75, "B": 0.76}
    torque = (np.array([-0.53e-6, -2.11e-6, 1.83e-6]), 1.0e-6)
    for i, event in enumerate(events):
        at = slice(11 * i, 11 * i + 8)
        mean[at] = u[i] * common[event.branch]
        mean[11 * i + 8 : 11 * i + 11] = torque[0]
        covariance[at, at] += 0.01**2 * np.ones((8, 8)) + 0.01**2 * np.eye(8)
        torques = slice(11 * i + 8, 11 * i + 11)
        covariance[torques, torques] = torque[1] ** 2 * np.eye(3)
        for j, other in enumerate(events):
            if other.branch != event.branch:
                continue
            t, s = years[i] - first[event.branch], years[j] - first[event.branch]
            levels = 0.05**2 * np.ones((8, 8)) + 0.02**2 * np.eye(8)
            ageing = t * s * (0.03**2 * np.ones((8, 8)) + 0.005**2 * np.eye(8))
            covariance[at, 11 * j : 11 * j + 8] += u[i] * u[j] * (levels + ageing)
        reference = float(_reference(model, event, i))
        own = event_values(event, mission, pressures[i], float(years[i]) - first[event.branch])
        c, g, h = quadratic(event, own, reference)
        block = slice(11 * i, 11 * i + 11)
        precision[block, block] -= h
        linear[block] += g
        constant += float(c)
    # log ∫ exp(c + gᵀx − ½ xᵀPx) N(x; m, V) dx
    prior = np.linalg.inv(covariance)
    total = precision + prior
    pull = linear + prior @ mean
    return float(
        constant
        + 0.5 * pull @ np.linalg.solve(total, pull)
        - 0.5 * mean @ prior @ mean
        - 0.5 * np.linalg.slogdet(total)[1]
        - 0.5 * np.linalg.slogdet(covariance)[1]
    )


def _reference(model: MissionModel, event: TotalsEvent, place: int) -> float:
    branch = next(b for b in model.branches if b.branch == event.branch)
    return float(branch.reference_n[list(branch.events).index(place)])


def test_both_branches_and_wheel_sets_equal_a_brute_force_joint_density() -> None:
    """A and B branch, wheels 1-2-3 and 1-2-4, a moved centre of mass, pressures: equal to 1e-8."""
    events = mixed_events()[:3]
    model = mission_of(events, mission_table())
    rng = np.random.default_rng(5)
    z = 0.5 * rng.standard_normal(model.space.dimension)
    expected = brute_force(model, events, z)
    assert model.log_likelihood(z[None])[0] == pytest.approx(expected, rel=1e-8, abs=1e-7)
