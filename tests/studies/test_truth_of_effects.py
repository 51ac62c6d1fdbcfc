"""What the simulation flies is what the diagnosis believes: at the truth of eleven kinds of effect
the log density is below its maximum by what is expected of so many parameters, and no more.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2

from cassini_bayes.diagnosis.events import Events
from cassini_bayes.diagnosis.hypotheses import compact, extend, none_hypothesis
from cassini_bayes.diagnosis.modes import find_mode
from cassini_bayes.studies.blind.flights import Blind, Hidden, Scene
from cassini_bayes.studies.blind.strata import OVER_CONDITIONS
from cassini_bayes.studies.conditions import Condition

ROOT = Path(__file__).parents[2]
FREE = np.linspace(-3.0, 3.0, 13)  # standard normals, of what controllers do: it has no truth
SHORT_PULSES = Condition(
    craft="B branch",
    events="one bias",
    cadence="4 s",
    counter_step="1 ms",
    wheel_step="0.1 rpm",
    rates="ten times finer",
    controller="widths adapted",
    noise="known",
    drive="30 mN m",
)
HIDDEN = {
    "thrust_scale": {"thrust_factor": 0.85},
    "thruster_degraded:z3": {"thrust_factor": 0.8},
    "thruster_misalignment:z2": {"cant_a_rad": 0.03, "cant_b_rad": -0.02},
    "thruster_leak:z4": {"leak_n": 2e-4},
    "thrust_warmup": {"warmup_deficit": 0.2, "warmup_time_s": 8.0},
    "tail_off": {"tau_fall_s": 0.08},
    "pulse_shape": {"impulse_time_offset_s": 0.04},
    "wheel_inertia:2": {"rwa2_inertia_kg_m2": 0.008},
    "center_of_mass:x": {"cm_x_m": 0.2},
    "inertia:yz": {"inertia_yz_kg_m2": 200.0},
    "rate_scale:z": {"rate_scale": 0.01},
}
"""Sizes by name; of a departure, by how much."""
MORE_PULSE_S = 0.01


class ShortPulses(Blind):
    """Trials of one condition."""

    def condition(self, _: np.random.Generator) -> Condition:
        return SHORT_PULSES


@cache
def scene() -> Scene:
    """One truth, flown with one effect after the other."""
    campaign = ShortPulses(
        ROOT / "runs" / "scenarios" / "calibration.toml",
        ROOT / "priors",
        20_261_126,
        (),
        OVER_CONDITIONS,
        over_conditions=True,
    )
    return campaign.scene(campaign.stream(4))


def flown(name: str, size: Mapping[str, float]) -> Events:
    """The flight with an effect."""
    drawn = scene().truth().parameters
    moved = {key: value + drawn.get(key, 0.0) for key, value in size.items()}
    return scene().fly((Hidden(name, moved, 5.0),))


def lacking(events: Events, name: str, size: Mapping[str, float]) -> tuple[float, int]:
    """Twice what the truth lacks of the highest log density, and the number of parameters."""
    effect, truth = events.catalogue.effect(name), dict(scene().truth().parameters)
    truth |= {parameter.name: size[parameter.key] for parameter in effect.parameters}
    hypothesis = compact(extend(none_hypothesis(events), [effect]))
    space = hypothesis.model.space
    known = space.to_standard({key: truth.get(key, np.nan) for key in space.names})
    without = np.flatnonzero(~np.isfinite(known))
    grid = np.array(list(product(FREE, repeat=len(without))))
    points = np.tile(known, (len(grid), 1))
    points[:, without] = grid
    values = hypothesis.log_density(points)
    best = points[int(values.argmax())]
    starts = np.concatenate([best[None], hypothesis.model.starts.points])
    modes = [find_mode(hypothesis.log_density, len(best), start) for start in starts]
    return 2.0 * (max(mode.value for mode in modes) - float(values.max())), len(best)


@pytest.mark.parametrize("name", HIDDEN)
def test_the_truth_of_an_effect_is_as_likely_as_it_should_be(name: str) -> None:
    """χ² of all parameters; one in a thousand is allowed above."""
    excess, parameters = lacking(flown(name, HIDDEN[name]), name, HIDDEN[name])
    assert excess < chi2.ppf(0.999, parameters)


def test_a_little_more_of_an_effect_than_was_flown_is_not_as_likely() -> None:
    """Negative control: pulses that were 10 ms longer."""
    name, size = "pulse_shape", HIDDEN["pulse_shape"]
    more = {key: value + MORE_PULSE_S for key, value in size.items()}
    excess, parameters = lacking(flown(name, more), name, size)
    assert excess > 2.0 * chi2.ppf(0.999, parameters)
