"""The cheapest wheel bias: a Y-bias where Z thrusters count, and nothing in the low-rpm zone."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from datetime import timedelta
from functools import cache

import numpy as np
import pytest
import xarray as xr
from prediction_cases import flights, learned

from cassini_bayes.errors import InputError
from cassini_bayes.prediction.minimise import (
    OBJECTIVES,
    CheapestBias,
    accumulated_throughput,
    cheapest_bias,
    cheapest_dictionary,
    cheapest_text,
)
from cassini_bayes.prediction.planning import expected_on_times, expected_thrusts, plan, typical
from cassini_bayes.prediction.requests import BiasRequest
from cassini_bayes.spacecraft.description import PLANNED_WHEEL_RPM

WHEELS = (1, 2, 4)
START = (-700.0, -650.0, -600.0)
WANTED: Mapping[int, float] = {4: 600.0}
RING = [0, 1, 2, 3]


@cache
def found(objective: str) -> CheapestBias:
    """From the rates of the shipped Y-bias scenario, wheel 4 going to 600 rev/min."""
    return cheapest_bias(learned(), objective, WHEELS, START, WANTED, np.random.default_rng(1))


def scanned(objective: str, steps: int = 10) -> float:
    """The least cost on a grid of end rates, by plain loops."""
    one = typical(learned())
    size = np.linspace(*PLANNED_WHEEL_RPM, steps)
    rates = np.concatenate([-size, size])
    best = np.inf
    for first in rates:
        for second in rates:
            request = BiasRequest(
                "x", WHEELS, np.array(START), np.array([first, second, WANTED[4]])
            )
            on_time, _, grams = expected_on_times(one, request)
            best = min(best, on_time[RING].sum() if objective == "z_throughput" else grams)
    return float(best)


def test_sparing_z_thrusters_is_a_y_bias() -> None:
    """Nearly equal rate changes: the demand lies on the Y couples, Z fires for the limit cycle."""
    best = found("z_throughput")
    changes = np.array(best.choices[0].end_rpm) - np.array(START)
    assert np.ptp(changes) < 0.1 * changes.mean()
    assert best.choices[0].cost.ring_s < 0.15 * 2 * best.choices[0].cost.on_time_s[5]
    # negative control: half as much again on one wheel costs several times the Z on-time
    request = BiasRequest("x", WHEELS, np.array(START), np.array([1100.0, 550.0, 600.0]))
    other = expected_on_times(typical(learned()), request)[0][RING].sum()
    assert other > 2.0 * best.choices[0].cost.ring_s


def test_a_bias_costs_the_thrust_of_its_epoch() -> None:
    """Printed thrusts fall by 0.04 N a year: two years after the last event on-times are longer."""
    one = typical(learned())
    rates = np.array(START), np.array([1100.0, 550.0, 600.0])
    last = BiasRequest("x", WHEELS, *rates)
    later = replace(last, epoch=one.last_epoch + timedelta(days=730))
    ratio = expected_on_times(one, later)[0].sum() / expected_on_times(one, last)[0].sum()
    moved = [
        expected_thrusts(one, epoch).mean() for epoch in (one.last_epoch, later.epoch) if epoch
    ]
    assert ratio == pytest.approx(moved[0] / moved[1], rel=0.03)
    assert ratio > 1.05


@pytest.mark.parametrize("objective", OBJECTIVES)
def test_no_grid_point_is_cheaper(objective: str) -> None:
    """An independent scan of end rates finds nothing below the first choice."""
    best = found(objective).choices[0].cost
    worth = OBJECTIVES[objective](best)
    assert worth <= scanned(objective) + 1e-6


@pytest.mark.parametrize("objective", OBJECTIVES)
def test_ends_keep_limits_and_zone(objective: str) -> None:
    """Every choice ends outside the low-rpm zone, within the limit, with the wanted rate."""
    best = found(objective)
    ends = np.array([choice.end_rpm for choice in best.choices])
    assert np.all(np.abs(ends) >= PLANNED_WHEEL_RPM[0])
    assert np.all(np.abs(ends) <= PLANNED_WHEEL_RPM[1])
    assert np.all(ends[:, 2] == 600.0)
    costs = [OBJECTIVES[objective](choice.cost) for choice in best.choices]
    assert costs == sorted(costs)
    assert len({tuple(np.sign(row)) for row in ends}) == 4


def test_the_objectives_differ() -> None:
    """The bias that spares Z thrusters takes more hydrazine than the cheapest, and less Z."""
    spared, cheap = found("z_throughput").choices[0].cost, found("hydrazine").choices[0].cost
    assert spared.hydrazine_g > cheap.hydrazine_g
    assert spared.ring_s < cheap.ring_s


def observed() -> xr.Dataset:
    """On-times of the flight events as a fit has observed them, and of a slew that fires none."""
    events = flights()[0]
    still = np.full(len(events[0].thrusters), np.nan)
    on_time = np.array([*(event.on_time_s for event in events), still])
    known = {"event": [*(event.id for event in events), "slew"], "thruster": [*events[0].thrusters]}
    return xr.Dataset({"on_time_s": (("event", "thruster"), on_time)}, coords=known)


def test_throughput_adds_up_and_meets_its_limit() -> None:
    """Past on-times are sums over the events; a limit below them is said to be passed."""
    best = found("z_throughput")
    events = flights()[0]
    rows = accumulated_throughput(observed(), best.prediction, 80.0)
    for row in rows:
        total = sum(e.on_time_s[e.thrusters.index(row.thruster)] for e in events)
        assert row.past_s == pytest.approx(total)
        assert row.added_s <= row.added_high_s
        assert row.exceeds == (row.past_s + row.added_high_s > 80.0)
    assert {row.exceeds for row in rows} == {True, False}
    assert not any(row.exceeds for row in accumulated_throughput(observed(), best.prediction, None))
    json.dumps(cheapest_dictionary(best, rows))
    assert "may pass the limit" in cheapest_text(best, rows)


@pytest.mark.parametrize(
    ("objective", "start", "wanted", "words"),
    [
        ("z_thruoghput", START, WANTED, "z_throughput"),
        ("hydrazine", START, {}, "rwa4"),
        ("hydrazine", START, {1: 500.0, 2: 500.0, 4: 500.0}, "all of them"),
        ("hydrazine", START, {3: 500.0}, "wheel 3"),
        ("hydrazine", START, {4: 200.0}, "bearings"),
        ("hydrazine", START, {4: 2100.0}, "2000"),
        ("hydrazine", (-2500.0, 0.0, 0.0), WANTED, "--from"),
    ],
)
def test_bad_requests_get_one_line(
    objective: str, start: tuple[float, ...], wanted: dict[int, float], words: str
) -> None:
    """Unknown objective, nothing or everything wanted, rates that cannot be."""
    with pytest.raises(InputError) as raised:
        cheapest_bias(learned(), objective, WHEELS, start, wanted, np.random.default_rng(1))
    assert words in str(raised.value)
    assert "\n" not in str(raised.value)


def test_a_fit_without_hydrazine_spares_thrusters_only() -> None:
    """Grams that no event printed cannot be made least; beside the Z thrusters they stay open."""
    dry = replace(learned(), hydrazine=None)
    given = (WHEELS, START, WANTED)
    with pytest.raises(InputError, match="--minimise hydrazine: expected a fit whose events"):
        cheapest_bias(dry, "hydrazine", *given, np.random.default_rng(1))
    best = cheapest_bias(dry, "z_throughput", *given, np.random.default_rng(1))
    record = cheapest_dictionary(best, ())
    assert [choice["hydrazine_g"] for choice in record["choices"]] == [None] * 4
    json.dumps(record, allow_nan=False)
    text = cheapest_text(best, ())
    assert "nan" not in text
    assert text.count("–") == 4


def test_a_limit_of_nothing_is_refused() -> None:
    """A limit has to be above zero."""
    with pytest.raises(InputError, match="above 0"):
        accumulated_throughput(observed(), found("hydrazine").prediction, 0.0)


def test_a_quantity_that_is_fixed_is_no_question_for_a_plan() -> None:
    """Without spread there is nothing to learn: gains of 1e-26 nats had been ranked."""
    known = learned()
    level = np.broadcast_to(known.physics.level_n.mean(0), known.physics.level_n.shape)
    fixed = replace(known, physics=replace(known.physics, level_n=level))
    with pytest.raises(InputError, match="expected a quantity that the fit leaves open"):
        plan(fixed, "thrust_mean_n", WHEELS, START, levels=1)
