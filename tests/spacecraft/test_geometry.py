"""Geometry of wheels and thrusters against papers 000 and 004 and against plain cross products."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import minimize_scalar
from scipy.spatial.transform import Rotation
from spacecraft_cases import FILES, middle, plain_arm, plain_position, plain_wheel_axis, table

from cassini_bayes.computing.arrays import Array
from cassini_bayes.errors import InputError
from cassini_bayes.spacecraft import (
    AXIS_DEMANDS,
    BranchGeometry,
    Spacecraft,
    centre_of_mass,
    check_axis_pairs,
    couples,
    inertia_tensor,
    lever_arms,
    load_spacecraft,
    pair_indicator,
    thruster_directions,
    thruster_positions,
    wheel_axes,
    wheel_inertias,
)

SPACECRAFT = {name: load_spacecraft(path) for name, path in FILES.items()}
BRANCHES = [(name, branch) for name, craft in SPACECRAFT.items() for branch in craft.branches]
A_BRANCH = {
    "thruster_lx_m": 1.234,
    "thruster_ly_m": 1.580,
    "thruster_lzz_m": 3.019,
    "thruster_lzy_m": 2.880,
}
NO_TILT = {"rwa4_tilt_u_rad": 0.0, "rwa4_tilt_v_rad": 0.0}
OFFSETS = st.tuples(*[st.floats(-5.0, 5.0)] * 3)


def paper_000_moment_matrix(ex: float, ey: float, ez: float) -> Array:
    """Matrix Q of paper 000 eq. (16) with the A-branch lengths that the paper prints beside it."""
    lx, ly, lzy, lzz = 1.234, 1.580, 2.880, 3.019
    del lzz  # the height of the Z thrusters does not enter: their force is along Z
    return np.array(
        [
            [ey - ly, ey - ly, ly + ey, ly + ey, lzy - ez, lzy - ez, ez - lzy, ez - lzy],
            [lx - ex, -lx - ex, -lx - ex, lx - ex, 0, 0, 0, 0],
            [0, 0, 0, 0, ex - lx, lx + ex, -lx - ex, lx - ex],
        ]
    )


@given(st.floats(-1, 1), st.floats(-1, 1), st.floats(-1, 4))
def test_cassini_lever_arms_are_equation_16_of_paper_000(ex: float, ey: float, ez: float) -> None:
    """All 24 entries, signs included, at any centre of mass."""
    values = {**A_BRANCH, "cm_x_m": ex, "cm_y_m": ey, "cm_z_m": ez}
    arms = lever_arms(SPACECRAFT["cassini"], "A", values)
    np.testing.assert_allclose(arms, paper_000_moment_matrix(ex, ey, ez), rtol=0, atol=1e-12)


@pytest.mark.parametrize(("name", "branch"), BRANCHES)
def test_lever_arms_are_cross_products(name: str, branch: str) -> None:
    """Each column equals one cross product made from the file's own entries; so do positions."""
    values = middle(name)
    own = [t for t in table(name)["thruster"] if branch in t["branches"]]
    arms = np.stack([plain_arm(t, values) for t in own], axis=-1)
    positions = np.stack([plain_position(t, values) for t in own], axis=-1)
    craft = SPACECRAFT[name]
    np.testing.assert_allclose(lever_arms(craft, branch, values), arms, atol=1e-9)
    np.testing.assert_allclose(thruster_positions(craft, branch, values), positions, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(thruster_directions(craft, branch), axis=0), 1.0)
    # negative control: d × (r − e), the order in which a torque is easily written wrong
    assert np.abs(lever_arms(craft, branch, values) + arms).max() > 0.5


@pytest.mark.parametrize(("name", "branch"), BRANCHES)
@given(shift=OFFSETS, seed=st.integers(0, 1000))
def test_only_the_place_relative_to_the_centre_of_mass_counts(
    name: str, branch: str, shift: tuple[float, float, float], seed: int
) -> None:
    """Moving the frame of thrusters and centre of mass together leaves every lever arm alone."""
    values, craft = middle(name), SPACECRAFT[name]
    rng = np.random.default_rng(seed)
    centre = rng.normal(size=3)
    moved = tuple(
        replace(t, position=tuple(plain_position(raw, values) + np.array(shift)))
        for t, raw in zip(craft.thrusters, table(name)["thruster"], strict=True)
        if branch in t.branches
    )
    displaced = replace(craft, geometry={branch: BranchGeometry.of(moved)})
    before = lever_arms(craft, branch, {**values, **_centre(centre)})
    after = lever_arms(displaced, branch, _centre(centre + shift))
    np.testing.assert_allclose(after, before, atol=1e-12)


