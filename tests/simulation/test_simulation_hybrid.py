"""Two wheels and thrusters in the loop: what holds, what swings, what is refused."""

from __future__ import annotations

import copy
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cassini_bayes.errors import InputError
from cassini_bayes.simulation import SimulatedEvent, kernel, scenario_of
from cassini_bayes.studies.hybrid import MOSAIC, SPIN, SPIN_UP, flown_figures, modulation_at
from cassini_bayes.studies.scenario import simulate_file

DOCUMENT = tomllib.loads(Path("runs/scenarios/hybrid_2012.toml").read_text(encoding="utf-8"))


def scenario(event: str, **changes: Any) -> dict[str, Any]:
    """The shipped scenario with one event, some of whose keys are changed."""
    document = copy.deepcopy(DOCUMENT)
    document["event"] = [{**e, **changes} for e in document["event"] if e["id"] == event]
    return document


def flown(document: dict[str, Any], seed: int = 0) -> SimulatedEvent:
    """Its only event."""
    return simulate_file(scenario_of(document), seed).events[0]


def test_the_free_spin_is_the_closed_form() -> None:
    """Rates, wheels and angle over two turns follow eqs. (14-17); X and Y stand still."""
    event = flown(scenario(SPIN))
    motion, formula = event.motion, modulation_at(event, 0.0)
    figures = flown_figures(event)
    assert figures["period_s"] == pytest.approx(formula.period_s, abs=0.1)
    angle = formula.angle_rad(motion.time_s)
    # the wheels' limited stiffness and the hold over a control cycle leave parts in 10,000
    np.testing.assert_allclose(motion.rate_rad_s[:, 2], formula.rate_at_rad_s(angle), rtol=5e-4)
    assert figures["peak_rpm"] == pytest.approx(735.65, abs=0.1)
    assert np.abs(motion.rate_rad_s[:, :2]).max() < 1e-7
    assert motion.propellant_kg[-1] == 0.0
    # negative control: a degree of the platform is seen
    turned = scenario(SPIN)
    turned["truth"]["rwa4_articulation_rad"] += np.radians(1.0)
    assert abs(flown_figures(flown(turned))["period_s"] - formula.period_s) > 3.0


def test_spin_up_hands_over_to_the_free_spin() -> None:
    """After letting go nothing fires, and a turn takes what eq. (18) says of the state there."""
    event = flown(scenario(SPIN_UP))
    figures = flown_figures(event)
    assert figures["period_s"] == pytest.approx(figures["formula_period_s"], rel=2e-3)
    logs = event.motion.pulses
    assert all((logs[f"z{k}"].width_s.size == 0) for k in range(1, 5))
    assert sum(logs[f"y{k}"].width_s.size for k in range(1, 5)) > 20
    assert max(float(logs[f"y{k}"].start_s.max()) for k in range(1, 5)) < 400.0


def test_the_mosaic_is_held_by_wheels_and_z_thrusters() -> None:
    """X and Z within 0.1 mrad by wheels, Y within its dead-band by the Z thrusters alone."""
    event = flown(scenario(MOSAIC))
    figures = flown_figures(event)
    assert max(figures["error_x_mrad"], figures["error_z_mrad"]) < 0.1
    assert 1.0 < figures["error_y_mrad"] < 2.1
    assert figures["on_time_s"] > 5.0
    assert all(event.motion.pulses[f"y{k}"].width_s.size == 0 for k in range(1, 5))


