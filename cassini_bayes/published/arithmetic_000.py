"""The arithmetic of papers 000 and 002, re-done with the rounding of every operand."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Final

from cassini_bayes.published.checks import Check, absolute, check_cell
from cassini_bayes.published.constants import Constants
from cassini_bayes.published.printed import Interval, Printed
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


def impulse_ratio(width_s: float, delay_s: float, rise_s: float, fall_s: float) -> float:
    """Actual over rectangular impulse of one pulse, the closed form printed in paper 000 sec. V.

    [w + τf + τr (e^(−w/τr) − e^(−τd/τr)) − (τf + τd) e^(−w/τr)] / w with command width w.
    """
    decayed = math.exp(-width_s / rise_s)
    delayed = math.exp(-delay_s / rise_s)
    return (
        width_s + fall_s + rise_s * (decayed - delayed) - (fall_s + delay_s) * decayed
    ) / width_s


def _point(value: float) -> Interval:
    return Interval(value, value)


def tensor_checks(tensors: Sequence[InertiaTensor], constants: Constants) -> Iterator[Check]:
    """Symmetry; the same tensors in papers 000 and 002; the offsets that paper 000 quotes."""
    for tensor in tensors:
        for element in ("yx", "zx", "zy"):
            mirror = tensor.elements[element[::-1]]
            yield check_cell(
                tensor.elements[element],
                _point(mirror.value),
                mirror.value,
                source=f"{tensor.paper} eq. {tensor.equation}",
                row=element,
                column=tensor.kind,
                rule="symmetric",
            )
    first = {(t.paper, t.kind): t for t in tensors}
    for kind in ("predicted", "estimated"):
        for element in ELEMENTS:
            other = first["000", kind].elements[element]
            yield check_cell(
                first["002", kind].elements[element],
                _point(other.value),
                other.value,
                source=f"002 eq. {first['002', kind].equation}",
                row=element,
                column=kind,
                rule="same tensor as in paper 000",
            )
    predicted, estimated = first["000", "predicted"], first["000", "estimated"]
    quoted = constants.number("paper_000_text", "inertia_offset_percent")
    bound = constants.value("paper_000_text", "product_of_inertia_offset_below_kg_m2")
    for element in _UPPER:
        p, e = predicted.elements[element], estimated.elements[element]
        if element in _MOMENTS:
            yield check_cell(
                quoted,
                (p.interval - e.interval).scaled(100.0) / p.interval,
                100.0 * (p.value - e.value) / p.value,
                source="000 text",
                row=element,
                column="eqs. 1, 8",
                rule="moment lower by nearly 3 % (2.5 to 3.5)",
            )
        else:
            yield Check(
                "000 text",
                "",
                element,
                "eqs. 1, 8",
                "products within 40 kg m²",
                Interval(0.0, bound),
                absolute(p.interval - e.interval),
                bound,
                abs(p.value - e.value),
            )


def _relative_error(predicted: Interval, estimated: Interval) -> Interval:
    """100 (p − e)/p = 100 (1 − e/p): p enters once, so the interval is exact (p > 0)."""
    return (_point(1.0) - estimated / predicted).scaled(100.0)


def comparison_checks(rows: Sequence[InertiaComparison], constants: Constants) -> Iterator[Check]:
    """Table 1: eqs. 12 and 13 in every cell, and the bounds that the text states."""
    for row in rows:
        p, e = row.predicted_kg_m2, row.estimated_kg_m2
        if row.error_percent is not None:
            yield check_cell(
                row.error_percent,
                _relative_error(p.interval, e.interval),
                100.0 * (p.value - e.value) / p.value,
                source="000 Table 1",
                event=row.window,
                row=row.element,
                column="error_percent",
                rule="100 (predicted − estimated) / predicted (eq. 12)",
            )
        if row.error_kg_m2 is not None:
            yield check_cell(
                row.error_kg_m2,
                p.interval - e.interval,
                p.value - e.value,
                source="000 Table 1",
                event=row.window,
                row=row.element,
                column="error_kg_m2",
                rule="predicted − estimated (eq. 13)",
            )
    for row in rows:
        if row.error_percent is None:
            continue
        if row.element in ("xx", "yy"):
            key = "table_1_x_y_error_below_percent"
        elif (row.window, row.element) == ("post_probe", "zz"):
            key = "table_1_z_post_probe_error_below_percent"
        else:
            continue
        bound = constants.value("paper_000_text", key)
        error = row.error_percent
        yield Check(
            "000 text",
            row.window,
            row.element,
            "error_percent",
            "error of Table 1 below 0.65 %",
            Interval(0.0, bound),
            absolute(error.interval),
            bound,
            abs(error.value),
        )


def thrust_checks(
    rows: Sequence[BiasThrust], pulses: Sequence[ThrusterPulses], constants: Constants
) -> Iterator[Check]:
    """Ratio R of section V, the FSDS case, Table 2 divided by R, the pulses of day 28."""
    timing = {
        name: constants.value("paper_000_pulse", f"tau_{name}_ms") / 1e3
        for name in ("delay", "rise", "fall", "fall_flight")
    }
    source = "000 text"
    for key, width, fall in (
        ("ratio_125_ms_tau_fall_65_ms", 0.125, timing["fall"]),
        ("ratio_250_ms_tau_fall_65_ms", 0.250, timing["fall"]),
        ("ratio_125_ms_tau_fall_40_ms", 0.125, timing["fall_flight"]),
    ):
        ratio = impulse_ratio(width, timing["delay"], timing["rise"], fall)
        yield check_cell(
            constants.number("paper_000_pulse", key),
            _point(ratio),
            ratio,
            source=source,
            row=key,
            column="",
            rule="closed form of the impulse",
        )
    widths = (125, 250, 500, 750)
    counts = {w: constants.value("paper_000_fsds", f"pulses_{w}_ms") for w in widths}
    commanded = sum(n * w / 1e3 for w, n in counts.items())
    on_time = constants.number("paper_000_fsds", "on_time_y2_s")
    yield check_cell(
        on_time,
        _point(commanded),
        commanded,
        source=source,
        row="on_time_y2_s",
        column="",
        rule="sum of pulse widths",
    )
    actual = sum(
        n * w / 1e3 * impulse_ratio(w / 1e3, timing["delay"], timing["rise"], timing["fall"])
        for w, n in counts.items()
    )
    ratio_cell = constants.number("paper_000_fsds", "impulse_ratio")
    yield check_cell(
        ratio_cell,
        _point(actual / commanded),
        actual / commanded,
        source=source,
        row="impulse_ratio",
        column="",
        rule="closed form over all pulses",
    )
    naive = constants.number("paper_000_fsds", "estimated_thrust_n")
    yield check_cell(
        constants.number("paper_000_fsds", "corrected_thrust_n"),
        naive.interval / ratio_cell.interval,
        naive.value / ratio_cell.value,
        source=source,
        row="corrected_thrust_n",
        column="",
        rule="estimated thrust / ratio",
    )
    for row in rows:
        for column, cell, key in (
            (
                "adjusted_tau_decay_65_ms_n",
                row.adjusted_tau_decay_65_ms_n,
                "ratio_125_ms_tau_fall_65_ms",
            ),
            (
                "adjusted_tau_decay_40_ms_n",
                row.adjusted_tau_decay_40_ms_n,
                "ratio_125_ms_tau_fall_40_ms",
            ),
        ):
            divisor = constants.number("paper_000_pulse", key)
            yield check_cell(
                cell,
                row.unadjusted_n.interval / divisor.interval,
                row.unadjusted_n.value / divisor.value,
                source="000 Table 2",
                event=f"day {row.day_of_year}",
                row="thrust",
                column=column,
                rule="unadjusted / R",
            )
    yield from _pulse_checks(pulses, constants)


def _pulse_checks(pulses: Sequence[ThrusterPulses], constants: Constants) -> Iterator[Check]:
    """Check that whole numbers of pulses give the mean sizes, and the share of Y2 and Y4."""
    for item in pulses:
        count = max(1, round(item.on_time_s.value * 1e3 / item.mean_pulse_ms.value))
        yield check_cell(
            item.mean_pulse_ms,
            item.on_time_s.interval.scaled(1e3 / count),
            item.on_time_s.value * 1e3 / count,
            source="000 text, day 28",
            row=item.thruster,
            column="mean_pulse_ms",
            rule="on-time / whole number of pulses",
        )
    by_name = {item.thruster: item.on_time_s for item in pulses}
    parts = [cell.interval for cell in by_name.values()]
    total = sum(parts[1:], parts[0])
    nominal = sum(cell.value for cell in by_name.values())
    share = constants.number("paper_000_text", "day_28_y2_share_percent")
    for name in ("y2", "y4"):
        yield check_cell(
            share,
            by_name[name].interval.scaled(100.0) / total,
            100.0 * by_name[name].value / nominal,
            source="000 text, day 28",
            row=name,
            column="share of on-time",
            rule="100 on-time / sum of all on-times",
        )


def torque_checks(rows: Sequence[TorqueEstimate]) -> Iterator[Check]:
    """Table A1: total = RTG + solar."""
    by_source = {row.source: row.torque_micro_n_m for row in rows}
    for axis in AXES:
        rtg, solar = by_source["rtg"][axis], by_source["solar"][axis]
        yield check_cell(
            by_source["total"][axis],
            rtg.interval + solar.interval,
            rtg.value + solar.value,
            source="000 Table A1",
            row="total",
            column=axis,
            rule="RTG + solar",
        )


def text_checks(rows: Sequence[BiasThrust], constants: Constants) -> Iterator[Check]:
    """Masses add up; the year of Table 2; the thrust at Probe relay against Table 2."""
    section = "paper_000_text"

    def number(key: str) -> Printed:
        return constants.number(section, key)

    before, after = number("mass_before_soi_kg"), number("mass_after_soi_kg")
    yield check_cell(
        number("soi_propellant_kg"),
        before.interval - after.interval,
        before.value - after.value,
        source="000 text",
        row="soi_propellant_kg",
        column="",
        rule="mass before − after orbit insertion",
    )
    parts = [number(f"launch_{name}_kg") for name in ("oxidizer", "fuel", "hydrazine", "dry")]
    intervals = [part.interval for part in parts]
    yield check_cell(
        number("launch_mass_kg"),
        sum(intervals[1:], intervals[0]),
        sum(part.value for part in parts),
        source="000 text",
        row="launch_mass_kg",
        column="",
        rule="sum of the parts",
    )
    ejection = constants.date(section, "probe_ejection")
    printed_year = number("table_2_year").value
    for row in rows:
        first_year = float(ejection.year + (row.day_of_year <= ejection.timetuple().tm_yday))
        yield Check(
            "000 Table 2",
            f"day {row.day_of_year}",
            "year",
            "header",
            "first such day after Probe ejection",
            _point(printed_year),
            _point(first_year),
            printed_year,
            first_year,
        )
    predicted = rows[0].predicted_n
    yield check_cell(
        number("thrust_probe_relay_n"),
        predicted.interval,
        predicted.value,
        source="000 text",
        row="thrust_probe_relay_n",
        column="",
        rule="predicted thrust of Table 2, days after the relay",
    )
