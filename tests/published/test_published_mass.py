"""The mass behind the tables, and the pulse term of their computed ΔV."""

from __future__ import annotations

from dataclasses import replace
from types import MappingProxyType

import numpy as np
import pytest

from cassini_bayes.errors import InputError
from cassini_bayes.published.constants import published_constants
from cassini_bayes.published.mass import (
    calibrated_accelerations,
    consistent_accelerations,
    fit_predicted_delta_v,
    fit_pulse_term,
    mass_trend,
    monotone_mass_intervals,
    table_mass,
)
from cassini_bayes.published.printed import Interval
from cassini_bayes.published.wheel_bias import WheelBiasTable, wheel_bias_tables

PULSE_TERM_S = 0.0109


def test_first_table_by_hand() -> None:
    """Table 3.a: 0.77 N × 36.47 s / 11.63 mm/s and 0.77 N × 50.86 s / 16.22 mm/s agree."""
    mass = table_mass(wheel_bias_tables()[0])
    assert mass.columns == ("ideal", "calibrated")
    for by_hand in (0.77 * 36.47 / 11.63e-3, 0.77 * 50.86 / 16.22e-3):  # 2414.6, 2414.4 kg
        assert mass.mass_at_printed_thrust_kg.meets(Interval(by_hand, by_hand))
    assert mass.mass_kg == pytest.approx(2414.4, abs=0.05)
    assert mass.mass_interval_kg.half_width / mass.mass_kg == pytest.approx(0.0069, abs=1e-4)


def test_mass_recovered_from_made_up_tables() -> None:
    """Figures computed from a known mass and thrust, rounded as in print, give the mass back."""
    rng = np.random.default_rng(3)
    table = wheel_bias_tables()[0]
    for _ in range(50):
        mass, thrust = rng.uniform(2300, 2450), rng.uniform(0.7, 0.8)
        changed = dict(table.cells)
        for column in ("ideal", "calibrated"):
            on_time = rng.uniform(4, 60)
            changed["on_time_z_total", column] = replace(
                table.cell("on_time_z_total", column), text=f"{on_time:.2f}"
            )
            changed["delta_v_z", column] = replace(
                table.cell("delta_v_z", column), text=f"{-1e3 * thrust * on_time / mass:.2f}"
            )
        changed["thrust", "all_columns"] = replace(
            table.cell("thrust", "all_columns"), text=f"{thrust:.2f}"
        )
        found = table_mass(replace(table, cells=MappingProxyType(changed)))
        assert found.columns == ("ideal", "calibrated")
        assert found.acceleration_m_s2.meets(Interval(thrust / mass, thrust / mass))
        assert found.mass_interval_kg.meets(Interval(mass, mass))


def test_table_masses() -> None:
    """Eight masses; only Table 3.b has columns that exclude each other."""
    masses = [table_mass(table) for table in wheel_bias_tables()]
    assert [m.mass_kg for m in masses] == pytest.approx(
        [2414.4, 2409.1, 2400.9, 2380.2, 2377.9, 2379.1, 2379.9, 2373.0], abs=0.06
    )
    assert [m.columns for m in masses].count(("ideal",)) == 1
    assert masses[1].columns == ("ideal",)
    relative = [m.acceleration_m_s2.half_width / m.acceleration_m_s2.middle for m in masses]
    assert max(relative) < 0.0026
    assert min(relative) == pytest.approx(0.0004, abs=5e-5)


def test_masses_decrease_towards_paper_004() -> None:
    """A monotone mass fits all intervals and stays above the 2292.2 kg of 2011-12-12."""
    tables = wheel_bias_tables()
    masses = [table_mass(table) for table in tables]
    narrowed = monotone_mass_intervals(masses)
    later = published_constants().value("paper_004_table_1", "mass_kg")
    assert all(n.low > later for n in narrowed)
    assert all(
        n.low >= m.mass_interval_kg.low and n.high <= m.mass_interval_kg.high
        for n, m in zip(narrowed, masses, strict=True)
    )
    trend = mass_trend(tables)
    assert (trend.slope, trend.slope_se) == pytest.approx((-0.188, 0.016), abs=5e-4)
    # a spacecraft that gained 2 % between the first and the last event cannot be
    with pytest.raises(InputError, match="low ≤ high"):
        monotone_mass_intervals([masses[-1], masses[0]])


