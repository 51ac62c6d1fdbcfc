"""Which wheel bias would teach most about a named quantity, and what it costs.

A bias flown with on-times u and wheel changes Δρ gives three equations
r = Σ q_k F_k κ u_k − Σ T I Δρ + noise = 0. r is linear in (u, Δρ) with coefficients that depend on
the draws of the physics, so its covariance with a quantity Q over the posterior follows for every
candidate from one covariance matrix of the coefficients. With new departures of thrust and the
dead-band's noise added, and all taken as jointly normal, the expected information gain on Q is

    EIG = −½ log(1 − ρ²),   ρ² = cᵀ (C_rr + Σ)⁻¹ c / Var Q,

with c = Cov(r, Q). docs/topics/prediction.md derives it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from itertools import product
from typing import Any, Final

import numpy as np

from cassini_bayes.balance.totals_terms import hold_attitude_covariance, hold_rate_covariance
from cassini_bayes.computing.arrays import Array, mapped, picked
from cassini_bayes.errors import InputError
from cassini_bayes.files.checks import check_known
from cassini_bayes.files.tables import rows_csv
from cassini_bayes.prediction.firing import mean_firing
from cassini_bayes.prediction.ground_knowledge import group_impulse, hydrazine_g
from cassini_bayes.prediction.learning import Learned
from cassini_bayes.prediction.physics import (
    arms_of,
    demand_of,
    features_of,
    momentum_per_rpm,
    solver_of,
    stretch,
)
from cassini_bayes.prediction.predict import on_times_of
from cassini_bayes.prediction.requests import BiasRequest, check_rates
from cassini_bayes.prediction.wheel_profile import duration_s

LEVEL: Final = "thrust_level_"
LEAST_SPREAD: Final = 1e-12  # of a quantity, over its mean: less is rounding


@dataclass(frozen=True)
class Candidate:
    """One bias with what it teaches and costs.

    ``information_nats`` is the expected gain on the quantity, ``sd_after`` its expected standard
    deviation after the bias, in its own unit.
    """

    end_rpm: tuple[float, ...]
    information_nats: float
    sd_after: float
    hydrazine_g: float
    duration_s: float
    on_time_s: Array

    @property
    def cost(self) -> float:
        """Hydrazine in g; where no event of the fit printed any, on-time of all thrusters in s."""
        return self.hydrazine_g if math.isfinite(self.hydrazine_g) else float(self.on_time_s.sum())

    @property
    def information_per_gram(self) -> float:
        """Nats per gram of hydrazine."""
        return self.information_nats / max(self.hydrazine_g, 1e-9)


@dataclass(frozen=True)
class Plan:
    """Candidates, most informative first, and what is known of the quantity before."""

    quantity: str
    unit: str
    mean: float
    sd_before: float
    start_rpm: tuple[float, ...]
    wheels: tuple[int, ...]
    wheel_names: tuple[str, ...]
    candidates: tuple[Candidate, ...]

    @property
    def has_hydrazine(self) -> bool:
        """Whether events of the fit printed hydrazine, from which that of a bias is learnt."""
        return all(math.isfinite(candidate.hydrazine_g) for candidate in self.candidates)

    def front(self) -> tuple[Candidate, ...]:
        """Candidates that no other beats in both information and cost, cheapest first."""
        result: list[Candidate] = []
        for candidate in sorted(self.candidates, key=lambda c: (c.cost, -c.information_nats)):
            if not result or candidate.information_nats > result[-1].information_nats:
                result.append(candidate)
        return tuple(result)


def quantities(learned: Learned) -> dict[str, Array]:
    """Scalars that a plan can ask about, name → draws (n,).

    ``thrust_level_z1_n`` …, ``thrust_mean_n``, ``impulse_per_on_time_z1_n`` … (thrust with the
    tail-off in it, per commanded second), and every walked parameter by its name.
    """
    physics = learned.physics
    result = {
        f"{LEVEL}{name}_n": physics.level_n[:, k] for k, name in enumerate(learned.model.thrusters)
    }
    result["thrust_mean_n"] = physics.level_n.mean(1)
    kappa = stretch(learned.model, physics, learned.pulses.coefficients[:, 0])
    impulses = physics.delivered_n(learned.model) * kappa
    for name, impulse in zip(learned.model.thrusters, impulses.T, strict=True):
        result[f"impulse_per_on_time_{name}_n"] = impulse
    walked = {name: np.asarray(physics.parameters[name]) for name in learned.model.space.names}
    return result | walked


def quantity_draws(learned: Learned, name: str) -> Array:
    """Draws of a named quantity; InputError with the nearest name."""
    known = quantities(learned)
    check_known("--quantity", name, known, "a quantity of the fit")
    return known[name]


def end_rates(levels: int, planned_rpm: tuple[float, float]) -> Array:
    """End rates of one wheel: ``levels`` steps through the planned sizes, both signs.

    Raises
    ------
    InputError
        Not even one level.
    """
    if levels < 1:
        raise InputError("--levels", "at least 1", str(levels), "ask for more levels")
    steps = np.linspace(*planned_rpm, levels)
    return np.concatenate([-steps[::-1], steps])


def _ends_of_wheel(start_rpm: float, levels: int, planned_rpm: tuple[float, float]) -> Array:
    """End rates of a wheel; it may also stay where it is, outside the low-rpm zone."""
    ends = end_rates(levels, planned_rpm)
    return np.union1d(ends, start_rpm) if abs(start_rpm) >= planned_rpm[0] else ends


def plan(
    learned: Learned,
    quantity: str,
    wheels: tuple[int, ...],
    start_rpm: Sequence[float],
    *,
    levels: int = 5,
    budget_g: float | None = None,
) -> Plan:
    """Rank every combination of end rates within the limits and outside the low-rpm zone.

    Raises
    ------
    InputError
        Unknown quantity or one that is fixed, a start beyond the limits, or a budget that no
        candidate keeps.
    """
    draws = quantity_draws(learned, quantity)
    if draws.std() <= LEAST_SPREAD * abs(draws.mean()):
        raise InputError(
            "--quantity",
            "a quantity that the fit leaves open",
            f"{quantity} = {draws.mean():.4g} in every draw",
            "ask for another one: of what is fixed no bias teaches anything",
        )
    start = np.asarray(start_rpm, dtype=np.float64)
    planned = learned.model.spacecraft.planned_wheel_rpm
    check_rates("--from", start, planned[1])
    if budget_g is not None:
        need_hydrazine(learned, "--budget", "leave it out")
    judge = _Judge.of(learned, draws, wheels)
    one = typical(learned)
    candidates = (
        judge.candidate(one, BiasRequest("candidate", wheels, start, np.array(ends)))
        for ends in product(*(_ends_of_wheel(rate, levels, planned) for rate in start))
        if not np.all(np.array(ends) == start)
    )
    result = [c for c in candidates if budget_g is None or c.hydrazine_g <= budget_g]
    if not result:
        raise InputError(
            "--budget", "enough hydrazine for one candidate", f"{budget_g:g} g", "raise it"
        )
    result.sort(key=lambda c: -c.information_nats)
    spec = learned.model.specs.get(quantity)
    return Plan(
        quantity,
        "N" if spec is None else spec.unit,  # all others are thrusts
        float(draws.mean()),
        float(draws.std()),
        tuple(start.tolist()),
        wheels,
        tuple(learned.model.spacecraft.wheel(number).name for number in wheels),
        tuple(result),
    )


def need_hydrazine(learned: Learned, where: str, fix: str) -> None:
    """Refuse an option that weighs grams, where no event of the fit printed any.

    Raises
    ------
    InputError
        The fit has learned nothing of hydrazine; ``where`` is the option, ``fix`` what to change.
    """
    if learned.hydrazine is None:
        raise InputError(where, "a fit whose events print hydrazine", "one without", fix)


def typical(learned: Learned) -> Learned:
    """The same knowledge as a single draw at its mean: for expected on-times."""
    one = np.zeros(1, dtype=np.int64)
    physics = picked(learned.physics.at_mean(), one)
    firing = {name: np.full(1, np.mean(value)) for name, value in learned.firing.items()}
    pulses = mapped(lambda draws: draws.mean(0, keepdims=True), learned.pulses)
    return replace(learned, physics=physics, firing=firing, pulses=pulses)


@dataclass(frozen=True)
class _Judge:
    """Moments of the balance's coefficients over the posterior, ready for any candidate."""

    thruster_moment: Array  # (3, K, 3, K) covariance of q F κ
    cross_moment: Array  # (3, K, 3, W) covariance of q F κ and T I
    wheel_moment: Array  # (3, W, 3, W)
    thruster_cross: Array  # (3, K) covariance with Q
    wheel_cross: Array  # (3, W)
    force: Array  # (3, K) mean of q κ
    departure: Array  # (K, K) covariance of a new event's thrust departures
    inertia_noise: Array  # (3, 3) of the hold rates
    attitude: Array
    momentum_per_rpm: Array  # (3, W) mean
    variance: float

    @staticmethod
    def of(learned: Learned, draws: Array, wheels: tuple[int, ...]) -> _Judge:
        model, physics = learned.model, learned.physics
        kappa = stretch(model, physics, learned.pulses.coefficients[:, 0])
        arms = arms_of(model, physics) * kappa[:, None, :]
        torque = arms * physics.delivered_n(model)[:, None, :]
        momentum = momentum_per_rpm(model, physics, wheels)
        t, w, q = torque - torque.mean(0), momentum - momentum.mean(0), draws - draws.mean()
        n, p = len(draws), physics.parameters
        inertia = physics.balance(model).inertia_kg_m2
        hold = hold_rate_covariance(inertia, np.asarray(p["hold_rate_rad_s"]))
        loading = model.thrust_prior.departures
        return _Judge(
            thruster_moment=np.einsum("nik,njl->ikjl", t, t) / n,
            cross_moment=np.einsum("nik,njl->ikjl", t, w) / n,
            wheel_moment=np.einsum("nik,njl->ikjl", w, w) / n,
            thruster_cross=np.einsum("nik,n->ik", t, q) / n,
            wheel_cross=np.einsum("nik,n->ik", w, q) / n,
            force=arms.mean(0),
            departure=loading @ loading.T,
            inertia_noise=np.asarray(hold.reshape(-1, 3, 3).mean(0)),
            attitude=np.sqrt(np.mean(np.asarray(p["hold_attitude_rad"]) ** 2)),
            momentum_per_rpm=momentum.mean(0),
            variance=float(draws.var()),
        )

    def candidate(self, typical: Learned, request: BiasRequest) -> Candidate:
        """Expected on-times of a request, what they teach and cost."""
        on_time, lasts, grams = expected_on_times(typical, request)
        change = request.end_rpm - request.start_rpm
        rho = self.correlation_square(on_time, change, request.start_rpm, request.end_rpm)
        return Candidate(
            end_rpm=tuple(request.end_rpm.tolist()),
            information_nats=float(-0.5 * np.log1p(-rho)),
            sd_after=float(np.sqrt(self.variance * (1.0 - rho))),
            hydrazine_g=grams,
            duration_s=lasts,
            on_time_s=on_time,
        )

    def correlation_square(
        self, on_time_s: Array, change_rpm: Array, start_rpm: Array, end_rpm: Array
    ) -> float:
        """ρ² of the quantity with the balance of a bias."""
        u, d = on_time_s, change_rpm
        cross = np.einsum("ikjl,k,l->ij", self.cross_moment, u, d)
        clean = (
            np.einsum("ikjl,k,l->ij", self.thruster_moment, u, u)
            + np.einsum("ikjl,k,l->ij", self.wheel_moment, d, d)
            - cross
            - cross.T
        )
        departures = self.force * u
        ends = [(self.momentum_per_rpm @ rate)[None, None] for rate in (start_rpm, end_rpm)]
        noise = (
            self.inertia_noise
            + departures @ self.departure @ departures.T
            + hold_attitude_covariance(ends[0], ends[1], self.attitude)[0, 0]
        )
        c = self.thruster_cross @ u - self.wheel_cross @ d
        square = float(c @ np.linalg.solve(clean + noise, c)) / self.variance
        return min(square, 1.0 - 1e-12)


