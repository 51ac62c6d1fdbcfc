"""Wheel biases with and without a simulated leak, and what the monitors' statistics did in them.

Trials are kept in batches: an interrupted campaign goes on where it stopped.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from cassini_bayes.computing.arrays import Array
from cassini_bayes.files.checkpoint import CheckpointStore
from cassini_bayes.files.code import code_digest
from cassini_bayes.files.storage import digest
from cassini_bayes.files.toml_file import read_toml
from cassini_bayes.priors.reader import Priors, read_priors
from cassini_bayes.simulation import make_plan, scenario_of
from cassini_bayes.studies.leak_monitors import SIZES_N, Odds, Track, residual_of, threshold_track
from cassini_bayes.studies.scenario import (
    draw_truth,
    draw_wheel_rates,
    simulate_file,
    simulated_samples,
)
from cassini_bayes.studies.telemetry_calibration import with_torque_noise

SEED: Final = 20_050_128
LEAKS_OF_TEN: Final = 7  # the other three of ten trials have none
BATCH: Final = 10
WINDOWS_S: Final = (60.0, 200.0, 600.0)
EVENT: Final = "bias-1"
NOISE: Final = (
    "rate_noise_rad_s",
    "wheel_noise_rpm",
    "attitude_noise_rad",
    "torque_noise_n_m_s05",
)
CALIBRATED: Final = (
    "thrust_common_n",
    "thrust_individual_n",
    "thrust_event_n",
    "thrust_jitter_n",
    "tau_rise_s",
    "tau_fall_s",
    "cm_x_m",
    "cm_y_m",
    "cm_z_m",
)
CALIBRATED_WIDTH: Final = 0.1  # of the prior widths, where thrusters are calibrated
SCENARIO: Final = Path("runs/scenarios/calibration.toml")
PRIORS: Final = Path("priors/cassini_b_branch_telemetry.toml")


@dataclass(frozen=True)
class Trial:
    """One flown event: the leak (thruster −1: none) and what every statistic did along the rows."""

    leak_n: float
    thruster: int
    start_s: float
    time_s: Array
    tracks: tuple[Track, ...]  # sequential odds, then one per window


def fly_trial(priors: Priors, document: dict[str, Any], index: int) -> Trial:
    """Draw wheel rates, parameters and a leak, fly the bias, follow all monitors."""
    rng = np.random.default_rng(np.random.SeedSequence((SEED, index)))
    own = copy.deepcopy(document)
    own["event"] = [event for event in own["event"] if event["id"] == EVENT]
    draw_wheel_rates(own["event"], rng)
    own["truth"] = {"mass_kg": 2380.0, **{n: priors.parameters[n].mean for n in NOISE}}
    names = priors.spacecraft.thruster_names(priors.branch)
    size = float(np.exp(rng.uniform(np.log(SIZES_N[0]), np.log(SIZES_N[-1]))))
    thruster, share = int(rng.integers(len(names))), float(rng.uniform(0.0, 0.8))
    if index % 10 >= LEAKS_OF_TEN:
        size, thruster = 0.0, -1
    seed = int(rng.integers(2**62))
    file = scenario_of(own)
    truth = draw_truth(file, seed, priors)
    plan = make_plan(file.scenario, file.spacecraft, file.scenario.event[0], truth)
    start = share * float(plan.event.duration_s or 0.0)
    if thruster >= 0:
        values = {"leak_n": size, "start_s": start}
        own["effect"] = [{"name": f"thruster_leak:{names[thruster]}", "parameters": values}]
        file = scenario_of(own)
    event = simulate_file(file, seed, truth=truth).events[0]
    samples, thrusters = simulated_samples(event)
    samples = with_torque_noise(samples, event, rng)
    residual = residual_of(samples, thrusters, event.plan.wheel_numbers, priors)
    tracks = (Odds(residual).track(), *(threshold_track(residual, w) for w in WINDOWS_S))
    return Trial(size, thruster, start, residual.time_s, tracks)


def trials(folder: Path, number: int, *, calibrated: bool = False) -> list[Trial]:
    """All trials, those that are not in the folder yet flown and kept.

    ``calibrated``: thrusts, pulses and centre of mass are known to a tenth of their prior widths,
    and drawn as closely.
    """
    priors = read_priors(PRIORS)
    if calibrated:
        priors = priors.scaled(CALIBRATED, CALIBRATED_WIDTH)
    document = read_toml(SCENARIO, "a scenario file")
    code = code_digest("studies.leak_trials")
    identity = f"leaks/{SEED}/{calibrated}/{digest(SCENARIO)}/{digest(PRIORS)}/{code}"
    store = CheckpointStore(folder, identity)
    found: list[Trial] = []
    for first in range(0, number, BATCH):
        name = f"trials_{first:05d}"
        arrays = store.load(name)
        if arrays is None:
            batch = [fly_trial(priors, document, first + i) for i in range(BATCH)]
            store.save(name, _packed(batch))
        else:
            batch = _unpacked(arrays)
        found += batch
    return found[:number]


def _packed(batch: Sequence[Trial]) -> dict[str, Any]:
    arrays: dict[str, Any] = {
        "leak": np.array([[t.leak_n, t.thruster, t.start_s] for t in batch]),
        "rows": np.array([len(t.time_s) for t in batch]),
        "time": np.concatenate([t.time_s for t in batch]),
    }
    for i in range(len(batch[0].tracks)):
        arrays[f"statistic_{i}"] = np.concatenate([t.tracks[i].statistic for t in batch])
        arrays[f"thruster_{i}"] = np.concatenate([t.tracks[i].thruster for t in batch])
    return arrays


def _unpacked(arrays: dict[str, Any]) -> list[Trial]:
    edges = np.cumsum(arrays["rows"])[:-1]
    times = np.split(arrays["time"], edges)
    tracks = [
        [
            Track(s, k)
            for s, k in zip(
                np.split(arrays[f"statistic_{i}"], edges),
                np.split(arrays[f"thruster_{i}"], edges),
                strict=True,
            )
        ]
        for i in range(1 + len(WINDOWS_S))
    ]
    return [
        Trial(float(leak), int(thruster), float(start), times[row], tuple(t[row] for t in tracks))
        for row, (leak, thruster, start) in enumerate(arrays["leak"])
    ]
