"""The telemetry that every part of the speed benchmark fits: simulated wheel biases and slews."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from cassini_bayes.model.event_reduction import ReducedEvent, reduce_event
from cassini_bayes.model.posterior import Model, build_model
from cassini_bayes.priors.reader import Priors, read_priors
from cassini_bayes.simulation import scenario_of
from cassini_bayes.studies.scenario import draw_wheel_rates, simulate_file, write_simulation

ROOT = Path(__file__).parents[2]
SCENARIO = ROOT / "runs/scenarios/calibration.toml"
PRIORS = ROOT / "priors/cassini_b_branch_telemetry.toml"
PULSE_SHAPE = "first_order"
SEED = 20101
BIASES = 6
NOISE = "torque_noise_n_m_s05"


@cache
def priors_of(torque_noise: bool = True) -> Priors:
    """The shipped priors of telemetry; without the torque noise its level is fixed at zero."""
    priors = read_priors(PRIORS)
    return priors if torque_noise else priors.with_fixed(NOISE, 0.0)


def event_folders(
    folder: Path, count: int = BIASES, effects: Sequence[dict[str, Any]] = ()
) -> list[Path]:
    """Biases (from about 1,200 rows at 1 Hz) and a slew set, simulated once, as folders.

    ``effects`` are hidden in all of them.
    """
    names = [f"bias-{i + 1}" for i in range(count)] + ["slews"]
    if not all((folder / name / "telemetry.csv").exists() for name in names):
        document: dict[str, Any] = tomllib.loads(SCENARIO.read_text(encoding="utf-8"))
        events = {event["id"]: event for event in document["event"]}
        rng = np.random.default_rng(SEED)
        biases = [dict(events["bias-1"], id=name) for name in names[:-1]]
        draw_wheel_rates(biases[1:], rng)
        document["event"] = [*biases, events["slews"]]
        document["effect"] = [{**effect, "events": names} for effect in effects]
        scenario = scenario_of(document, SCENARIO.parent, str(SCENARIO))
        write_simulation(simulate_file(scenario, SEED, priors=priors_of()), folder)
    return [folder / name for name in names]


def reduced_events(folders: list[Path], torque_noise: bool = True) -> list[ReducedEvent]:
    """Telemetry read and reduced to statistics."""
    return [reduce_event(folder, priors_of(torque_noise), PULSE_SHAPE) for folder in folders]


def model_of(events: list[ReducedEvent], torque_noise: bool = True) -> Model:
    """The model of reduced events."""
    return build_model(events, priors_of(torque_noise))