def expected_on_times(typical: Learned, request: BiasRequest) -> tuple[Array, float, float]:
    """Expected on-times (K,), duration and hydrazine of a bias at the mean of all knowledge."""
    model, physics = typical.model, typical.physics
    rate = typical.pulses.coefficients[:, 0]
    thrust = expected_thrusts(typical, request.epoch or typical.last_epoch)
    solver = solver_of(model, physics, thrust, rate)
    rates = (request.start_rpm, request.end_rpm)
    lasts = duration_s(typical.manager, request.wheels, rates[1] - rates[0])
    demand = demand_of(model, physics, typical.manager, request.wheels, rates, lasts)
    features = features_of(model, solver, demand, lasts)
    firing = mean_firing(typical.firing, features, typical.layout.cycle_s)
    on_time = on_times_of(typical, solver, demand.sum(1), firing)
    return on_time[0], lasts, _grams(typical, thrust, on_time, rate)


def expected_thrusts(typical: Learned, epoch: datetime) -> Array:
    """Expected thrusts (1, K), N, of a bias at an epoch: level, and trend of the printed thrust."""
    level = typical.physics.delivered_n(typical.model)
    return np.asarray(level + typical.thrust_moved_n(epoch).mean())


def _grams(typical: Learned, thrust_n: Array, on_time: Array, rate: Array) -> float:
    if typical.hydrazine is None:
        return float("nan")
    effective = on_time * stretch(typical.model, typical.physics, rate)
    total, couple = group_impulse(typical.layout, thrust_n, effective)
    mean = typical.hydrazine.coefficients.mean(0, keepdims=True)
    return float(hydrazine_g(mean, total, couple)[0])


