"""Wheel biases with and without a simulated leak, and what the monitors' statistics did in them."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from cassini_bayes.computing.arrays import Array
from cassini_bayes.computing.cached import cached_property
from cassini_bayes.errors import InputError
from cassini_bayes.files.toml_file import read_toml
from cassini_bayes.priors.reader import Priors, read_priors
from cassini_bayes.simulation import make_plan, scenario_of
from cassini_bayes.spacecraft.parameters import NOISE_LEVELS
from cassini_bayes.studies.leak_monitors import (
    ROWS_EVERY_S,
    SIZES_N,
    Odds,
    Track,
    residual_of,
    threshold_track,
)
from cassini_bayes.studies.repeated import Repeated
from cassini_bayes.studies.scenario import (
    draw_truth,
    draw_wheel_rates,
    simulate_file,
    simulated_samples,
)

MODULE: Final = "studies.leak_trials"
"""Whose code, with all that it imports, a trial runs through."""
LEAKS_OF_TEN: Final = 7  # the other three of ten trials have none
MOST_ROWS: Final = 400  # ten seconds apart: an hour and more
WINDOWS_S: Final = (60.0, 200.0, 600.0)
EVENT: Final = "bias-1"
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


@dataclass(frozen=True)
class Trial:
    """One flown event: the leak (thruster −1: none) and what every statistic did along the rows."""

    leak_n: float
    thruster: int
    start_s: float
    time_s: Array
    tracks: tuple[Track, ...]  # sequential odds, then one per window


def fly_trial(
    priors: Priors, document: Mapping[str, Any], leaks: bool, rng: np.random.Generator
) -> Trial:
    """Draw wheel rates, parameters and perhaps a leak, fly the bias, follow all monitors."""
    content = copy.deepcopy(dict(document))
    content["event"] = [event for event in content["event"] if event["id"] == EVENT]
    draw_wheel_rates(content["event"], rng)
    content["torque_noise"] = True
    noise = {name: priors.parameters[name].mean for name in NOISE_LEVELS}
    content["truth"] = {"mass_kg": 2380.0, **noise}
    names = priors.spacecraft.thruster_names(priors.branch)
    size = float(np.exp(rng.uniform(np.log(SIZES_N[0]), np.log(SIZES_N[-1]))))
    thruster, share = int(rng.integers(len(names))), float(rng.uniform(0.0, 0.8))
    if not leaks:
        size, thruster = 0.0, -1
    seed = int(rng.integers(2**62))
    file = scenario_of(content)
    truth = draw_truth(file, seed, priors)
    plan = make_plan(file.scenario, file.spacecraft, file.scenario.event[0], truth)
    start = share * float(plan.event.duration_s or 0.0)
    if thruster >= 0:
        values = {"leak_n": size, "start_s": start}
        content["effect"] = [{"name": f"thruster_leak:{names[thruster]}", "parameters": values}]
        file = scenario_of(content)
    event = simulate_file(file, seed, truth=truth).events[0]
    samples, thrusters = simulated_samples(event)
    residual = residual_of(samples, thrusters, event.plan.wheel_numbers, priors)
    tracks = (Odds(residual).track(), *(threshold_track(residual, w) for w in WINDOWS_S))
    return Trial(size, thruster, start, residual.first_s + residual.time_s, tracks)


@dataclass(frozen=True)
class LeakTrials(Repeated):
    """Trials as the repetitions of a study: seven of ten have a leak.

    ``calibrated``: thrusts, pulses and centre of mass are known to a tenth of their prior widths,
    and drawn as closely.
    """

    scenario: Path
    priors: Path
    calibrated: bool = False
    per_file: ClassVar[int] = 20

    @cached_property
    def _known(self) -> tuple[Priors, Mapping[str, Any]]:
        """Priors as wide as they are drawn, and the scenario's tables."""
        priors = read_priors(self.priors)
        if self.calibrated:
            priors = priors.scaled(CALIBRATED, CALIBRATED_WIDTH)
        return priors, read_toml(self.scenario, "a scenario file")

    def repetition(self, index: int) -> dict[str, Array]:
        """One trial, its tracks padded to :data:`MOST_ROWS`; :func:`trials_of` takes them back."""
        leaks = index % 10 < LEAKS_OF_TEN
        return padded(fly_trial(*self._known, leaks, self.stream(index)))


def padded(trial: Trial) -> dict[str, Array]:
    """A trial as arrays that have the same shapes for all trials.

    Raises
    ------
    InputError
        The event has more than :data:`MOST_ROWS` rows at rest.
    """
    rows = len(trial.time_s)
    if rows > MOST_ROWS:
        raise InputError(
            f"event {EVENT}",
            f"at most {MOST_ROWS} rows at rest, {ROWS_EVERY_S:g} s apart",
            str(rows),
            "use a scenario with a shorter bias",
        )
    along = np.full((1 + 2 * len(trial.tracks), MOST_ROWS), np.nan)
    along[:, :rows] = [trial.time_s, *(t.statistic for t in trial.tracks), *_named(trial)]
    return {"leak": np.array([trial.leak_n, trial.thruster, trial.start_s]), "along": along}


def _named(trial: Trial) -> list[Array]:
    return [track.thruster.astype(np.float64) for track in trial.tracks]


def trials_of(arrays: Mapping[str, NDArray[Any]]) -> list[Trial]:
    """Trials of the arrays that :meth:`Study.repeat` gives of :class:`LeakTrials`."""
    return [
        _trial(leak, along) for leak, along in zip(arrays["leak"], arrays["along"], strict=True)
    ]


def _trial(leak: Array, along: Array) -> Trial:
    known = along[:, np.isfinite(along[0])]
    statistics, named = np.split(known[1:], 2)
    tracks = tuple(
        Track(statistic, thruster.astype(np.int64))
        for statistic, thruster in zip(statistics, named, strict=True)
    )
    return Trial(float(leak[0]), int(leak[1]), float(leak[2]), known[0], tracks)
