"""Two wheels on two axes against every figure that paper 004 prints of them."""

from __future__ import annotations

from collections.abc import Callable
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.optimize import brentq, minimize_scalar

from cassini_bayes.errors import InputError
from cassini_bayes.published.constants import published_constants
from cassini_bayes.spacecraft import load_spacecraft, wheel_axes
from cassini_bayes.spacecraft.two_wheels import (
    SpinModulation,
    peak_wheel_momentum,
    spin_propellant_kg,
    torque_coupling,
    wheel_torques,
)

Array = NDArray[np.float64]
CRAFT = load_spacecraft("cassini").with_platforms(("rwa4_articulation_rad",))
PRINTED = published_constants()
RPM = 60.0 / (2.0 * np.pi)
ROUNDING_DEG = 0.05  # of an angle printed to 0.1°


def axes_of(angle_deg: float, **tilts: float) -> Array:
    """Axes of wheels 2 and 4 with the platform at θ."""
    values = {"rwa4_tilt_u_rad": 0.0, "rwa4_tilt_v_rad": 0.0, **tilts}
    return wheel_axes(CRAFT, {**values, "rwa4_articulation_rad": np.radians(angle_deg)})[:, [1, 3]]


def coupling(angle_deg: float, controller: str = "ors") -> Array:
    """Torque about the free axis per torque about each held one."""
    return torque_coupling(axes_of(angle_deg), controller)


def spin(momentum: tuple[float, float], angle_deg: float = -94.2) -> SpinModulation:
    """The spin of section VIII: Table 1's I_zz, 3.07 mrad/s."""
    inertia = PRINTED.vector("paper_004_table_1", "moment_of_inertia_kg_m2")[2].value
    rate = 1e-3 * PRINTED.value("paper_004_spin", "spin_rate_mrad_s")
    p_x, p_y = (float(value) for value in coupling(angle_deg, "dfpw"))
    return SpinModulation(inertia, rate, (p_x, p_y), momentum)


def peak_rpm(momentum: tuple[float, float], wheel_kg_m2: float, angle_deg: float = -94.2) -> float:
    """Greatest rate of either wheel."""
    peaks = peak_wheel_momentum(axes_of(angle_deg), momentum) / wheel_kg_m2 * RPM
    assert peaks[0] == pytest.approx(peaks[1], rel=1e-12)  # as paper 004 notes under eq. (16)
    return float(peaks[0])


def slow_percent(motion: SpinModulation, wheel_kg_m2: float = 0.160) -> float:
    """Percent of the time that wheel 2 is within 300 rpm."""
    angle = np.linspace(0.0, 2.0 * np.pi, 20001)
    share = 1.0 / motion.rate_at_rad_s(angle)
    inverse = wheel_torques(axes_of(-94.2), "dfpw", "wheels")
    rates = motion.held_momentum_n_m_s(angle) @ inverse.T / wheel_kg_m2 * RPM
    return float(100.0 * share[np.abs(rates[:, 0]) < 300.0].sum() / share.sum())


def test_platform_angles_are_those_of_paper_004() -> None:
    """θ = 0 is the launch position (along wheel 1), −120° along wheel 3; the tilts go with it."""
    s = np.sqrt(2 / 3)
    for angle in (-120.0, -94.2, 0.0, 37.0):
        rad = np.radians(angle)
        expected = [-s * np.sin(rad), s * np.cos(rad), 1 / np.sqrt(3)]
        np.testing.assert_allclose(axes_of(angle)[:, 1], expected, atol=1e-14)
    fixed = load_spacecraft("cassini")
    still = wheel_axes(fixed, {"rwa4_tilt_u_rad": 0.01, "rwa4_tilt_v_rad": -0.02})
    moved = axes_of(-120.0, rwa4_tilt_u_rad=0.01, rwa4_tilt_v_rad=-0.02)
    np.testing.assert_allclose(moved[:, 1], still[:, 3], atol=1e-14)


def test_a_small_turn_of_the_platform_is_a_tilt_u() -> None:
    """To first order the angle and tilt u move the axis alike: u = sin 54.7° δθ."""
    small = 1e-5
    turned = axes_of(-94.2 + np.degrees(small))
    tilted = axes_of(-94.2, rwa4_tilt_u_rad=np.sqrt(2 / 3) * small)
    np.testing.assert_allclose(turned, tilted, atol=1e-10)
    raised = axes_of(-94.2, rwa4_tilt_v_rad=np.sqrt(2 / 3) * small)
    assert np.abs(turned - raised).max() > 0.1 * small  # negative control