def test_momentum_is_conserved_by_two_wheels() -> None:
    """In inertial axes the momentum of body and wheels changes by what the thrusters put in."""
    for name in (SPIN, MOSAIC):
        event = flown(scenario(name, duration_s=400.0))
        motion = event.motion
        body = motion.body
        momentum = motion.rate_rad_s @ body.inertia_kg_m2.T
        momentum = momentum + (motion.wheels_rad_s * body.wheel_inertia_kg_m2) @ body.axes.T
        inertial = Rotation.from_quat(motion.attitude).apply(momentum)
        gained = inertial - inertial[0] - motion.angular_impulse_n_m_s
        assert np.abs(gained).max() < 1e-6


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_direction_error_is_blind_to_the_turn_about_its_axis(axis: int) -> None:
    """A turn about the axis is no error; a small one across it is, whatever the other turn."""
    rng = np.random.default_rng(axis)
    target = Rotation.random(random_state=rng)
    small = 1e-4 * rng.standard_normal(3)
    small[axis] = 0.0
    about = np.zeros(3)
    about[axis] = 2.3
    out = np.empty(3)
    # scalar-last quaternions of inertial-to-body turns compose on the right
    body = target * Rotation.from_rotvec(about)
    kernel.direction_error(target.as_quat(), body.as_quat(), axis, out)
    np.testing.assert_allclose(out, 0.0, atol=1e-12)
    body = target * Rotation.from_rotvec(about) * Rotation.from_rotvec(small)
    kernel.direction_error(target.as_quat(), body.as_quat(), axis, out)
    np.testing.assert_allclose(out, small, atol=1e-7)
    assert np.abs(out).max() > 1e-6


SLOW = {"controller": "dfpw", "spin_rad_s": 0.5e-3}  # stops before it has come round


@pytest.mark.parametrize(
    ("event", "change", "words"),
    [
        (SPIN, {"articulation": -60.0}, ["event spin: wheels", "singular angle"]),
        (SPIN, {"articulation": 120.0}, ["event spin: wheels", "singular angle"]),
        (MOSAIC, {"articulation": 60.0}, ["event mosaic: wheels", "singular angle"]),
        (SPIN, {"articulation": -5397.3}, ["rwa4_articulation_rad", "-94.2", "degrees"]),
        (SPIN, {"hybrid": SLOW}, ["event spin: from_rpm and spin_rad_s", "|G2| < G1", "faster"]),
        (SPIN, {"wheels": [4]}, ["two wheels to hold X and Y", "1 wheel"]),
        (SPIN, {"wheels": [1, 2]}, ["rwa4_articulation_rad", "wheels [1, 2]", "add 4"]),
        (SPIN, {"hybrid": None}, ["three wheels", "hybrid controller"]),
        (SPIN, {"to_rpm": [0.0, 0.0]}, ["to_rpm", "leave to_rpm out"]),
        (SPIN, {"kind": "quiescent"}, ["hybrid", "quiescent"]),
        (SPIN, {"duration_s": None}, ["duration_s", "without slews"]),
    ],
)
def test_bad_hybrids_get_one_line(event: str, change: dict[str, Any], words: list[str]) -> None:
    """Singular angles, degrees for radians, a spin that stops, a platform without its wheel, one
    wheel, keys that do not go together.
    """
    document = scenario(event)
    own = document["event"][0]
    if "articulation" in change:
        document["truth"]["rwa4_articulation_rad"] = np.radians(change.pop("articulation"))
    if "wheels" in change:
        document["spacecraft"]["wheels"] = change.pop("wheels")
        own["from_rpm"] = own["from_rpm"][: len(document["spacecraft"]["wheels"])]
        document["truth"]["rwa1_inertia_kg_m2"] = 0.161
    own.update(change)
    document["event"] = [{key: value for key, value in own.items() if value is not None}]
    if "hybrid" in change and change["hybrid"] is None:
        document["event"][0]["slew"] = DOCUMENT["event"][1]["slew"]
    with pytest.raises(InputError) as raised:
        flown(document)
    message = str(raised.value)
    assert "\n" not in message
    assert all(word in message for word in words)


def test_wheel_3_position_flies() -> None:
    """θ = −120° is no singular angle: appendix D's spin comes round."""
    document = scenario(SPIN)
    document["truth"]["rwa4_articulation_rad"] = np.radians(-120.0)
    event = flown(document)
    assert flown_figures(event)["period_s"] == pytest.approx(
        modulation_at(event, 0.0).period_s, abs=0.2
    )
