"""The arithmetic of papers 003 and 004, re-done with the rounding of every operand."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from functools import partial

from cassini_bayes.published.checks import Check, Source
from cassini_bayes.published.constants import Constants
from cassini_bayes.published.printed import exactly
from cassini_bayes.published.tables import ThrustComparison


def thrust_comparison_checks(
    a_branch: Sequence[ThrustComparison], b_branch: Sequence[ThrustComparison]
) -> Iterator[Check]:
    """Percentages of Tables 1 and 2, and equal thrusts within every Y couple.

    The base differs: Table 1 prints (navigation − study)/study, Table 2 (study − flight
    software)/flight software.
    """
    for source, rows, study_is_base, rule in (
        (Source("003 Table 1"), a_branch, True, "100 (navigation − study) / study"),
        (Source("003 Table 2"), b_branch, False, "100 (study − flight software) / flight software"),
    ):
        for row in rows:
            if row.other_n is None or row.difference_percent is None:
                continue
            study, other = row.this_study_n.operand, row.other_n.operand
            ratio = other / study if study_is_base else study / other
            excess, column = (ratio - exactly(1.0)).scaled(100.0), "difference_percent"
            yield source.check(rule, row.difference_percent, excess, row.thruster, column)
        thrust = {row.thruster[:2]: row for row in rows}
        for first, second in (("y1", "y3"), ("y2", "y4")):
            one, same = thrust[first], thrust[second]
            expected, column = exactly(same.this_study_n.value), "this_study_n"
            rule_of_couple = f"equal to {same.thruster}: they fire as a couple"
            yield source.check(rule_of_couple, one.this_study_n, expected, one.thruster, column)


def observation_checks(constants: Constants) -> Iterator[Check]:
    """Figures of paper 004 section VII that follow from its Table 1, and its two dates."""
    table, text = "paper_004_table_1", "paper_004_text"
    figure, value = partial(constants.number, text), partial(constants.value, text)
    thrust = constants.number(table, "thrust_n").operand
    mass = constants.number(table, "mass_kg").operand
    exhaust = constants.value(table, "specific_impulse_s") * value("gravity_m_s2")
    moments = [one.operand for one in constants.vector(table, "moment_of_inertia_kg_m2")]
    acceleration = constants.vector(table, "profile_acceleration_mrad_s2")
    grams = (thrust * figure("total_on_time_s").operand).scaled(1e3 / exhaust)
    speed = figure("delta_v_z_mm_s").operand.scaled(1e-3)

    # eq. 5: the Y disturbance of every X or Z step is removed with lever arm L
    impulse = [
        value("steps") * math.sqrt(acceleration[axis].value * value(f"step_{name}_mrad")) * 1e-3
        for axis, name in ((0, "x"), (2, "z"))
    ]
    factor = 2e3 * sum(impulse) / (exhaust * value("moment_arm_m"))
    bound = (moments[1] * figure("cross_coupling").operand).scaled(factor)

    source, hours = Source("004 text"), value("sequence_s") / 3600.0
    for key, computed, rule in (
        ("exhaust_velocity_m_s", exactly(exhaust), "Isp × gravity"),
        ("hydrazine_g", grams, "thrust × on-time / (Isp × gravity)"),
        ("hydrazine_g_per_hour", grams.scaled(1.0 / hours), "hydrazine / duration"),
        ("on_time_from_delta_v_s", mass * speed / thrust, "mass × ΔVz / thrust"),
        ("moment_ratio_x_to_z", moments[0] / moments[2], "Ixx / Izz"),
        ("hydrazine_bound_g", bound, "eq. 5"),
    ):
        yield source.check(rule, figure(key), computed, key)
    elsewhere = constants.date("paper_000_text", "rwa4_articulation")
    rule = "days after the date that paper 000 gives"
    for column, key in (("section II", "section_2"), ("section V", "section_5")):
        later = constants.date(text, f"rwa4_articulation_{key}") - elsewhere
        printed = exactly(float(later.days))
        yield source.check(rule, printed, exactly(0.0), "rwa4_articulation", column)
