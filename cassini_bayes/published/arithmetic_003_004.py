"""The arithmetic of papers 003 and 004, re-done with the rounding of every operand."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from cassini_bayes.published.checks import Check, check_cell
from cassini_bayes.published.constants import Constants
from cassini_bayes.published.printed import Interval, Printed
from cassini_bayes.published.tables import ThrustComparison


def _excess_percent(value: Printed, base: Printed) -> tuple[Interval, float]:
    """100 (value − base)/base as interval and from printed operands (base > 0)."""
    ratio = value.interval / base.interval
    return (
        (ratio - Interval(1.0, 1.0)).scaled(100.0),
        100.0 * (value.value - base.value) / base.value,
    )


def thrust_comparison_checks(
    a_branch: Sequence[ThrustComparison], b_branch: Sequence[ThrustComparison]
) -> Iterator[Check]:
    """Percentages of Tables 1 and 2, and equal thrusts within every Y couple.

    The base differs: Table 1 prints (navigation − study)/study, Table 2 (study − flight
    software)/flight software.
    """
    for source, rows, study_is_base in (
        ("003 Table 1", a_branch, True),
        ("003 Table 2", b_branch, False),
    ):
        for row in rows:
            if row.other_n is None or row.difference_percent is None:
                continue
            value, base = (
                (row.other_n, row.this_study_n)
                if study_is_base
                else (row.this_study_n, row.other_n)
            )
            interval, nominal = _excess_percent(value, base)
            yield check_cell(
                row.difference_percent,
                interval,
                nominal,
                source=source,
                row=row.thruster,
                column="difference_percent",
                rule="100 (navigation − study) / study"
                if study_is_base
                else "100 (study − flight software) / flight software",
            )
        thrust = {row.thruster[:2]: row for row in rows}
        for first, second in (("y1", "y3"), ("y2", "y4")):
            other = thrust[second].this_study_n
            yield check_cell(
                thrust[first].this_study_n,
                Interval(other.value, other.value),
                other.value,
                source=source,
                row=thrust[first].thruster,
                column="this_study_n",
                rule=f"equal to {thrust[second].thruster}: they fire as a couple",
            )


def observation_checks(constants: Constants) -> Iterator[Check]:
    """Figures of paper 004 section VII that follow from its Table 1, and its two dates."""
    table, text = "paper_004_table_1", "paper_004_text"
    thrust = constants.number(table, "thrust_n")
    mass = constants.number(table, "mass_kg")
    isp = constants.value(table, "specific_impulse_s")
    gravity = constants.value(text, "gravity_m_s2")
    on_time = constants.number(text, "total_on_time_s")
    duration_h = constants.value(text, "sequence_s") / 3600.0
    moments = constants.vector(table, "moment_of_inertia_kg_m2")
    acceleration = constants.vector(table, "profile_acceleration_mrad_s2")
    exhaust = isp * gravity
    grams = thrust.interval * on_time.interval
    nominal_g = 1e3 * thrust.value * on_time.value / exhaust
    speed = constants.number(text, "delta_v_z_mm_s")

    # eq. 5: the Y disturbance of every X or Z step is removed with lever arm L
    impulse = [
        constants.value(text, "steps")
        * math.sqrt(acceleration[axis].value * constants.value(text, f"step_{name}_mrad"))
        * 1e-3
        for axis, name in ((0, "x"), (2, "z"))
    ]
    lever = constants.value(text, "moment_arm_m")
    coupling = constants.number(text, "cross_coupling")
    factor = 2e3 * sum(impulse) / (exhaust * lever)
    bound = (moments[1].interval * coupling.interval).scaled(factor)

    rows: tuple[tuple[str, Interval, float, str], ...] = (
        ("exhaust_velocity_m_s", Interval(exhaust, exhaust), exhaust, "Isp × gravity"),
        (
            "hydrazine_g",
            grams.scaled(1e3 / exhaust),
            nominal_g,
            "thrust × on-time / (Isp × gravity)",
        ),
        (
            "hydrazine_g_per_hour",
            grams.scaled(1e3 / exhaust / duration_h),
            nominal_g / duration_h,
            "hydrazine / duration",
        ),
        (
            "on_time_from_delta_v_s",
            mass.interval * speed.interval.scaled(1e-3) / thrust.interval,
            mass.value * speed.value * 1e-3 / thrust.value,
            "mass × ΔVz / thrust",
        ),
        (
            "moment_ratio_x_to_z",
            moments[0].interval / moments[2].interval,
            moments[0].value / moments[2].value,
            "Ixx / Izz",
        ),
        ("hydrazine_bound_g", bound, moments[1].value * coupling.value * factor, "eq. 5"),
    )
    for key, interval, nominal, rule in rows:
        yield check_cell(
            constants.number(text, key),
            interval,
            nominal,
            source="004 text",
            row=key,
            column="",
            rule=rule,
        )
    elsewhere = constants.date("paper_000_text", "rwa4_articulation")
    for column, key in (("section II", "section_2"), ("section V", "section_5")):
        printed = float((constants.date(text, f"rwa4_articulation_{key}") - elsewhere).days)
        yield Check(
            "004 text",
            "",
            "rwa4_articulation",
            column,
            "days after the date that paper 000 gives",
            Interval(printed, printed),
            Interval(0.0, 0.0),
            printed,
            0.0,
        )
