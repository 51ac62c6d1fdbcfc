"""The transcription: readable, complete, unchanged, and turned into totals events without loss."""

from __future__ import annotations

import csv
import datetime
import hashlib
from io import StringIO

import pytest

from cassini_bayes.errors import InputError
from cassini_bayes.published.constants import parse_constants, published_constants
from cassini_bayes.published.printed import package_text, parse_printed
from cassini_bayes.published.tables import (
    a_branch_thrusts,
    b_branch_thrusts,
    bias_thrusts,
    day_28_pulses,
    inertia_comparisons,
    inertia_tensors,
    perturbations,
    torque_estimates,
)
from cassini_bayes.published.totals import totals_csv
from cassini_bayes.published.wheel_bias import (
    COMPARED_ROWS,
    ROWS,
    VALUE_COLUMNS,
    parse_wheel_bias_tables,
    wheel_bias_tables,
)

# SHA-256 of every data file after it was read twice against the papers. Simulation and ideal
# figures enter no arithmetic of the tables, so only this notices a slip in them.
DIGESTS = {
    "constants.toml": "54f4f49dbce9a1f76cc3f25f3a93b5f69c53c75e47723fced10d455b11289803",
    "events_3a_3h.csv": "b22be9bd36ad2d0fa6c7acfc27685ae471c93dafdb44fce75754dff650d8ce4a",
    "flight_2009_2010.csv": "0cf008b365cca7251e2ef4fff9ad899d63aa73c17c953ecbf16c608f4c2ec3b7",
    "inertia_000_table_1.csv": "e019d6ea8cd96ae532be8690f8b02917c9f76a4722855638b3c37b9d30d4571c",
    "inertia_tensors.csv": "3fe4626d3426bc21326b12942981a1185f86c0009e454bf264c75bb230cd3a4e",
    "perturbations_003.csv": "cfa503ecdb9273dd5ef946b31ca0f6568dc4d40f8039e7cc8c3459a681b2ca3a",
    "pulses_000_day_28.csv": "1cb1c06729f472e1d40acd38542e2354fe2da97c347d087d3e12ef38bc995510",
    "tables_3a_3h.csv": "2f629d9adc16d012218aa131c47b34ce4af57cf211f0c26308ddd00e7e82198e",
    "thrust_000_table_2.csv": "f61b8f50cdd7282b54184cd2ca1a8b9c9ddcc04694efb36077c205f3da37e15b",
    "thrust_003_table_1.csv": "bcea47f55628c19c8c2a1b339f59d5327e305adc10ef1e31d422fb4020ad5bfa",
    "thrust_003_table_2.csv": "b8fed1877a02b597cf11263440a20b5c0f2e137aa3c878a87b459fba4c6e4989",
    "torque_000_table_a1.csv": "7f53850a705bf82e321c2ff5ca847ff0127ab92f520965e339b19fb2556d9fa6",
}


@pytest.mark.parametrize("name", sorted(DIGESTS))
def test_data_files_are_those_that_were_proof_read(name: str) -> None:
    """A transcribed file changes only together with its digest here."""
    assert hashlib.sha256(package_text(name).encode()).hexdigest() == DIGESTS[name]


def test_wheel_bias_tables_are_complete() -> None:
    """Eight tables in order of date, 29 rows each, a figure or a dash where the paper has them."""
    tables = wheel_bias_tables()
    assert [t.table for t in tables] == [f"3.{letter}" for letter in "abcdefgh"]
    assert [t.header_date for t in tables] == sorted(t.header_date for t in tables)
    assert len(ROWS) == 29
    dashes = []
    for table in tables:
        for row in COMPARED_ROWS:
            for column in (*VALUE_COLUMNS, "abs_diff", "pct_abs_diff"):
                if table.get(row, column) is None and (column != "ideal" or "pulses" not in row):
                    dashes.append((table.table, row, column))
                if column == "ideal" and "pulses" in row:
                    assert table.get(row, column) is None
    assert dashes == [("3.g", "on_time_z1", "pct_abs_diff"), ("3.h", "on_time_z2", "pct_abs_diff")]


