"""Made-up telemetry for the reader's tests: rows as text, so that any cell can be spoilt."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

from cassini_bayes.spacecraft import load_spacecraft

CASSINI = load_spacecraft("cassini")
THRUSTERS = ("z1", "z2", "z3", "z4", "y1", "y2", "y3", "y4")
BIAS = {
    "id": '"b"',
    "kind": '"bias"',
    "epoch": '"2010-02-13T12:00:00Z"',
    "branch": '"B"',
    "wheels": "[1, 2, 4]",
    "source": '"made up"',
}
SLEW = {**BIAS, "kind": '"slew"'}
MOTION = (
    "time_s",
    *("q1", "q2", "q3", "q4"),
    *(f"rate_{axis}_rad_s" for axis in "xyz"),
    *("rwa1_rpm", "rwa2_rpm", "rwa4_rpm"),
)
COUNTERS = tuple(f"on_time_{k}_s" for k in THRUSTERS) + tuple(f"pulses_{k}" for k in THRUSTERS)

Rows = list[dict[str, str]]
Change = Callable[[Rows], object]


def motion_rows(count: int = 40) -> Rows:
    """A slow turn about X with changing wheel rates, 1 Hz."""
    return [
        {
            "time_s": str(i),
            "q1": "0.6",
            "q2": "0",
            "q3": "0",
            "q4": "0.8",
            "rate_x_rad_s": f"{1e-5 * i:.7g}",
            "rate_y_rad_s": "-2e-06",
            "rate_z_rad_s": "0",
            "rwa1_rpm": f"{-1100.5 + i}",
            "rwa2_rpm": "1290",
            "rwa4_rpm": f"{330 - i}",
        }
        for i in range(count)
    ]


def bias_rows(count: int = 40) -> Rows:
    """The same with counters: every thruster fires one 125 ms pulse every second second."""
    rows = motion_rows(count)
    for i, row in enumerate(rows):
        for name in THRUSTERS:
            row[f"on_time_{name}_s"] = f"{0.125 * (i // 2):.10g}"
            row[f"pulses_{name}"] = str(i // 2)
    return rows


def csv_text(rows: Rows, separator: str = ",") -> str:
    """The rows as a CSV with a header row."""
    lines = [separator.join(rows[0])]
    lines += [separator.join(row.values()) for row in rows]
    return "\n".join(lines) + "\n"


def write_event(
    folder: Path, rows: Rows | str | bytes, description: Mapping[str, str] = BIAS
) -> Path:
    """An event folder; text and bytes stand as they are."""
    folder.mkdir(parents=True, exist_ok=True)
    text = "".join(f"{key} = {value}\n" for key, value in description.items())
    (folder / "event.toml").write_text(text, encoding="utf-8")
    content = rows if isinstance(rows, str | bytes) else csv_text(rows)
    data = content.encode() if isinstance(content, str) else content
    (folder / "telemetry.csv").write_bytes(data)
    return folder