def test_best_angle_for_remote_sensing() -> None:
    """Optimum −81.8°: RSS 0.4472 = 1/√5, couplings 0.346 and −0.283."""
    best = minimize_scalar(
        lambda angle: np.linalg.norm(coupling(angle)), bounds=(-100, -60), method="bounded"
    )
    assert best.x == pytest.approx(-81.8, abs=0.05)
    assert best.fun == pytest.approx(1 / np.sqrt(5), abs=1e-9)
    for value, key in (
        (best.fun, "optimal_coupling"),
        (coupling(best.x)[0], "optimal_coupling_x"),
        (coupling(best.x)[1], "optimal_coupling_z"),
    ):
        printed = PRINTED.number("paper_004_articulation", key)
        assert abs(value - printed.value) < 0.5 * printed.step + 0.002 * (key[-1] in "xz")


@pytest.mark.parametrize(
    ("key", "angle_key", "quantity"),
    [
        ("even_coupling", "even_angle_deg", lambda a: np.linalg.norm(coupling(a))),
        ("even_coupling_x", "even_angle_deg", lambda a: coupling(a)[0]),
        ("even_coupling_z", "even_angle_deg", lambda a: coupling(a)[1]),
        ("spin_coupling_x", None, lambda a: coupling(a, "dfpw")[0]),
        ("spin_coupling_y", None, lambda a: coupling(a, "dfpw")[1]),
    ],
)
def test_couplings_at_printed_angles(
    key: str, angle_key: str | None, quantity: Callable[[float], float]
) -> None:
    """Each printed coupling lies within what the rounding of its angle leaves, and of its own."""
    printed = PRINTED.number("paper_004_articulation", key)
    angle = (
        PRINTED.value("paper_004_articulation", angle_key)
        if angle_key
        else PRINTED.value("paper_004_table_1", "articulation_angle_deg")
    )
    ends = sorted(quantity(angle + side * ROUNDING_DEG) for side in (-1, 1))
    assert ends[0] - 0.5 * printed.step <= printed.value <= ends[1] + 0.5 * printed.step
    elsewhere = sorted(quantity(angle + 5.0 + side * ROUNDING_DEG) for side in (-1, 1))
    assert not elsewhere[0] <= printed.value <= elsewhere[1]  # negative control


def test_the_coupling_of_equation_5_belongs_to_no_printed_angle() -> None:
    """0.2785, said to be of section VII, is the X coupling at −88.9°; at −94.2° it is 0.229."""
    printed = PRINTED.value("paper_004_text", "cross_coupling")
    assert coupling(-94.2)[0] == pytest.approx(0.229, abs=5e-4)
    assert coupling(-94.2)[1] == pytest.approx(-0.427, abs=5e-4)
    where = brentq(lambda angle: coupling(angle)[0] - printed, -95.0, -80.0)
    assert where == pytest.approx(-88.9, abs=0.05)


@pytest.mark.parametrize(
    ("momentum", "prefix"), [((-4.0, -4.0), ""), ((-3.0, -3.0), "less_")], ids=["4", "3"]
)
def test_greatest_and_least_spin_rate(momentum: tuple[float, float], prefix: str) -> None:
    """ΔΩ +5.92 and −1.81 mrad/s with −4 N m s on each axis, 4.44 and −1.36 with −3."""
    motion = spin(momentum)
    for name, value in (
        ("greatest_change_mrad_s", motion.greatest_change_rad_s),
        ("least_change_mrad_s", motion.least_change_rad_s),
    ):
        printed = PRINTED.number("paper_004_spin", prefix + name)
        assert abs(1e3 * value - printed.value) <= 0.5 * printed.step + 1e-9