@pytest.mark.parametrize(("name", "branch"), BRANCHES)
@given(seed=st.integers(0, 1000))
def test_lever_arms_turn_with_the_frame(name: str, branch: str, seed: int) -> None:
    """Positions, directions and centre of mass in another frame give the same torques there."""
    values, craft = middle(name), SPACECRAFT[name]
    rotation = Rotation.random(random_state=seed).as_matrix()
    turned = tuple(
        replace(
            t,
            position=tuple(rotation @ plain_position(raw, values)),
            direction=rotation @ t.direction,
        )
        for t, raw in zip(craft.thrusters, table(name)["thruster"], strict=True)
        if branch in t.branches
    )
    there = replace(craft, geometry={branch: BranchGeometry.of(turned)})
    centre = rotation @ centre_of_mass(values)
    expected = rotation @ lever_arms(craft, branch, values)
    np.testing.assert_allclose(lever_arms(there, branch, _centre(centre)), expected, atol=1e-12)


def _centre(values: Array) -> dict[str, float]:
    return dict(zip(("cm_x_m", "cm_y_m", "cm_z_m"), values.tolist(), strict=True))


@pytest.mark.parametrize(("name", "branch"), BRANCHES)
def test_a_force_does_no_work_about_its_own_line(name: str, branch: str) -> None:
    """q is perpendicular to d, and vanishes with the centre of mass on the line of force."""
    values, craft = middle(name), SPACECRAFT[name]
    directions = thruster_directions(craft, branch)
    arms = lever_arms(craft, branch, values)
    np.testing.assert_allclose((arms * directions).sum(0), 0.0, atol=1e-12)
    positions = thruster_positions(craft, branch, values)
    for k in range(arms.shape[1]):
        on_line = positions[:, k] - 1.7 * directions[:, k]
        there = lever_arms(craft, branch, {**values, **_centre(on_line)})
        np.testing.assert_allclose(there[:, k], 0.0, atol=1e-12)


def test_cassini_wheels_form_the_pyramid_of_the_papers() -> None:
    """54.7356° from +Z, the first three orthogonal and right-handed in the order 1, 2, 3; 4 = 3."""
    axes = wheel_axes(SPACECRAFT["cassini"], NO_TILT)
    angles = np.degrees(np.arccos(axes[2]))
    np.testing.assert_allclose(angles, 54.7356, atol=5e-5)
    prime = axes[:, :3]
    np.testing.assert_allclose(prime.T @ prime, np.eye(3), atol=1e-14)
    assert np.linalg.det(prime) == pytest.approx(1.0)
    np.testing.assert_allclose(axes[:, 3], axes[:, 2], atol=1e-15)
    azimuths = np.degrees(np.arctan2(axes[1], axes[0]))
    np.testing.assert_allclose(azimuths, [90.0, -150.0, -30.0, -30.0], atol=1e-9)


def test_fsds_case_turns_about_plus_z_and_is_met_by_y2_y4() -> None:
    """Wheels 1, 2, 3 from 0 to 1800 rpm gain +Z momentum, so thrusters must push about +Z."""
    craft = SPACECRAFT["cassini"]
    inertias = np.array([0.161, 0.160, 0.161])
    momentum = wheel_axes(craft, NO_TILT)[:, :3] @ (inertias * 1800 * 2 * np.pi / 60)
    # equal inertias would leave Z alone; wheel 2 lacks 0.001 kg m² of that, 0.19 N m s
    assert momentum[2] == pytest.approx(0.482 * 60 * np.pi / np.sqrt(3), rel=1e-12)
    assert momentum[2] == pytest.approx(52.5, abs=0.1)
    lacking = 0.001 * 60 * np.pi
    assert momentum[0] == pytest.approx(lacking / np.sqrt(2), rel=1e-12)
    assert momentum[1] == pytest.approx(lacking / np.sqrt(6), rel=1e-12)
    equal = wheel_axes(craft, NO_TILT)[:, :3] @ np.ones(3)
    np.testing.assert_allclose(equal, [0.0, 0.0, np.sqrt(3)], atol=1e-14)
    values = {**A_BRANCH, "cm_x_m": 0.0, "cm_y_m": 0.0, "cm_z_m": 1.2}
    arms = lever_arms(craft, "A", values)
    couple = {"y2": arms[2, 5] + arms[2, 7], "y1": arms[2, 4] + arms[2, 6]}
    assert couple["y2"] > 0 > couple["y1"]
    assert craft.axis_pairs["+z"] == ("y2", "y4")
    # 21.875 s of each at 0.75 N and a ratio of 1.3406 deliver what the wheels took, to 4 %:
    # paper 000 itself finds 0.98/1.3406 = 0.731 N for 0.75 N
    delivered = couple["y2"] * 0.75 * 21.875 * 1.3406
    assert delivered == pytest.approx(momentum[2], rel=0.04)
    assert momentum[2] / (couple["y2"] * 21.875) == pytest.approx(0.98, abs=0.01)