def test_simulation_counts_10_9_ms_per_pulse() -> None:
    """FSDS: |ΔVz| = (F/M)(T + 10.90 ms × pulses), to the rounding of the table."""
    tables = wheel_bias_tables()
    acceleration = consistent_accelerations(tables)
    fixed = fit_pulse_term(tables, "fsds", acceleration, unit_slope=True)
    assert fixed.extra_on_time_s == pytest.approx(0.01090, abs=1e-5)
    assert fixed.extra_on_time_se_s == pytest.approx(2.1e-5, abs=1e-6)
    assert fixed.residual_sd_s < 0.01 / 0.315  # one unit of the last digit of ΔVz
    free = fit_pulse_term(tables, "fsds", acceleration, unit_slope=False)
    assert (free.slope, free.slope_se) == pytest.approx((1.0037, 0.0035), abs=1e-4)
    assert (free.extra_on_time_s, free.extra_on_time_se_s) == pytest.approx(
        (0.01034, 0.00053), abs=1e-5
    )


def test_flight_follows_the_same_rule_with_scatter() -> None:
    """Flight: slope 0.997 ± 0.002 with an intercept; the pulse term alone is poorly determined."""
    tables = wheel_bias_tables()
    line = fit_predicted_delta_v(
        tables, "flight", calibrated_accelerations(tables), PULSE_TERM_S, intercept=True
    )
    assert (line.slope, line.slope_se) == pytest.approx((0.9973, 0.0017), abs=1e-4)
    assert (line.intercept, line.intercept_se) == pytest.approx((-7.06e-5, 1.86e-5), abs=1e-7)
    consistent = consistent_accelerations(tables)
    through = fit_predicted_delta_v(tables, "flight", consistent, PULSE_TERM_S, intercept=False)
    assert (through.slope, through.slope_se) == pytest.approx((0.9944, 0.0023), abs=1e-4)
    free = fit_pulse_term(tables, "flight", consistent, unit_slope=False)
    assert abs(free.slope - 1.0) < 2 * free.slope_se
    assert free.extra_on_time_se_s > 0.01
    simulation = fit_pulse_term(tables, "fsds", consistent, unit_slope=True)
    flight = fit_pulse_term(tables, "flight", consistent, unit_slope=True)
    # the scatter of flight exceeds the rounding of the table
    assert flight.residual_sd_s > 10 * simulation.residual_sd_s


def test_pulse_term_recovered_from_made_up_tables() -> None:
    """With ΔVz computed from a known pulse term both parameters come back."""
    tables = tuple(_with_pulse_term(table, 0.0234) for table in wheel_bias_tables())
    acceleration = {table.event: 3.2e-4 for table in tables}
    fit = fit_pulse_term(tables, "flight", acceleration, unit_slope=False)
    assert fit.slope == pytest.approx(1.0, abs=1e-9)
    assert fit.extra_on_time_s == pytest.approx(0.0234, abs=1e-9)
    line = fit_predicted_delta_v(tables, "flight", acceleration, 0.0234, intercept=True)
    assert (line.slope, line.intercept) == pytest.approx((1.0, 0.0), abs=1e-9)
    wrong = fit_predicted_delta_v(tables, "flight", acceleration, 0.0, intercept=False)
    assert abs(wrong.slope - 1.0) > 5 * wrong.slope_se
    with pytest.raises(InputError, match="events"):
        fit_pulse_term(tables[:2], "flight", acceleration, unit_slope=False)


def _with_pulse_term(table: WheelBiasTable, extra_s: float) -> WheelBiasTable:
    on_time = table.cell("on_time_z_total", "flight").value
    pulses = sum(table.cell(f"pulses_z{n}", "flight").value for n in (1, 2, 3, 4))
    speed = -0.32 * (on_time + extra_s * pulses)
    cell = replace(table.cell("delta_v_z", "flight"), text=repr(float(speed)))
    return replace(table, cells=MappingProxyType({**table.cells, ("delta_v_z", "flight"): cell}))