def plan_dictionary(found: Plan, top: int) -> dict[str, Any]:
    """JSON-ready: what is known before, the most informative, those per gram, and the front."""
    return {
        "quantity": found.quantity,
        "unit": found.unit,
        "mean": found.mean,
        "sd_before": found.sd_before,
        "wheels": list(found.wheels),
        "from_rpm": list(found.start_rpm),
        "candidates": len(found.candidates),
        "most_informative": [_entry(c) for c in found.candidates[:top]],
        "most_per_gram": [_entry(c) for c in _per_gram(found)[:top]],
        "front": [_entry(c) for c in found.front()],
    }


def _per_gram(found: Plan) -> list[Candidate]:
    if not found.has_hydrazine:
        return []
    return sorted(found.candidates, key=lambda c: -c.information_per_gram)


def _entry(candidate: Candidate) -> dict[str, Any]:
    return {
        "to_rpm": list(candidate.end_rpm),
        "information_nats": candidate.information_nats,
        "sd_after": candidate.sd_after,
        "hydrazine_g": grams_or_none(candidate.hydrazine_g),
        "duration_s": candidate.duration_s,
    }


def plan_csv(found: Plan) -> str:
    """Every candidate, most informative first; grams are empty where the fit knows none."""
    ends = [f"{name}_rpm_end" for name in found.wheel_names]
    told = ["information_nats", "quantity", "unit", "sd_after", "hydrazine_g", "duration_s"]
    rows = [[*ends, *told]]
    for c in found.candidates:
        grams = grams_or_none(c.hydrazine_g)
        rows.append(
            [
                *(f"{rate:g}" for rate in c.end_rpm),
                f"{c.information_nats:.6g}",
                found.quantity,
                found.unit,
                f"{c.sd_after:.6g}",
                "" if grams is None else f"{grams:.6g}",
                f"{c.duration_s:.6g}",
            ]
        )
    return rows_csv(rows)