def test_period_and_mean_rate() -> None:
    """A turn takes 1868 s, and ten of them 5.19 h: 5.1861 h are ten of the closed loop's 1867 s."""
    motion = spin((-4.0, -4.0))
    assert round(motion.period_s) == PRINTED.value("paper_004_spin", "period_s")
    closed = PRINTED.value("paper_004_spin", "closed_loop_period_s")
    ten = PRINTED.number("paper_004_spin", "ten_turns_h")
    assert abs(10 * closed / 3600 - ten.value) <= 0.5 * ten.step + 1e-9
    assert 10 * motion.period_s / 3600 == pytest.approx(5.1894, abs=5e-5)
    # the average rate of eq. (19) in its own terms
    rate, inertia = motion.rate_rad_s, motion.inertia_kg_m2
    square = rate**2 + 2 * rate / inertia * (motion.k1 - motion.k2**2 / (2 * rate * inertia))
    assert motion.mean_rate_rad_s == pytest.approx(np.sqrt(square), rel=1e-12)
    assert motion.mean_rate_rad_s > rate  # "an advantage"
    steady = PRINTED.number("paper_004_spin", "thrusters_ten_turns_h")
    assert abs(20 * np.pi / rate / 3600 - steady.value) <= 0.5 * steady.step + 1e-9


def test_wheel_peaks() -> None:
    """736 rpm with 0.160 kg m² (731 with 0.161), 552 with −3 N m s; 19 % of the time below 300."""
    for key, momentum in (("", (-4.0, -4.0)), ("less_", (-3.0, -3.0))):
        printed = PRINTED.value("paper_004_spin", f"{key}wheel_peak_rpm")
        assert round(peak_rpm(momentum, 0.160)) == printed
    assert round(peak_rpm((-4.0, -4.0), 0.161)) == 731
    assert round(slow_percent(spin((-4.0, -4.0)))) == 19


def test_footnote_with_more_momentum() -> None:
    """H = (−4, −5): rates 10.2 and 1.41 mrad/s as printed; 833 rpm and 17 %, printed 826 and 15.

    826 is the closed loop's 729 rpm in the ratio of both momenta, 825, and not the formula's.
    """
    motion = spin((-4.0, -5.0))
    for name, change in (
        ("more_greatest_rate_mrad_s", motion.greatest_change_rad_s),
        ("more_least_rate_mrad_s", motion.least_change_rad_s),
    ):
        printed = PRINTED.number("paper_004_spin", name)
        assert abs(1e3 * (motion.rate_rad_s + change) - printed.value) <= 0.5 * printed.step + 1e-9
    assert peak_rpm((-4.0, -5.0), 0.160) == pytest.approx(832.7, abs=0.05)
    assert 729 * np.sqrt(41 / 32) == pytest.approx(825.2, abs=0.05)
    assert slow_percent(motion) == pytest.approx(16.6, abs=0.05)


def test_spin_up_and_down() -> None:
    """9.92 g of hydrazine (Table 3, note c)."""
    lever = PRINTED.value("paper_004_text", "moment_arm_m")
    exhaust = PRINTED.value("paper_004_table_1", "specific_impulse_s") * PRINTED.value(
        "paper_004_text", "gravity_m_s2"
    )
    grams = 1e3 * spin_propellant_kg(3518.0, 3.07e-3, lever, exhaust)
    assert grams == pytest.approx(PRINTED.value("paper_004_spin", "hydrazine_g"), abs=0.005)


def test_platform_along_wheel_3() -> None:
    """Appendix D, θ = −120°: p = (0, −√2), peaks √2 |H|, the mean rate of eq. (D4)."""
    p_x, p_y = coupling(-120.0, "dfpw")
    assert p_x == pytest.approx(0.0, abs=1e-12)
    assert p_y == pytest.approx(-np.sqrt(2), rel=1e-12)
    h_x, h_y = -2.0, -3.0
    motion = spin((h_x, h_y), -120.0)
    inertia, rate = motion.inertia_kg_m2, motion.rate_rad_s
    assert motion.k1 == pytest.approx(-np.sqrt(2) * h_y)
    assert motion.k2 == pytest.approx(-np.sqrt(2) * h_x)
    size = np.hypot(h_x, h_y)
    for sign, change in ((1, motion.greatest_change_rad_s), (-1, motion.least_change_rad_s)):
        assert change == pytest.approx(np.sqrt(2) / inertia * (-h_y + sign * size))
    square = rate**2 - 2 * np.sqrt(2) * rate / inertia * h_y - 2 * (h_x / inertia) ** 2
    assert motion.mean_rate_rad_s == pytest.approx(np.sqrt(square))
    peaks = peak_wheel_momentum(axes_of(-120.0), (h_x, h_y))
    np.testing.assert_allclose(peaks, np.sqrt(2) * size)