def test_flight_row_of_february_2010_as_typed_from_the_table() -> None:
    """One flight row, typed by hand from Table 3.d, in the totals format."""
    rows = list(csv.DictReader(StringIO(package_text("flight_2009_2010.csv"))))
    row = next(r for r in rows if (r["id"], r["source"]) == ("2010-02-13-bias", "flight"))
    mass = row.pop("mass_kg")
    assert float(mass) == pytest.approx(0.75 / (12.36 / 36.53 * 1e-3), rel=0.08)
    assert row == {
        "id": "2010-02-13-bias",
        "epoch": "2010-02-13T00:00:00Z",
        "branch": "B",
        "wheels": "1 2 4",
        "rwa1_rpm_start": "1078",
        "rwa2_rpm_start": "1146",
        "rwa3_rpm_start": "",
        "rwa4_rpm_start": "1047",
        "rwa1_rpm_end": "432",
        "rwa2_rpm_end": "-1293",
        "rwa3_rpm_end": "",
        "rwa4_rpm_end": "-508",
        "duration_s": "1440",
        "on_time_z1_s": "12.52",
        "on_time_z2_s": "2.50",
        "on_time_z3_s": "5.12",
        "on_time_z4_s": "16.39",
        "on_time_y1_s": "23.64",
        "on_time_y2_s": "1.38",
        "on_time_y3_s": "23.64",
        "on_time_y4_s": "1.38",
        "pulses_z1": "96",
        "pulses_z2": "19",
        "pulses_z3": "42",
        "pulses_z4": "121",
        "pulses_y1": "182",
        "pulses_y2": "7",
        "pulses_y3": "182",
        "pulses_y4": "7",
        "delta_v_x_m_s": "0.00002",
        "delta_v_y_m_s": "0.00001",
        "delta_v_z_m_s": "-0.01236",
        "hydrazine_g": "39.0",
        "thrust_predicted_n": "0.75",
        "delta_v_source": "computed",
        "source": "flight",
    }


def test_totals_file_is_generated_from_the_tables() -> None:
    """The committed totals file is the function of the tables, byte for byte, and no other."""
    text = package_text("flight_2009_2010.csv")
    assert totals_csv(wheel_bias_tables()) == text
    rows = list(csv.DictReader(StringIO(text)))
    assert len({(r["id"], r["source"]) for r in rows}) == len(rows) == 32
    ideal = [r for r in rows if r["source"] == "gsw_ideal"]
    assert all(r[c] == "" for r in ideal for c in r if c.startswith("pulses"))
    changed = package_text("tables_3a_3h.csv").replace("17.06", "17.60")
    other = parse_wheel_bias_tables(changed, package_text("events_3a_3h.csv"))
    assert totals_csv(other) != text


