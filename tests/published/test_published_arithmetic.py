"""The tables' own arithmetic: which cells contradict it, and that a wrong cell would be seen."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from decimal import Decimal
from types import MappingProxyType

import numpy as np
import pytest

from cassini_bayes.errors import InputError
from cassini_bayes.published import tables as source_tables
from cassini_bayes.published.arithmetic import Published, all_checks, published
from cassini_bayes.published.arithmetic_000 import impulse_ratio
from cassini_bayes.published.arithmetic_001 import wheel_bias_checks
from cassini_bayes.published.checks import contradictions, percent_difference
from cassini_bayes.published.constants import parse_constants
from cassini_bayes.published.printed import Interval, Printed, package_text
from cassini_bayes.published.wheel_bias import WheelBiasTable


def test_contradicting_cells_are_exactly_these() -> None:
    """The complete list of printed figures that no unrounded operands can give."""
    found = [
        (
            *(c.source, c.event, c.row, c.column, c.printed.nominal),
            *(c.recomputed.interval.low, c.recomputed.interval.high),
        )
        for c in contradictions(all_checks(published()))
    ]
    expected = [
        ("000 text", "", "xx", "eqs. 1, 8", 3.0, 1.7649, 1.7672),
        ("000 text", "post_probe", "yy", "error_percent", 0.65, 0.725, 0.735),
        *(
            ("000 Table 2", f"day {day}", "year", "header", 2004.0, 2005.0, 2005.0)
            for day in (28, 49, 61, 71, 94)
        ),
        ("000 text", "", "thrust_probe_relay_n", "", 0.69, 0.6985, 0.6995),
        ("001 Table 3.b", "2009-10-05-bias", "delta_v_z", "calibrated", -15.60, -15.4677, -15.4463),
        ("004 text", "", "rwa4_articulation", "section V", 5.0, 0.0, 0.0),
    ]
    assert [f[:4] for f in found] == [e[:4] for e in expected]
    for got, want in zip(found, expected, strict=True):
        assert got[4:] == pytest.approx(want[4:], abs=1e-4)


def test_every_table_is_covered() -> None:
    """The number of re-computed figures per table; only two of all cannot fail."""
    checks = all_checks(published())
    counts = Counter(check.source for check in checks)
    # 3 rate sizes, 4 totals, 4 magnitudes, 18 differences, 18 percentages, 2 dates, 1 ΔV rule
    assert {counts[f"001 Table 3.{letter}"] for letter in "abcdefgh"} == {50}
    assert counts == {f"001 Table 3.{letter}": 50 for letter in "abcdefgh"} | {
        "001 text": 3,
        "000 eq. 1": 3,
        "000 eq. 8": 3,
        "002 eq. 1": 12,
        "002 eq. 4": 12,
        "000 text": 22,
        "000 Table 1": 18,
        "000 Table 2": 15,
        "000 text, day 28": 10,
        "000 Table A1": 3,
        "003 Table 1": 6,
        "003 Table 2": 10,
        "004 text": 8,
    }
    assert (len(checks), sum(c.matches_printed_operands for c in checks)) == (525, 447)
    # a percentage of a ΔV that printed as 0.00 may be anything
    assert [(c.source, c.row, c.column) for c in checks if not c.can_fail] == [
        ("001 Table 3.b", "delta_v_y", "pct_abs_diff"),
        ("001 Table 3.c", "delta_v_x", "pct_abs_diff"),
    ]


def test_published_skill_is_the_mean_over_thruster_rows() -> None:
    """0.59 s, 0.79 mm/s, 1.05 g: exact means over six on-time rows, ΔVz and hydrazine."""
    exact = {c.row: c for c in all_checks(published()) if c.source == "001 text"}
    assert exact["on_time_s"].recomputed.nominal == pytest.approx(28.25 / 48)  # 0.5885
    assert exact["delta_v_z_mm_s"].recomputed.nominal == pytest.approx(6.33 / 8)  # 0.79125
    assert exact["hydrazine_g"].recomputed.nominal == pytest.approx(8.4 / 8)  # 1.05
    assert all(c.matches_printed_operands for c in exact.values())
    # the totals or the Z thrusters alone would not round to 0.59
    tables = published().wheel_bias
    totals = [t.cell("on_time_z_total", "abs_diff").value for t in tables]
    singles = [t.cell(f"on_time_z{n}", "abs_diff").value for t in tables for n in (1, 2, 3, 4)]
    assert np.mean(totals) == pytest.approx(2.41625)
    assert np.mean(singles) == pytest.approx(0.7078125)


def test_calibration_scales_all_z_on_times_alike_but_in_table_3b() -> None:
    """Calibrated over ideal: 1.394 for ΔVz everywhere, for on-times everywhere but in 3.b."""
    on_time, speed = {}, {}
    for table in published().wheel_bias:
        for row, into in (("on_time_z_total", on_time), ("delta_v_z", speed)):
            ideal, calibrated = table.cell(row, "ideal"), table.cell(row, "calibrated")
            into[table.table] = calibrated.interval / ideal.interval
    odd = on_time.pop("3.b")
    common = Interval(max(i.low for i in on_time.values()), min(i.high for i in on_time.values()))
    assert (common.low, common.high) == pytest.approx((1.3942, 1.3946), abs=5e-5)
    assert not odd.meets(common)
    assert odd.high < 1.382
    assert all(ratio.meets(common) for ratio in speed.values())


# Cells of Tables 3.a–3.h that no relation between printed cells reaches.
UNREACHED = {
    ("thrust", "all_columns"),
    ("duration", "all_columns"),
    *((f"on_time_{pair}", column) for pair in ("y1_y3", "y2_y4") for column in ("ideal", "fsds")),
    *((f"pulses_{n}", "fsds") for n in ("y1_y3", "y2_y4", "z1", "z2", "z3", "z4")),
    ("hydrazine", "ideal"),
    ("hydrazine", "fsds"),
}
# Cells that a shift of 37 units of the last digit reaches in some tables only: small components
# that hardly change the length of ΔV, and percentages of figures close to zero.
PARTLY = {
    ("delta_v_x", "ideal"),
    ("delta_v_x", "fsds"),
    ("delta_v_y", "ideal"),
    ("delta_v_y", "fsds"),
    ("delta_v_x", "pct_abs_diff"),
    ("delta_v_y", "pct_abs_diff"),
    ("pulses_y1_y3", "pct_abs_diff"),
}


def _shifted(cell: Printed) -> Printed:
    exponent = cell.decimal.as_tuple().exponent
    assert isinstance(exponent, int)
    return replace(cell, text=str(cell.decimal + Decimal(37).scaleb(exponent)))


def _with_cell(table: WheelBiasTable, key: tuple[str, str], cell: Printed) -> WheelBiasTable:
    return replace(table, cells=MappingProxyType({**table.cells, key: cell}))


def test_a_corrupted_cell_is_seen() -> None:
    """Shift every cell of the eight tables in turn: all that have arithmetic are reported."""
    data = published()
    unseen: Counter[tuple[str, str]] = Counter()
    total = 0
    for table in data.wheel_bias:
        # one table at a time is enough, and quick
        base = set(contradictions(wheel_bias_checks([table], data.constants)))
        for key, cell in table.cells.items():
            changed = _with_cell(table, key, _shifted(cell))
            total += 1
            # the text's means need all eight tables
            checks = wheel_bias_checks([changed], data.constants)
            seen = {c for c in contradictions(checks) if c.source != "001 text"}
            unseen[key] += not seen - base
    missed = {key: count for key, count in unseen.items() if count}
    assert {key for key, count in missed.items() if count == 8} == UNREACHED
    assert {key for key, count in missed.items() if count < 8} == PARTLY
    assert (total, sum(missed.values())) == (902, 141)


def test_the_smallest_visible_slip_is_seen() -> None:
    """0.03 s in one on-time of Table 3.a is reported; 0.01 s is within the rounding."""
    data = published()
    table = data.wheel_bias[0]

    def slips(text: str) -> set[str]:
        cell = replace(table.cell("on_time_z1", "flight"), text=text)
        changed = _with_cell(table, ("on_time_z1", "flight"), cell)
        found = contradictions(wheel_bias_checks([changed], data.constants))
        return {c.row for c in found if c.source == "001 Table 3.a"}

    assert slips("23.44") == set()
    assert "on_time_z1" in slips("23.46")


@pytest.mark.parametrize(
    ("build", "source"),
    [
        (
            lambda d: replace(d, tensors=_edit("inertia_tensors.csv", "-144,7922", "-145,7922")),
            "000 eq. 8",
        ),
        (
            lambda d: replace(
                d, comparisons=_edit("inertia_000_table_1.csv", "4223,+5.08", "4323,+5.08")
            ),
            "000 Table 1",
        ),
        (
            lambda d: replace(d, comparisons=_edit("inertia_000_table_1.csv", ",+24", ",-24")),
            "000 Table 1",
        ),
        (
            lambda d: replace(d, bias_thrusts=_edit("thrust_000_table_2.csv", "0.695", "0.659")),
            "000 Table 2",
        ),
        (
            lambda d: replace(d, day_28=_edit("pulses_000_day_28.csv", "1.72,115", "1.72,151")),
            "000 text, day 28",
        ),
        (
            lambda d: replace(d, torques=_edit("torque_000_table_a1.csv", "-2.11", "-2.21")),
            "000 Table A1",
        ),
        (
            lambda d: replace(d, a_branch=_edit("thrust_003_table_1.csv", ",6.3", ",-6.3")),
            "003 Table 1",
        ),
        (
            lambda d: replace(d, b_branch=_edit("thrust_003_table_2.csv", ",4.3", ",-4.3")),
            "003 Table 2",
        ),
        (lambda d: replace(d, constants=_constants("1.3406", "1.3460")), "000 text"),
        (
            lambda d: replace(d, constants=_constants("on_time_s = 0.59", "on_time_s = 0.71")),
            "001 text",
        ),
        (
            lambda d: replace(d, constants=_constants("mass_kg = 2292.2", "mass_kg = 2922.2")),
            "004 text",
        ),
        (lambda d: replace(d, constants=_constants("= 1.23 ", "= 1.32 ")), "000 text, day 28"),
    ],
)
def test_a_corrupted_figure_of_the_other_tables_is_seen(
    build: Callable[[Published], Published], source: str
) -> None:
    """One slip per table, of the kind a typist makes, adds a contradiction of that table."""
    data = published()
    before = set(contradictions(all_checks(data)))
    added = set(contradictions(all_checks(build(data)))) - before
    assert source in {c.source for c in added}


def test_published_impulse_ratios() -> None:
    """Closed form against the printed 1.395 and 1.198, and its limit for a long pulse."""
    width, delay, rise, fall = 0.125, 0.005, 0.020, 0.065
    assert impulse_ratio(width, delay, rise, fall) == pytest.approx(1.3946, abs=5e-5)
    assert impulse_ratio(0.250, delay, rise, fall) == pytest.approx(1.1977, abs=5e-5)
    # long pulses: the rise costs τr e^(−τd/τr), the tail gives τf
    assert (impulse_ratio(5.0, delay, rise, fall) - 1) * 5.0 == pytest.approx(
        fall - rise * np.exp(-delay / rise), abs=1e-12
    )


def test_percent_interval_against_brute_force() -> None:
    """Exact corners against a fine grid of unrounded figures that print as the three cells."""
    reference, other, difference = (
        Interval(0.625, 0.635),
        Interval(0.115, 0.125),
        Interval(0.495, 0.505),
    )
    r, o = np.meshgrid(np.linspace(0.625, 0.635, 801), np.linspace(0.115, 0.125, 801))
    keep = (abs(r - o) >= 0.495 - 1e-12) & (abs(r - o) <= 0.505 + 1e-12)
    percent = (100 * abs(r - o) / r)[keep]
    found = percent_difference(reference, other, difference)
    assert found is not None
    assert found.low == pytest.approx(percent.min(), abs=2e-3)
    assert found.high == pytest.approx(percent.max(), abs=2e-3)
    assert percent_difference(reference, other, Interval(0.6, 0.7)) is None
    assert percent_difference(Interval(-0.01, 0.01), other, difference) == Interval(0.0, np.inf)
    assert percent_difference(-reference, -other, difference) == found


def test_interval_arithmetic_encloses_every_sample() -> None:
    """Sums, products and quotients of points lie in those of their intervals; bad ends raise."""
    rng = np.random.default_rng(5)
    ends = np.sort(rng.uniform(-3, 3, (200, 2, 2)), axis=-1)
    for (a_low, a_high), (b_low, b_high) in ends:
        a, b = Interval(a_low, a_high), Interval(b_low, b_high)
        x, y = rng.uniform(a_low, a_high), rng.uniform(b_low, b_high)
        for interval, value in ((a + b, x + y), (a - b, x - y), (a * b, x * y), (a / b, x / y)):
            assert interval.low - 1e-12 <= value <= interval.high + 1e-12
    with pytest.raises(InputError, match="low ≤ high"):
        Interval(1.0, 0.0)
    with pytest.raises(InputError, match="low ≤ high"):
        Interval(float("nan"), 0.0)
    assert not Interval(0.0, 1.0).meets(Interval(1.1, 2.0))
    assert Interval(0.0, 1.0).meets(Interval(1.0, 2.0))


def _edit(name: str, old: str, new: str) -> object:
    text = package_text(name)
    assert old in text
    parsers: dict[str, Callable[[str], object]] = {
        "inertia_tensors.csv": source_tables.inertia_tensors,
        "inertia_000_table_1.csv": source_tables.inertia_comparisons,
        "thrust_000_table_2.csv": source_tables.bias_thrusts,
        "pulses_000_day_28.csv": source_tables.day_28_pulses,
        "torque_000_table_a1.csv": source_tables.torque_estimates,
        "thrust_003_table_1.csv": source_tables.a_branch_thrusts,
        "thrust_003_table_2.csv": source_tables.b_branch_thrusts,
    }
    return parsers[name](text.replace(old, new, 1))


def _constants(old: str, new: str) -> object:
    text = package_text("constants.toml") + "\n"
    text = text.replace("share_percent = 1.23\n", "share_percent = 1.23 \n")
    assert old in text
    return parse_constants(text.replace(old, new, 1))
