"""What can be told from the catalogue: its own causes cannot, a torque of minutes can."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from cassini_bayes.studies.blind import alias as alias_module
from cassini_bayes.studies.blind.alias import Alias, nearest_cause
from cassini_bayes.studies.blind.flights import Blind, Hidden
from cassini_bayes.studies.blind.shift import View, at_truth, changed_size
from cassini_bayes.studies.blind.strata import STRATA

ROOT = Path(__file__).parents[2]
PRIORS = ROOT / "priors" / "cassini_b_branch_telemetry.toml"
TORQUE = {
    "peak_x_n_m": 6e-4,
    "peak_y_n_m": 0.0,
    "peak_z_n_m": 0.0,
    "centre_s": 500.0,
    "width_s": 100.0,
}
HIDDEN = {
    "thruster_degraded:z2": {"thrust_factor": 0.6},
    "time_offset": {"time_offset_s": 0.4},
    "atmospheric_torque": TORQUE,
}


@cache
def seen(name: str | None = None) -> View:
    """A bias without noise, as the baseline sees it, with or without something hidden."""
    campaign = Blind(
        ROOT / "runs" / "scenarios" / "calibration.toml", PRIORS, 5, ("bias-1",), STRATA
    )
    scene = campaign.scene(campaign.stream(0))
    hidden = () if name is None else (Hidden(name, HIDDEN[name], float("nan")),)
    return at_truth(scene.fly_quietly(hidden), scene.truth())


def judged(name: str) -> tuple[Alias, float]:
    """The nearest cause, and the size of what is hidden."""
    view = seen(name)
    return nearest_cause(view, seen()), changed_size(view, seen())


def test_a_cause_of_the_catalogue_is_its_own_alias() -> None:
    """A thruster at 60 % (its couple may stand for it) leaves a quarter of its size at most."""
    alias, sigma = judged("thruster_degraded:z2")
    assert sigma > 8.0
    assert alias.name.startswith("thruster_degraded:")
    assert alias.left_sigma < 0.25 * sigma


def test_a_torque_of_minutes_is_no_cause_of_the_catalogue() -> None:
    """Most of it is left by every cause, a steady torque or a leak with an onset among them."""
    alias, sigma = judged("atmospheric_torque")
    assert sigma > 8.0
    assert 0.5 * sigma < alias.left_sigma < sigma


def test_bounds_of_a_size_are_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    """With bounds of ± 0.1 prior scales about every size, much of a weak thruster is left."""
    whole = alias_module._causes

    def narrow(view: View) -> list[alias_module._Cause]:
        return [cause._replace(low=-0.1, high=0.1) for cause in whole(view)]

    free, sigma = judged("thruster_degraded:z2")
    monkeypatch.setattr(alias_module, "_causes", narrow)
    bound, _ = judged("thruster_degraded:z2")
    assert free.left_sigma < 0.25 * sigma < 0.4 * sigma < bound.left_sigma


def test_nothing_that_is_hidden_leaves_nothing() -> None:
    """The same flight twice: no size, and nothing for any cause to explain."""
    alias = nearest_cause(seen(), seen())
    assert alias == Alias("none", 0.0)
    assert np.isfinite(judged("time_offset")[0].left_sigma)
