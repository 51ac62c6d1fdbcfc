"""The arithmetic of papers 000 and 002, re-done with the rounding of every operand."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from functools import partial
from typing import Final

from cassini_bayes.published.checks import Check, Source, absolute
from cassini_bayes.published.constants import Constants
from cassini_bayes.published.printed import Interval, Operand, Printed, exactly
from cassini_bayes.published.tables import (
    AXES,
    ELEMENTS,
    BiasThrust,
    InertiaComparison,
    InertiaTensor,
    ThrusterPulses,
    TorqueEstimate,
)

_UPPER: Final = ("xx", "yy", "zz", "xy", "xz", "yz")
_MOMENTS: Final = ("xx", "yy", "zz")
_TEXT: Final = Source("000 text")


def impulse_ratio(width_s: float, delay_s: float, rise_s: float, fall_s: float) -> float:
    """Actual over rectangular impulse of one pulse, the closed form printed in paper 000 sec. V.

    [w + τf + τr (e^(−w/τr) − e^(−τd/τr)) − (τf + τd) e^(−w/τr)] / w with command width w.
    """
    decayed = math.exp(-width_s / rise_s)
    delayed = math.exp(-delay_s / rise_s)
    return (
        width_s + fall_s + rise_s * (decayed - delayed) - (fall_s + delay_s) * decayed
    ) / width_s


def _below(bound: float) -> Operand:
    """A size that is printed as below a bound."""
    return Operand(Interval(0.0, bound), bound)


def _exact(cell: Printed) -> Operand:
    """A cell that another one has to repeat digit by digit."""
    return exactly(cell.value)


def tensor_checks(tensors: Sequence[InertiaTensor], constants: Constants) -> Iterator[Check]:
    """Symmetry; the same tensors in papers 000 and 002; the offsets that paper 000 quotes."""
    for tensor in tensors:
        source = Source(f"{tensor.paper} eq. {tensor.equation}")
        for element in ("yx", "zx", "zy"):
            cell, mirror = tensor.elements[element], tensor.elements[element[::-1]]
            yield source.check("symmetric", cell, _exact(mirror), element, tensor.kind)
    first = {(t.paper, t.kind): t for t in tensors}
    for kind in ("predicted", "estimated"):
        source, rule = (
            Source(f"002 eq. {first['002', kind].equation}"),
            "same tensor as in paper 000",
        )
        for element in ELEMENTS:
            cell, other = (first[paper, kind].elements[element] for paper in ("002", "000"))
            yield source.check(rule, cell, _exact(other), element, kind)
    quoted = constants.number("paper_000_text", "inertia_offset_percent")
    bound = constants.value("paper_000_text", "product_of_inertia_offset_below_kg_m2")
    for element in _UPPER:
        p, e = (first["000", kind].elements[element].operand for kind in ("predicted", "estimated"))
        if element in _MOMENTS:
            rule, offset = "moment lower by nearly 3 % (2.5 to 3.5)", (p - e).scaled(100.0) / p
            yield _TEXT.check(rule, quoted, offset, element, "eqs. 1, 8")
        else:
            rule, offset = "products within 40 kg m²", absolute(p - e)
            yield _TEXT.check(rule, _below(bound), offset, element, "eqs. 1, 8")


def comparison_checks(rows: Sequence[InertiaComparison], constants: Constants) -> Iterator[Check]:
    """Table 1: eqs. 12 and 13 in every cell, and the bounds that the text states."""
    for row in rows:
        source = Source("000 Table 1", row.window)
        p, e = row.predicted_kg_m2.operand, row.estimated_kg_m2.operand
        if row.error_percent is not None:
            # 100 (1 − e/p): p enters once, so the interval is exact (p > 0)
            error = (exactly(1.0) - e / p).scaled(100.0)
            rule = "100 (predicted − estimated) / predicted (eq. 12)"
            yield source.check(rule, row.error_percent, error, row.element, "error_percent")
        if row.error_kg_m2 is not None:
            rule = "predicted − estimated (eq. 13)"
            yield source.check(rule, row.error_kg_m2, p - e, row.element, "error_kg_m2")
    for row in rows:
        if row.error_percent is None:
            continue
        if row.element in ("xx", "yy"):
            key = "table_1_x_y_error_below_percent"
        elif (row.window, row.element) == ("post_probe", "zz"):
            key = "table_1_z_post_probe_error_below_percent"
        else:
            continue
        yield Source("000 text", row.window).check(
            "error of Table 1 below 0.65 %",
            _below(constants.value("paper_000_text", key)),
            absolute(row.error_percent.operand),
            row.element,
            "error_percent",
        )


def thrust_checks(
    rows: Sequence[BiasThrust], pulses: Sequence[ThrusterPulses], constants: Constants
) -> Iterator[Check]:
    """Ratio R of section V, the FSDS case, Table 2 divided by R, the pulses of day 28."""
    timing = {
        name: constants.value("paper_000_pulse", f"tau_{name}_ms") / 1e3
        for name in ("delay", "rise", "fall", "fall_flight")
    }

    def ratio_of(width_s: float, fall: str = "fall") -> float:
        return impulse_ratio(width_s, timing["delay"], timing["rise"], timing[fall])

    fsds = partial(constants.number, "paper_000_fsds")
    for key, ratio in (
        ("ratio_125_ms_tau_fall_65_ms", ratio_of(0.125)),
        ("ratio_250_ms_tau_fall_65_ms", ratio_of(0.250)),
        ("ratio_125_ms_tau_fall_40_ms", ratio_of(0.125, "fall_flight")),
    ):
        printed = constants.number("paper_000_pulse", key)
        yield _TEXT.check("closed form of the impulse", printed, exactly(ratio), key)
    seconds = {w / 1e3: w / 1e3 * fsds(f"pulses_{w}_ms").value for w in (125, 250, 500, 750)}
    commanded = sum(seconds.values())
    actual = sum(on_time * ratio_of(width) for width, on_time in seconds.items())
    ratio_cell, naive = fsds("impulse_ratio"), fsds("estimated_thrust_n")
    for key, computed, rule in (
        ("on_time_y2_s", exactly(commanded), "sum of pulse widths"),
        ("impulse_ratio", exactly(actual / commanded), "closed form over all pulses"),
        ("corrected_thrust_n", naive.operand / ratio_cell.operand, "estimated thrust / ratio"),
    ):
        yield _TEXT.check(rule, fsds(key), computed, key)
    for row in rows:
        source = Source("000 Table 2", f"day {row.day_of_year}")
        for ms, cell in (
            (65, row.adjusted_tau_decay_65_ms_n),
            (40, row.adjusted_tau_decay_40_ms_n),
        ):
            divisor = constants.number("paper_000_pulse", f"ratio_125_ms_tau_fall_{ms}_ms")
            thrust = row.unadjusted_n.operand / divisor.operand
            column = f"adjusted_tau_decay_{ms}_ms_n"
            yield source.check("unadjusted / R", cell, thrust, "thrust", column)
    yield from _pulse_checks(pulses, constants)


def _pulse_checks(pulses: Sequence[ThrusterPulses], constants: Constants) -> Iterator[Check]:
    """Check that whole numbers of pulses give the mean sizes, and the share of Y2 and Y4."""
    source = Source("000 text, day 28")
    on_time = {item.thruster: item.on_time_s.operand for item in pulses}
    for item in pulses:
        count = max(1, round(item.on_time_s.value * 1e3 / item.mean_pulse_ms.value))
        size = on_time[item.thruster].scaled(1e3 / count)
        rule = "on-time / whole number of pulses"
        yield source.check(rule, item.mean_pulse_ms, size, item.thruster, "mean_pulse_ms")
    total = sum(on_time.values(), exactly(0.0))
    printed = constants.number("paper_000_text", "day_28_y2_share_percent")
    for name in ("y2", "y4"):
        share, rule = on_time[name].scaled(100.0) / total, "100 on-time / sum of all on-times"
        yield source.check(rule, printed, share, name, "share of on-time")


def torque_checks(rows: Sequence[TorqueEstimate]) -> Iterator[Check]:
    """Table A1: total = RTG + solar."""
    by_source = {row.source: row.torque_micro_n_m for row in rows}
    for axis in AXES:
        both = by_source["rtg"][axis].operand + by_source["solar"][axis].operand
        total = by_source["total"][axis]
        yield Source("000 Table A1").check("RTG + solar", total, both, "total", axis)


def text_checks(rows: Sequence[BiasThrust], constants: Constants) -> Iterator[Check]:
    """Masses add up; the year of Table 2; the thrust at Probe relay against Table 2."""
    number = partial(constants.number, "paper_000_text")
    spent = number("mass_before_soi_kg").operand - number("mass_after_soi_kg").operand
    parts = [number(f"launch_{name}_kg") for name in ("oxidizer", "fuel", "hydrazine", "dry")]
    launched = sum((part.operand for part in parts), exactly(0.0))
    for key, mass, rule in (
        ("soi_propellant_kg", spent, "mass before − after orbit insertion"),
        ("launch_mass_kg", launched, "sum of the parts"),
    ):
        yield _TEXT.check(rule, number(key), mass, key)
    ejection = constants.date("paper_000_text", "probe_ejection")
    year, rule = _exact(number("table_2_year")), "first such day after Probe ejection"
    for row in rows:
        source = Source("000 Table 2", f"day {row.day_of_year}")
        first_year = float(ejection.year + (row.day_of_year <= ejection.timetuple().tm_yday))
        yield source.check(rule, year, exactly(first_year), "year", "header")
    key, rule = "thrust_probe_relay_n", "predicted thrust of Table 2, days after the relay"
    yield _TEXT.check(rule, number(key), rows[0].predicted_n.operand, key)