def articulated_axis(angle_deg: float) -> Array:
    """Wheel 4 of paper 004 with its platform at θ: −θ is the angle from +Y to its projection."""
    angle = np.radians(angle_deg)
    s = np.sqrt(2 / 3)
    return np.array([-s * np.sin(angle), s * np.cos(angle), 1 / np.sqrt(3)])


def test_articulation_figures_of_paper_004_follow_from_the_wheel_axes() -> None:
    """Optimum −81.8° with 0.4472, (0.318, −0.317) at −84.7°, p_X and p_Y at −94.2°."""
    axes = wheel_axes(SPACECRAFT["cassini"], NO_TILT)
    np.testing.assert_allclose(articulated_axis(0.0), axes[:, 0], atol=1e-14)
    np.testing.assert_allclose(articulated_axis(-120.0), axes[:, 2], atol=1e-14)

    def coupling(angle_deg: float) -> Array:
        both = np.stack([axes[:, 1], articulated_axis(angle_deg)], axis=-1)
        return both[1] @ np.linalg.inv(both[[0, 2]])

    best = minimize_scalar(
        lambda angle: np.linalg.norm(coupling(angle)), bounds=(-100, -60), method="bounded"
    )
    assert best.x == pytest.approx(-81.8, abs=0.05)
    assert best.fun == pytest.approx(0.4472, abs=5e-5)
    np.testing.assert_allclose(coupling(best.x), [0.346, -0.283], atol=6e-4)
    np.testing.assert_allclose(coupling(-84.7), [0.318, -0.317], atol=5e-4)
    assert np.linalg.norm(coupling(-84.7)) == pytest.approx(0.4494, abs=5e-5)
    both = np.stack([axes[:, 1], articulated_axis(-94.2)], axis=-1)
    p_x, p_y = both[2] @ np.linalg.inv(both[:2])
    assert p_x == pytest.approx(0.5369, abs=5e-5)
    assert p_y == pytest.approx(-2.34410, abs=5e-6)
    assert p_y == pytest.approx(-2.3442, abs=1.1e-4)  # as printed: one unit off in the last digit


@pytest.mark.parametrize("name", FILES)
@given(seed=st.integers(0, 1000))
def test_tilted_axes_are_rotations(name: str, seed: int) -> None:
    """unit(a + u e1 + v e2) is a turned by atan √(u² + v²) towards u e1 + v e2, for any size."""
    craft, rng = SPACECRAFT[name], np.random.default_rng(seed)
    tilts = {n: rng.normal(0, 0.5) for w in craft.wheels for n in w.tilt_parameters or ()}
    expected = [plain_wheel_axis(w, tilts) for w in table(name)["wheel"]]
    np.testing.assert_allclose(wheel_axes(craft, tilts), np.stack(expected, axis=-1), atol=1e-10)


@pytest.mark.parametrize("name", FILES)
def test_sense_of_the_tilts(name: str) -> None:
    """u turns an axis about +Z, by u / sin(polar angle); v raises it towards +Z, by atan v."""
    craft = SPACECRAFT[name]
    for column, wheel in enumerate(craft.wheels):
        if wheel.tilt_parameters is None:
            continue
        zero = {n: 0.0 for w in craft.wheels for n in w.tilt_parameters or ()}
        u, v = wheel.tilt_parameters
        a = wheel.axis
        size = 1e-6
        turned = wheel_axes(craft, {**zero, u: size})[:, column]
        about_z = Rotation.from_rotvec([0, 0, size / np.hypot(a[0], a[1])]).as_matrix() @ a
        np.testing.assert_allclose(turned, about_z, atol=1e-11)
        raised = wheel_axes(craft, {**zero, v: 0.2})[:, column]
        assert np.arccos(a[2]) - np.arccos(raised[2]) == pytest.approx(np.arctan(0.2))
        # negative control: u and v are not interchangeable
        swapped = wheel_axes(craft, {**zero, v: size})[:, column]
        assert np.abs(swapped - about_z).max() > 0.5 * size


