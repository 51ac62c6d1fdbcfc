"""The end rates of a wheel bias that cost least: Z thrusters, or hydrazine (paper 003's Y-bias).

Some wheels have to arrive at given rates, the others may end anywhere within the limits and outside
the low-rpm zone. A bias whose momentum change lies along the couple axis fires the couples alone,
but for what the limit cycle takes; that needs one free wheel for each of the other two axes. The
cost is the expected one of :mod:`cassini_bayes.prediction.planning`, so thrusts, geometry and
firing logic are those of the fit.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from types import MappingProxyType
from typing import Any, Final

import numpy as np
import xarray as xr
from scipy.optimize import minimize

from cassini_bayes.computing.arrays import Array
from cassini_bayes.errors import InputError
from cassini_bayes.files.checks import check_known
from cassini_bayes.prediction.learning import Learned
from cassini_bayes.prediction.planning import (
    expected_on_times,
    grams_or_none,
    grams_shown,
    need_hydrazine,
    typical,
)
from cassini_bayes.prediction.predict import Prediction, predict
from cassini_bayes.prediction.requests import BiasRequest, check_rates
from cassini_bayes.prediction.wheel_profile import rates_rpm

STEP_S: Final = 1.0  # of the time that wheels spend in the low-rpm zone
_TOLERANCE_RPM: Final = 0.5
_TOLERANCE: Final = 1e-3  # of the cost, s or g
_MOST_CALLS: Final = 400  # of the cost per choice of signs
_LEVELS: Final = 12  # of every free wheel's end rate, to start from


@dataclass(frozen=True)
class Cost:
    """What a bias is expected to take.

    ``ring_s`` are the seconds of the four thrusters that the two ring axes share (Z on Cassini),
    summed; ``low_rpm_s`` the time that any wheel spends in the low-rpm zone; ``hydrazine_g`` is
    not a number where no event of the fit printed any.
    """

    on_time_s: Array  # (K,)
    ring_s: float
    hydrazine_g: float
    duration_s: float
    low_rpm_s: float


OBJECTIVES: Final[Mapping[str, Callable[[Cost], float]]] = MappingProxyType(
    {"z_throughput": lambda cost: cost.ring_s, "hydrazine": lambda cost: cost.hydrazine_g}
)
"""What can be made least: seconds of the Z thrusters, or grams."""


@dataclass(frozen=True)
class Choice:
    """End rates (in the order of the wheels) and what they cost."""

    end_rpm: tuple[float, ...]
    cost: Cost


@dataclass(frozen=True)
class CheapestBias:
    """The best end rates for every choice of signs, cheapest first, and the first one predicted."""

    objective: str
    wheels: tuple[int, ...]
    start_rpm: tuple[float, ...]
    choices: tuple[Choice, ...]
    prediction: Prediction


def cheapest_bias(
    learned: Learned,
    objective: str,
    wheels: tuple[int, ...],
    start_rpm: Sequence[float],
    wanted_rpm: Mapping[int, float],
    rng: np.random.Generator,
) -> CheapestBias:
    """End rates that make an objective least, with predicted on-times and their intervals.

    Parameters
    ----------
    learned
        What past events taught.
    objective
        Key of :data:`OBJECTIVES`.
    wheels, start_rpm
        Prime wheels and their rates before the bias.
    wanted_rpm
        End rates that are asked for, wheel number → rev/min: one wheel at least, and not all.
    rng
        Of the prediction's draws.

    Raises
    ------
    InputError
        An unknown objective, or hydrazine where no event printed any; no wheel wanted or all of
        them; a rate beyond the limits, or a wanted one in the low-rpm zone.
    """
    check_known("--minimise", objective, OBJECTIVES)
    if objective == "hydrazine":
        need_hydrazine(learned, f"--minimise {objective}", "minimise z_throughput")
    start = np.asarray(start_rpm, dtype=np.float64)
    planned = learned.model.spacecraft.planned_wheel_rpm
    _check_rates(wheels, start, wanted_rpm, planned)
    one = typical(learned)
    free = [place for place, number in enumerate(wheels) if number not in wanted_rpm]
    wanted = np.array([wanted_rpm.get(number, 0.0) for number in wheels])

    def request(ends: Array) -> BiasRequest:
        full = wanted.copy()
        full[free] = ends
        return BiasRequest("cheapest", wheels, start, full)

    worth = OBJECTIVES[objective]
    choices = []
    for signs in product((-1.0, 1.0), repeat=len(free)):
        ends = _least(lambda ends: worth(_cost(one, request(ends))), np.array(signs), planned)
        asked = request(ends)
        choices.append(Choice(tuple(asked.end_rpm.tolist()), _cost(one, asked)))
    choices.sort(key=lambda choice: worth(choice.cost))
    best = BiasRequest("cheapest", wheels, start, np.array(choices[0].end_rpm))
    return CheapestBias(
        objective,
        wheels,
        tuple(start.tolist()),
        tuple(choices),
        predict(learned, best, rng),
    )


def _check_rates(
    wheels: tuple[int, ...],
    start: Array,
    wanted: Mapping[int, float],
    planned_rpm: tuple[float, float],
) -> None:
    names = ", ".join(map(str, wheels))
    if not wanted or set(wanted) >= set(wheels):
        raise InputError(
            "--to",
            f"end rates of some of the wheels {names}, the others being free",
            "all of them" if wanted else "none",
            "leave out the wheels that may end anywhere" if wanted else 'write e.g. "rwa4: -729"',
        )
    for number in wanted:
        if number not in wheels:
            raise InputError("--to", f"wheels {names}", f"wheel {number}", "leave it out")
    for key, rates in (("--from", start), ("--to", np.array(list(wanted.values())))):
        check_rates(key, rates, planned_rpm[1])
    low = [rate for rate in wanted.values() if abs(rate) < planned_rpm[0]]
    if low:
        raise InputError(
            "--to",
            f"end rates outside ±{planned_rpm[0]:.0f} rev/min, where bearings wear",
            f"{low[0]:g}",
            "end faster",
        )


def _least(cost: Callable[[Array], float], signs: Array, planned_rpm: tuple[float, float]) -> Array:
    """End rates of the given signs with the least cost: the best of a grid, then a simplex."""
    levels = np.linspace(*planned_rpm, _LEVELS)
    first = min((signs * np.array(ends) for ends in product(levels, repeat=len(signs))), key=cost)
    # towards the middle of the range, so that the simplex has a volume at a limit, too
    middle = 0.5 * sum(planned_rpm)
    inward = np.where(np.abs(first) < middle, 1.0, -1.0) * signs * 0.5 * (levels[1] - levels[0])
    result = minimize(
        cost,
        first,
        method="Nelder-Mead",
        bounds=[tuple(sorted((s * planned_rpm[0], s * planned_rpm[1]))) for s in signs],
        options={
            "initial_simplex": np.vstack([first, first + np.diag(inward)]),
            "xatol": _TOLERANCE_RPM,
            "fatol": _TOLERANCE,
            "maxfev": _MOST_CALLS,
        },
    )
    return np.asarray(result.x)


def _cost(one: Learned, request: BiasRequest) -> Cost:
    on_time, lasts, grams = expected_on_times(one, request)
    couple = {k for unit in one.layout.units[:2] for k in unit}
    ring = [k for k in range(len(on_time)) if k not in couple]
    time = np.arange(0.0, lasts, STEP_S)
    rates = rates_rpm(one.manager, request.wheels, request.start_rpm, request.end_rpm, time)
    low = np.any(np.abs(rates) < one.model.spacecraft.planned_wheel_rpm[0], axis=1)
    return Cost(on_time, float(on_time[ring].sum()), grams, lasts, STEP_S * float(low.sum()))


@dataclass(frozen=True)
class Throughput:
    """On-time of one thruster over past events, what a planned bias adds, and the limit."""

    thruster: str
    past_s: float
    added_s: float  # mean of the prediction
    added_high_s: float  # its 95 % quantile
    limit_s: float | None

    @property
    def exceeds(self) -> bool:
        """Whether the limit may be passed: past and the upper quantile together."""
        return self.limit_s is not None and self.past_s + self.added_high_s > self.limit_s


def accumulated_throughput(
    observed: xr.Dataset, prediction: Prediction, limit_s: float | None
) -> tuple[Throughput, ...]:
    """Throughput of every thruster, seconds commanded, over events and a planned bias.

    Parameters
    ----------
    observed
        A fit's ``observed_data``: on-times of all its events, slews and burns too.
    prediction, limit_s
        The planned bias, and the most on-time of a thruster.

    Raises
    ------
    InputError
        A limit that is not above zero.
    """
    if limit_s is not None and not limit_s > 0.0:
        raise InputError("--limit", "seconds above 0", f"{limit_s:g}", "give the allowed on-time")
    rows = []
    fired = observed["on_time_s"].sum("event")  # an event without thrusters has NaN: nothing
    for k, name in enumerate(prediction.thrusters):
        past = float(fired.sel(thruster=name))
        drawn = prediction.on_time_s[:, k]
        high = float(np.quantile(drawn, 0.95))
        rows.append(Throughput(name, past, float(drawn.mean()), high, limit_s))
    return tuple(rows)


def cheapest_dictionary(found: CheapestBias, throughput: Sequence[Throughput]) -> dict[str, Any]:
    """JSON-ready: choices, intervals of the first one's on-times, throughput per thruster."""
    return {
        "minimise": found.objective,
        "wheels": list(found.wheels),
        "from_rpm": list(found.start_rpm),
        "choices": [_entry(choice) for choice in found.choices],
        "on_time_s": {name: _interval(draws) for name, draws in _on_times(found)},
        "throughput_s": {
            row.thruster: {
                "past": row.past_s,
                "added": row.added_s,
                "added_high_95": row.added_high_s,
                "limit": row.limit_s,
                "exceeds": row.exceeds,
            }
            for row in throughput
        },
    }


