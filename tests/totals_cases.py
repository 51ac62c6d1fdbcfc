"""Small totals problems shared by the tests, and a plain reference likelihood written differently.

The reference knows nothing of stacks, batches or collapsing: it loops over events and thrusters,
takes cross products and asks scipy for a normal density.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from scipy.stats import multivariate_normal

from cassini_bayes.computing.arrays import Array
from cassini_bayes.events.totals import TotalsEvent, read_totals
from cassini_bayes.model import Model
from cassini_bayes.priors.reader import Priors, read_priors

ROOT = Path(__file__).parents[1]
FLIGHT = ROOT / "cassini_bayes" / "published" / "flight_2009_2010.csv"
B_BRANCH = ROOT / "priors" / "cassini_b_branch_2010.toml"

CORNERS = {"1": (1, 1), "2": (-1, 1), "3": (-1, -1), "4": (1, -1)}


def flight(first: int = 8) -> tuple[tuple[TotalsEvent, ...], Priors]:
    """The first flight events and the B-branch priors."""
    priors = read_priors(B_BRANCH)
    return read_totals(FLIGHT, priors.spacecraft)[:first], priors


def cassini_arm(name: str, p: Mapping[str, float]) -> Array:
    """Torque per newton of a Cassini thruster from its printed position and direction."""
    sx, sy = CORNERS[name[1]]
    height = p["thruster_lzz_m"] if name[0] == "z" else p["thruster_lzy_m"]
    position = np.array([sx * p["thruster_lx_m"], sy * p["thruster_ly_m"], height])
    centre = np.array([p["cm_x_m"], p["cm_y_m"], p["cm_z_m"]])
    if name[0] == "z":
        direction = np.array([0.0, 0.0, -1.0])
    else:
        direction = np.array([0.0, -1.0 if name[1] in "12" else 1.0, 0.0])
    return np.cross(position - centre, direction)


def cassini_wheel_axis(number: int, p: Mapping[str, float]) -> Array:
    """Spin axis of a Cassini wheel; wheel 4 lies along wheel 3, tilted."""
    s = 1 / np.sqrt(3)
    axes = {
        1: np.array([0, np.sqrt(2 / 3), s]),
        2: np.array([-1 / np.sqrt(2), -1 / np.sqrt(6), s]),
        3: np.array([1 / np.sqrt(2), -1 / np.sqrt(6), s]),
    }
    if number != 4:
        return axes[number]
    a = axes[3]
    e1 = np.cross([0, 0, 1], a)
    e1 /= np.linalg.norm(e1)
    axis = a + p["rwa4_tilt_u_rad"] * e1 + p["rwa4_tilt_v_rad"] * np.cross(a, e1)
    return np.asarray(axis / np.linalg.norm(axis))


def plain_log_likelihood(
    events: tuple[TotalsEvent, ...],
    p: Mapping[str, float],
    thrust: Array,
    torque: Array,
    reference_thrust: float,
    *,
    expand_jacobian: bool,
) -> float:
    """Log density of momentum balances of Cassini events, one point, first-order pulses."""
    total = 0.0
    inertia = np.array(
        [[p[f"inertia_{''.join(sorted(a + b))}_kg_m2"] for b in "xyz"] for a in "xyz"]
    )
    rpm = 2 * np.pi / 60
    for e, event in enumerate(events):
        h0, h1, wheel_cov = np.zeros(3), np.zeros(3), np.zeros((3, 3))
        for number, start, end in zip(
            event.wheels, event.rwa_start_rpm, event.rwa_end_rpm, strict=True
        ):
            momentum = p[f"rwa{number}_inertia_kg_m2"] * cassini_wheel_axis(number, p) * rpm
            h0, h1 = h0 + momentum * start, h1 + momentum * end
            wheel_cov += 2 * p["wheel_resolution_rpm"] ** 2 / 12 * np.outer(momentum, momentum)
        impulse = torque[e] * event.duration_s
        effective = np.zeros(8)
        for k, name in enumerate(event.thrusters):
            if event.pulses[k] > 0:
                width = event.on_time_s[k] / event.pulses[k]
                extra = (p["tau_fall_s"] - p["tau_rise_s"]) * (1 - np.exp(-width / p["tau_rise_s"]))
                effective[k] = event.pulses[k] * (width + extra)
            impulse = impulse + cassini_arm(name, p) * thrust[e, k] * effective[k]
        covariance = 2 * p["hold_rate_rad_s"] ** 2 * inertia @ inertia.T + wheel_cov
        for h in (h0, h1):
            skew = np.array([[0, -h[2], h[1]], [h[2], 0, -h[0]], [-h[1], h[0], 0]])
            covariance += p["hold_attitude_rad"] ** 2 * skew @ skew.T
        arms = dict(zip(event.thrusters, (cassini_arm(n, p) for n in event.thrusters), strict=True))
        for couple in (("z1",), ("z2",), ("z3",), ("z4",), ("y1", "y3"), ("y2", "y4")):
            force = reference_thrust * sum(arms[name] for name in couple)
            covariance += p["on_time_resolution_s"] ** 2 / 12 * np.outer(force, force)
        total += multivariate_normal(np.zeros(3), covariance).logpdf(impulse - (h1 - h0))
        if expand_jacobian:
            value, gradient, second = jacobian_expansion(event, p, reference_thrust, effective)
            step = thrust[e] - reference_thrust
            total += value + gradient @ step + 0.5 * step @ second @ step
        else:
            total += float(np.log(abs(jacobian_determinant(event, p, thrust[e], effective))))
    return float(total)


def jacobian_expansion(
    event: TotalsEvent, p: Mapping[str, float], reference: float, effective: Array
) -> tuple[float, Array, Array]:
    """Value, gradient and Hessian of log |det| in the thrusts, without any calculus.

    The determinant of a sum of rank-one terms F_k q_k r_kᵀ is affine in each F_k, so unit steps
    give its derivatives exactly.
    """

    def at(*moved: int) -> float:
        thrust = np.full(8, reference)
        thrust[list(moved)] += 1.0
        return jacobian_determinant(event, p, thrust, effective)

    d0 = at()
    first = np.array([at(k) - d0 for k in range(8)])
    mixed = np.zeros((8, 8))
    for k in range(8):
        for m in range(k):
            mixed[k, m] = mixed[m, k] = at(k, m) - at(k) - at(m) + d0
    return float(np.log(abs(d0))), first / d0, mixed / d0 - np.outer(first, first) / d0**2


def jacobian_determinant(
    event: TotalsEvent, p: Mapping[str, float], thrust: Array, effective: Array
) -> float:
    """det between momentum and the on-times of the busier pair about each axis."""
    pairs = {
        "x": (("z3", "z4"), ("z1", "z2")),
        "y": (("z1", "z4"), ("z2", "z3")),
        "z": (("y2", "y4"), ("y1", "y3")),
    }
    index = {name: k for k, name in enumerate(event.thrusters)}
    columns = []
    for plus, minus in pairs.values():
        busy_plus = sum(event.on_time_s[index[n]] for n in plus)
        busy_minus = sum(event.on_time_s[index[n]] for n in minus)
        pair, sign = (plus, 1.0) if busy_plus >= busy_minus else (minus, -1.0)
        column = np.zeros(3)
        for name in pair:
            k = index[name]
            stretch = effective[k] / event.on_time_s[k] if event.on_time_s[k] > 0 else 1.0
            column = column + sign * stretch * thrust[k] * cassini_arm(name, p)
        columns.append(column)
    return float(np.linalg.det(np.array(columns).T))


def point(model: Model, z: Array) -> dict[str, float]:
    """Parameters of a single point as floats."""
    return {k: float(np.asarray(v).reshape(-1)[0]) for k, v in model.space.to_parameters(z).items()}