@pytest.mark.parametrize(("name", "branch"), BRANCHES)
@pytest.mark.parametrize("shape", [(), (5,), (5, 1), (2, 3), (0,)])
def test_batches_agree_with_single_points(name: str, branch: str, shape: tuple[int, ...]) -> None:
    """Leading axes of any shape come first in the result; each entry is that of its own point."""
    craft, values = SPACECRAFT[name], middle(name)
    rng = np.random.default_rng(4)
    batch = {key: value * rng.uniform(0.9, 1.1, shape) for key, value in values.items()}
    batch.update(
        {n: rng.normal(0, 0.01, shape) for w in craft.wheels for n in w.tilt_parameters or ()}
    )
    functions = {
        "axes": lambda p: wheel_axes(craft, p),
        "inertias": lambda p: wheel_inertias(craft, p),
        "positions": lambda p: thruster_positions(craft, branch, p),
        "arms": lambda p: lever_arms(craft, branch, p),
        "centre": centre_of_mass,
        "tensor": inertia_tensor,
    }
    for label, function in functions.items():
        together = function(batch)
        assert together.shape[: len(shape)] == shape, label
        for at in np.ndindex(shape):
            alone = function({key: float(value[at]) for key, value in batch.items()})
            np.testing.assert_allclose(together[at], alone, rtol=1e-12, atol=1e-14)


def test_batches_of_different_shapes_broadcast() -> None:
    """One batched parameter among floats, or crossed axes, broadcast like arrays do."""
    craft, values = SPACECRAFT["twelve"], middle("twelve")
    mixed = {**values, "cm_x_m": np.linspace(0, 1, 4), "arm_m": np.linspace(1, 2, 3)[:, None]}
    arms = lever_arms(craft, "P", mixed)
    assert arms.shape == (3, 4, 3, 10)
    one = lever_arms(craft, "P", {**values, "cm_x_m": 1.0, "arm_m": 1.5})
    np.testing.assert_allclose(arms[1, 3], one, atol=1e-14)
    assert wheel_axes(craft, {**values, "w5_tilt_u_rad": np.zeros((7, 1))}).shape == (7, 1, 3, 4)


@pytest.mark.parametrize("name", FILES)
def test_inertia_tensor_is_the_matrix_of_its_elements(name: str) -> None:
    """Elements keep their sign and place, and the matrix is symmetric."""
    values = middle(name)
    tensor = inertia_tensor(values)
    for i, a in enumerate("xyz"):
        for j, b in enumerate("xyz"):
            assert tensor[i, j] == values[f"inertia_{''.join(sorted(a + b))}_kg_m2"]


@pytest.mark.parametrize(("name", "branch"), BRANCHES)
def test_axis_pairs_turn_the_way_they_say(name: str, branch: str) -> None:
    """The shipped pairs pass, and pairs with any axis swapped fail with the place to look at."""
    craft, values = SPACECRAFT[name], middle(name)
    check_axis_pairs(craft, branch, values)
    for axis in "xyz":
        pairs = dict(craft.axis_pairs)
        pairs[f"+{axis}"], pairs[f"-{axis}"] = pairs[f"-{axis}"], pairs[f"+{axis}"]
        with pytest.raises(InputError, match=rf"axis_pairs\.\+{axis}.*positive.*swap"):
            check_axis_pairs(replace(craft, axis_pairs=pairs), branch, values)
    far = {**values, "cm_y_m": 50.0}
    with pytest.raises(InputError, match="axis_pairs"):
        check_axis_pairs(craft, branch, far)


@pytest.mark.parametrize(("name", "branch"), BRANCHES)
def test_pair_indicator_is_the_file(name: str, branch: str) -> None:
    """Row by row the thrusters that the file lists, without those of other branches."""
    indicator = pair_indicator(SPACECRAFT[name], branch)
    file = table(name)
    own = [t["name"] for t in file["thruster"] if branch in t["branches"]]
    assert indicator.shape == (6, len(own))
    for row, demand in enumerate(AXIS_DEMANDS):
        fired = {own[k] for k in np.flatnonzero(indicator[row])}
        assert fired == set(file["axis_pairs"][demand]) & set(own)


def test_couples_are_thrusters_that_always_fire_together() -> None:
    """Cassini's Y thrusters in two couples; thrusters without a demand are not tied together."""
    for branch in "AB":
        groups = couples(SPACECRAFT["cassini"], branch)
        assert groups == (("z1",), ("z2",), ("z3",), ("z4",), ("y1", "y3"), ("y2", "y4"))
    twelve = SPACECRAFT["twelve"]
    own = ("p1", "p2", "p3", "p4")
    for branch, groups in {
        "P": (*[(n,) for n in own], ("r1", "r2"), ("r3", "r4"), ("v1",), ("v2",)),
        "R": (*[(n,) for n in own], ("r3", "r4"), ("s1", "s2"), ("v1",), ("v2",)),
    }.items():
        assert couples(twelve, branch) == groups


@pytest.mark.parametrize(
    "function", [pair_indicator, couples, thruster_directions, Spacecraft.thrusters_of]
)
def test_unknown_branch_is_an_input_error(function: object) -> None:
    """A branch that the spacecraft lacks is named together with those it has."""
    assert callable(function)
    with pytest.raises(InputError, match=r"A, B.*'C'"):
        function(SPACECRAFT["cassini"], "C")