def test_other_tables_have_their_printed_figures() -> None:
    """Corner cells of every other table, typed by hand from the papers."""
    tensors = inertia_tensors()
    assert [t.elements["zz"].text for t in tensors] == ["4721.8", "4586.2", "4721.8", "4586.2"]
    comparisons = inertia_comparisons()
    assert len(comparisons) == 18
    assert (comparisons[10].window, comparisons[10].element) == ("post_prm", "xz")
    assert comparisons[10].estimated_kg_m2.value == 252.0
    assert comparisons[-1].slew_day == datetime.date(2005, 2, 9)
    thrusts = bias_thrusts()
    assert [t.day_of_year for t in thrusts] == [28, 49, 61, 71, 94]
    assert [t.unadjusted_n.value for t in thrusts] == [0.80, 0.79, 0.82, 0.81, 0.83]
    assert {t.predicted_n.value for t in thrusts} == {0.699}
    assert [p.mean_pulse_ms.value for p in day_28_pulses()] == [
        123,
        115,
        122,
        127,
        131,
        94,
        131,
        94,
    ]
    total = torque_estimates()[0]
    assert [total.torque_micro_n_m[axis].value for axis in "xyz"] == [-0.53, -2.11, 1.83]
    assert [t.this_study_n.value for t in a_branch_thrusts()] == [
        0.80,
        0.86,
        0.58,
        0.63,
        0.72,
        0.69,
        0.72,
        0.69,
    ]
    assert [t.this_study_n.value for t in b_branch_thrusts()] == [
        0.72,
        0.69,
        0.69,
        0.67,
        0.68,
        0.67,
        0.68,
        0.67,
    ]
    assert [p.error_percent for p in perturbations()] == [10, 5, 50, 1, 1, 1, 10]
    constants = published_constants()
    moments = constants.vector("paper_004_table_1", "moment_of_inertia_kg_m2")
    assert [m.value for m in moments] == [6558.0, 5393.0, 3518.0]
    assert constants.number("paper_000_fsds", "inertia_zz_kg_m2").text == "3829.70"


def test_rounding_steps_follow_the_printed_digits() -> None:
    """A figure stands for the values that print like it; counts and a bare zero are exact."""
    assert parse_printed("23.43", where="x").interval.half_width == pytest.approx(0.005)
    assert parse_printed("+1744", where="x").interval.half_width == 0.5
    table = wheel_bias_tables()[1]
    assert table.cell("on_time_z2", "ideal").step == 0.0
    assert table.cell("on_time_z2", "flight").step == 0.01
    assert table.cell("pulses_z1", "flight").step == 0.0
    assert table.cell("pulses_z1", "calibrated").step == 1.0


@pytest.mark.parametrize(
    ("old", "new", "named"),
    [
        ("event,table,row", "event,row,table", "header"),
        ("2009-08-22-bias,3.a,thrust,N", "2009-08-22-bias,3.a,thrust,kN", "line 2"),
        ("2009-08-22-bias,3.a,thrust,N", "2009-08-22-bias,3.a,push,N", "line 2"),
        ("2009-08-22-bias,3.a,thrust,N,0.77,,,,,,\n", "", "event 2009-08-22-bias"),
        ("23.43", "23,43", "line"),
        ("23.43", "n/a", "flight"),
        ("23.43", "nan", "flight"),
    ],
)
def test_damaged_tables_are_refused_with_their_place(old: str, new: str, named: str) -> None:
    """A header, row, unit or figure that is not as transcribed is an InputError naming it."""
    text = package_text("tables_3a_3h.csv")
    assert old in text
    with pytest.raises(InputError) as caught:
        parse_wheel_bias_tables(text.replace(old, new, 1), package_text("events_3a_3h.csv"))
    assert named in caught.value.where


def test_missing_cells_and_constants_are_named() -> None:
    """Asking for a dash, an absent constant or the wrong kind of one says what exists."""
    table = wheel_bias_tables()[6]
    with pytest.raises(InputError, match=r"Table 3\.g: on_time_z1, pct_abs_diff"):
        table.cell("on_time_z1", "pct_abs_diff")
    constants = published_constants()
    with pytest.raises(InputError, match="tau_delay_ms"):
        constants.number("paper_000_pulse", "tau_dealy_ms")
    with pytest.raises(InputError, match="a number"):
        constants.number("paper_000_text", "probe_ejection")
    with pytest.raises(InputError, match="a date"):
        constants.date("paper_000_pulse", "tau_delay_ms")
    with pytest.raises(InputError, match="a list"):
        constants.vector("paper_000_pulse", "tau_delay_ms")
    with pytest.raises(InputError, match="expected a number"):
        parse_constants('[a]\nb = "text"\n')
    with pytest.raises(InputError, match="header"):
        bias_thrusts("day,thrust\n")
