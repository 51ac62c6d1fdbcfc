"""Short simulated events as folders, shared by the tests of fits of telemetry."""

from __future__ import annotations

import atexit
import shutil
import tempfile
from functools import cache
from pathlib import Path
from typing import Any

from cassini_bayes.files.toml_file import read_toml
from cassini_bayes.model import Model, ReducedEvent, build_model, reduce_event
from cassini_bayes.priors.reader import Priors, read_priors
from cassini_bayes.simulation import scenario_of
from cassini_bayes.studies.scenario import simulate_file, write_simulation
from cassini_bayes.studies.telemetry_calibration import reduced_simulation

ROOT = Path(__file__).parents[1]
PRIORS = ROOT / "priors" / "cassini_b_branch_telemetry.toml"


def at_rest(duration_s: float) -> dict[str, Any]:
    """A quiescent event of a scenario: wheels turn evenly, nothing fires or slews."""
    wheels = {"from_rpm": [1500.0, -1200.0, 900.0], "duration_s": duration_s}
    return {"id": "quiet", "kind": "quiescent", "epoch": "2009-08-22T00:00:00Z", **wheels}


def document() -> dict[str, Any]:
    """A bias of some 350 s and slews about all three axes, at 1 Hz."""
    slews = [
        {"start_s": 20.0, "axis": [1.0, 0.0, 0.0], "angle_rad": 0.12},
        {"start_s": 220.0, "axis": [0.0, 1.0, 0.0], "angle_rad": 0.12},
        {"start_s": 420.0, "axis": [0.0, 0.0, 1.0], "angle_rad": 0.15},
    ]
    limits = {"rate_rad_s": 1.5e-3, "acceleration_rad_s2": 2.0e-5}
    return {
        "spacecraft": {"name": "cassini", "branch": "B", "wheels": [1, 2, 4]},
        "truth": {"draw_from": str(PRIORS), "mass_kg": 2380.0},
        "start": {"attitude_spread": 1.0, "rate_rad_s": 2e-5},
        "telemetry": {
            "attitude_noise_rad": 2e-5,
            "rate_noise_rad_s": 2e-6,
            "wheel_noise_rpm": 0.2,
            "wheel_resolution_rpm": 0.0,
            "on_time_resolution_s": 0.001,
        },
        "event": [
            {
                "id": "bias",
                "kind": "bias",
                "epoch": "2010-05-01T00:00:00Z",
                "from_rpm": [-200.0, 300.0, 250.0],
                "to_rpm": [150.0, -100.0, -50.0],
                "settle_s": 100.0,
            },
            {
                "id": "slews",
                "kind": "slew",
                "epoch": "2010-07-01T00:00:00Z",
                "from_rpm": [500.0, -350.0, 420.0],
                "duration_s": 640.0,
                "slew": [slew | limits for slew in slews],
            },
        ],
    }


@cache
def simulated() -> Path:
    """The folder with both events, simulated once per process."""
    folder = Path(tempfile.mkdtemp(prefix="cassini-events-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    write_simulation(simulate_file(scenario_of(document()), 7), folder)
    return folder


@cache
def priors() -> Priors:
    """The shipped priors of telemetry."""
    return read_priors(PRIORS)


@cache
def events(*names: str) -> tuple[ReducedEvent, ...]:
    """Reduced events by name."""
    return tuple(reduce_event(simulated() / name, priors(), "first_order") for name in names)


@cache
def model(*names: str) -> Model:
    """The joint model of some of the events."""
    return build_model(events(*names), priors())


def eased(content: dict[str, Any], share: float = 0.3, every_s: float = 2.0) -> dict[str, Any]:
    """A scenario that takes less long to weigh: shorter biases, fewer rows.

    Wheels of a bias change by a ``share`` of what they did, all channels come ``every_s`` seconds.
    """
    telemetry = {
        key: every_s if key.endswith("every_s") else value
        for key, value in content["telemetry"].items()
    }
    short = []
    for event in content["event"]:
        if event["kind"] == "bias":
            ends = zip(event["from_rpm"], event["to_rpm"], strict=True)
            event = {**event, "to_rpm": [a + share * (b - a) for a, b in ends]}
        short.append(event)
    return {**content, "telemetry": telemetry, "event": short}


def turned_about(axes: str, kinds: tuple[str, ...] = ("slew",)) -> list[ReducedEvent]:
    """Events of these kinds of the calibration's scenario, reduced, with slews about some axes."""
    path = ROOT / "runs" / "scenarios" / "calibration.toml"
    content = read_toml(path, "a scenario file")
    slews = next(event for event in content["event"] if event["kind"] == "slew")
    about = ["xyz"[max(range(3), key=lambda i: abs(slew["axis"][i]))] for slew in slews["slew"]]
    assert set(about) == {"x", "y", "z"}
    slews["slew"] = [slew for slew, axis in zip(slews["slew"], about, strict=True) if axis in axes]
    content["event"] = [
        next(event for event in content["event"] if event["kind"] == kind) for kind in kinds
    ]
    flight = simulate_file(scenario_of(content, path.parent, str(path)), 3, priors=priors())
    return [reduced_simulation(event, priors()) for event in flight.events]