@pytest.mark.parametrize("momentum", [(-4.0, -4.0), (3.0, -2.0), (-1.0, 1.0)])
def test_angle_of_time_solves_the_equation_of_motion(momentum: tuple[float, float]) -> None:
    """Eq. (17) is what an integrator makes of α̇ = Ω(α) over three turns, whatever the quadrant."""
    motion = spin(momentum)
    time = np.linspace(0.0, 3.2 * motion.period_s, 50)
    found = solve_ivp(
        lambda _, angle: motion.rate_at_rad_s(angle),
        (0.0, time[-1]),
        [0.0],
        t_eval=time,
        rtol=1e-10,
        atol=1e-12,
    )
    np.testing.assert_allclose(motion.angle_rad(time), found.y[0], atol=1e-7)
    turn = motion.angle_rad(motion.period_s)
    assert float(turn) == pytest.approx(2 * np.pi)
    angle = np.linspace(0, 2 * np.pi, 100001)
    change = motion.rate_at_rad_s(angle) - motion.rate_rad_s
    assert change.max() == pytest.approx(motion.greatest_change_rad_s, rel=1e-8)
    assert change.min() == pytest.approx(motion.least_change_rad_s, rel=1e-8)
    rates = motion.held_momentum_n_m_s(angle) @ wheel_torques(axes_of(-94.2), "dfpw", "").T
    peaks = peak_wheel_momentum(axes_of(-94.2), momentum)
    np.testing.assert_allclose(np.abs(rates).max(0), peaks, rtol=1e-8)


def test_momentum_about_z_is_conserved() -> None:
    """Eq. (13): I_zz Ω + p·H stays what it was at every angle, by a sum and not the formula."""
    motion = spin((-4.0, -4.0))
    angle = np.linspace(0.0, 2.0 * np.pi, 37)
    total = motion.inertia_kg_m2 * motion.rate_at_rad_s(angle) + motion.held_momentum_n_m_s(
        angle
    ) @ np.array(motion.coupling)
    np.testing.assert_allclose(total, total[0], rtol=1e-12)


@pytest.mark.parametrize(
    ("controller", "angle"), [("ors", 60.0), ("ors", 120.0), ("dfpw", -60.0), ("dfpw", 120.0)]
)
def test_singular_angles_are_refused(controller: str, angle: float) -> None:
    """At the angles of section VII and VIII one line says why; two degrees beside they work."""
    with pytest.raises(InputError, match=r"one plane with [YZ].*singular angle"):
        torque_coupling(axes_of(angle), controller, "scenario")
    assert np.abs(torque_coupling(axes_of(angle + 2.0), controller)).max() > 5.0 or angle == 120.0


def test_one_wheel_is_refused() -> None:
    """One wheel cannot hold two axes, three are not two."""
    with pytest.raises(InputError, match="1 wheel"):
        torque_coupling(axes_of(-94.2)[:, :1], "ors")
    with pytest.raises(InputError, match="3 wheels"):
        torque_coupling(np.eye(3), "ors")


def test_a_spin_that_stops_is_refused() -> None:
    """|G2| ≥ G1: the wheels' momentum would stop the body before it has come round."""
    with pytest.raises(InputError, match="falls to zero before a turn"):
        spin((4.0, 4.0))
    spin((-4.0, -4.0))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("about = [0.0, 0.0, 1.0]", "about = [0.0, 0.0, 1.1]"), ["about", "unit vector"]),
        (('parameter = "rwa4_articulation_rad"', 'parameter = "rwa4_angle"'), ["'rwa4_angle'"]),
        (
            ('parameter = "rwa4_articulation_rad"', 'parameter = "rwa4_inertia_kg_m2"'),
            ["in rad", "kg m2"],
        ),
        (("axis_at_rad = -2.0943951023931953", 'axis_at_rad = "-120"'), ["axis_at_rad"]),
    ],
)
def test_a_bad_platform_is_refused(
    tmp_path: Path, change: tuple[str, str], words: list[str]
) -> None:
    """A slanted axis, an angle that is not declared or has another unit, text for a number."""
    source = (files("cassini_bayes.spacecraft") / "cassini.toml").read_text(encoding="utf-8")
    assert change[0] in source
    path = tmp_path / "craft.toml"
    path.write_text(source.replace(*change), encoding="utf-8")
    with pytest.raises(InputError) as raised:
        load_spacecraft(path)
    assert all(word in str(raised.value) for word in ["wheel.rwa4.articulation", *words])