def _entry(choice: Choice) -> dict[str, Any]:
    cost = choice.cost
    return {
        "to_rpm": [round(rate, 1) for rate in choice.end_rpm],
        "z_throughput_s": cost.ring_s,
        "hydrazine_g": grams_or_none(cost.hydrazine_g),
        "duration_s": cost.duration_s,
        "low_rpm_s": cost.low_rpm_s,
    }


def _on_times(found: CheapestBias) -> list[tuple[str, Array]]:
    prediction = found.prediction
    return list(zip(prediction.unit_names(), prediction.unit_on_time_s().T, strict=True))


def _interval(draws: Array) -> dict[str, float]:
    low, high = np.quantile(draws, (0.05, 0.95))
    return {"mean": float(draws.mean()), "low_90": float(low), "high_90": float(high)}


def cheapest_text(found: CheapestBias, throughput: Sequence[Throughput]) -> str:
    """Tables for a terminal: end rates by choice of signs, on-times, throughput."""
    start = ", ".join(f"{rate:g}" for rate in found.start_rpm)
    lines = [
        f"least {found.objective} from [{start}] rev/min; ends, Z thrusters [s], hydrazine [g],"
        " time [s], in the low-rpm zone [s]"
    ]
    for choice in found.choices:
        ends = "  ".join(f"{rate:7.0f}" for rate in choice.end_rpm)
        cost = choice.cost
        lines.append(
            f"{ends}  {cost.ring_s:7.2f}  {grams_shown(cost.hydrazine_g):>7}"
            f"  {cost.duration_s:6.0f}  {cost.low_rpm_s:6.0f}"
        )
    lines += ["", "on-times of the first [s]: mean, 90 % interval"]
    for name, draws in _on_times(found):
        one = _interval(draws)
        lines.append(f"{name:<8} {one['mean']:7.2f}  {one['low_90']:7.2f} to {one['high_90']:.2f}")
    lines += ["", "throughput [s]: events of the fit, this bias, its 95 % quantile, limit"]
    for row in throughput:
        limit = "" if row.limit_s is None else f"{row.limit_s:9.1f}"
        figures = f"{row.past_s:9.2f} {row.added_s:8.2f} {row.added_high_s:8.2f} {limit}"
        verdict = "  may pass the limit" if row.exceeds else ""
        lines.append(f"{row.thruster:<8} {figures}{verdict}")
    return "\n".join(lines)
