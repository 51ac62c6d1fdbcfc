"""The recording of the tutorial: a simulated wheel bias, written the way a telemetry desk would.

    cassini-bayes simulate docs/examples/own_csv/scenario.toml --out build/own_csv --seed 4
    python docs/examples/own_csv/make_recording.py build/own_csv docs/examples/own_csv

Nothing of it follows this package's format: names, degrees per second, a scalar-first quaternion
from body to inertial, pulses and on-times per interval, those in milliseconds, UTC times, text.
"""

from __future__ import annotations

import sys
import tomllib
from pathlib import Path

import numpy as np
import pandas as pd

THRUSTERS = ("z1", "z2", "z3", "z4", "y1", "y2", "y3", "y4")


def foreign(own: pd.DataFrame, epoch: pd.Timestamp) -> pd.DataFrame:
    """Telemetry of this package in the columns of somebody else."""
    times = epoch + pd.to_timedelta(own["time_s"], unit="s")
    table = pd.DataFrame({"UTC": times.dt.strftime("%Y-%m-%dT%H:%M:%S.%f").str[:-3]})
    table["MODE"] = "RWA_BIAS"
    table["ATT_Q0"] = own["q4"].round(8)
    for place, name in enumerate(("q1", "q2", "q3"), start=1):
        table[f"ATT_Q{place}"] = (-own[name]).round(8)  # body to inertial: the inverse turn
    for axis in "xyz":
        table[f"GYR_{axis.upper()}_DPS"] = np.degrees(own[f"rate_{axis}_rad_s"]).round(6)
    for number in (1, 2, 4):
        table[f"RW{number}_SPD"] = own[f"rwa{number}_rpm"].round(2)
    for name in THRUSTERS:
        gained = own[f"on_time_{name}_s"].diff().fillna(own[f"on_time_{name}_s"])
        table[f"TON_{name.upper()}_MS"] = (1000.0 * gained).round().astype(int)
    for name in THRUSTERS:
        gained = own[f"pulses_{name}"].diff().fillna(own[f"pulses_{name}"])
        table[f"NPLS_{name.upper()}"] = gained.astype(int)
    return table


def main() -> None:
    """Convert the event folders of a simulation."""
    source, target = map(Path, sys.argv[1:])
    for description in sorted(source.glob("*/event.toml")):
        event = tomllib.loads(description.read_text())
        own = pd.read_csv(description.parent / "telemetry.csv")
        table = foreign(own, pd.Timestamp(event["epoch"]).tz_convert("UTC"))
        table.to_csv(target / f"{event['id']}.csv", index=False, sep=";")


if __name__ == "__main__":
    main()
