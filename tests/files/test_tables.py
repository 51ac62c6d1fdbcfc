"""CSV text of tables: numbers as they are, names that no spreadsheet runs."""

from __future__ import annotations

import csv
import io
import json

import numpy as np
import pandas as pd
import pytest

from cassini_bayes.files.tables import frame_csv, frame_records, inert, rows_csv

FORMULAE = ["=cmd|' /C calc'!A0", "+1+1", "-1+cmd|x", "@SUM(A1)", "\t=1", "\n=1"]


@pytest.mark.parametrize("text", FORMULAE)
def test_a_formula_is_led_by_an_apostrophe(text: str) -> None:
    """In cells, headers and the index, of frames and of rows."""
    frame = pd.DataFrame({"id": [text, "a"], text: [1.5, -2.0]}, index=[text, "b"])
    for content in (frame_csv(frame, index=True), rows_csv([[text, 1], ["a", text]])):
        cells = [cell for row in csv.reader(io.StringIO(content, newline="")) for cell in row]
        assert f"'{text}" in cells
        assert text not in cells


@pytest.mark.parametrize("cell", ["-1118", "+4.3", "-1e-5", "-inf", "a=b", "", -5.0, 3, None])
def test_other_cells_stay(cell: object) -> None:
    """Negative control: numbers of either sign, names, empty cells."""
    assert inert(cell) is cell


def test_a_frame_of_numbers_and_names_is_as_pandas_writes_it() -> None:
    """Byte for byte, with all digits and with six."""
    rng = np.random.default_rng(3)
    frame = pd.DataFrame(
        {
            "name": ["a", "b", None],
            "x": rng.normal(size=3),
            "n": [1, 2, 3],
            "ok": [True] * 3,
        }
    )
    assert frame_csv(frame) == frame.to_csv(index=False)
    assert frame_csv(frame, digits=6) == frame.to_csv(index=False, float_format="%.6g")
    assert frame_csv(frame, index=True) == frame.to_csv()
    assert rows_csv([["a", 1.5], ["b", -2]]) == "a,1.5\nb,-2\n"


def test_records_keep_every_digit() -> None:
    """Small torques and biases are numbers too; what is not finite is null."""
    frame = pd.DataFrame({"name": ["a", "b"], "mean": [4.4e-11, np.nan], "count": [1, 2]})
    assert frame_records(frame) == [
        {"name": "a", "mean": 4.4e-11, "count": 1},
        {"name": "b", "mean": None, "count": 2},
    ]
    again = json.loads(json.dumps(frame_records(frame)))
    assert again[0]["mean"] == 4.4e-11