def plan_text(found: Plan, top: int) -> str:
    """Tables for a terminal: the most informative, and the most per gram of hydrazine."""
    start = ", ".join(f"{rate:g}" for rate in found.start_rpm)
    lines = [
        f"{found.quantity}: {found.mean:.4g} ± {found.sd_before:.2g} {found.unit} (1 sd) before;"
        f" {len(found.candidates)} candidates from [{start}] rev/min",
    ]
    wheels = "  ".join(f"{name:>7}" for name in found.wheel_names)
    for title, chosen in (
        ("most informative", found.candidates[:top]),
        ("most per gram", _per_gram(found)[:top]),
    ):
        if not chosen:
            continue
        lines += [
            "",
            f"{title}: ends [rev/min], gain [nats], 1 sd after [{found.unit}], hydrazine [g],"
            " time [s]",
            f"{wheels}  {'gain':>8}  {'1 sd':>10}  {'g':>7}  {'s':>6}",
        ]
        lines += [
            f"{'  '.join(f'{rate:7.0f}' for rate in c.end_rpm)}  {c.information_nats:8.4f}"
            f"  {c.sd_after:10.4g}  {grams_shown(c.hydrazine_g):>7}  {c.duration_s:6.0f}"
            for c in chosen
        ]
    return "\n".join(lines)


def grams_or_none(hydrazine_g: float) -> float | None:
    """Grams for a record; None where the fit says nothing of them."""
    return hydrazine_g if math.isfinite(hydrazine_g) else None


def grams_shown(hydrazine_g: float) -> str:
    """Grams for a table; a dash where the fit says nothing of them."""
    return f"{hydrazine_g:.1f}" if math.isfinite(hydrazine_g) else "–"
