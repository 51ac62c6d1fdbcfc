"""Oscillations: the appendage's answer against an integrator, what it must not see, the search."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from cassini_bayes.criticism.columns import known_motion
from cassini_bayes.criticism.innovations import EventRows, Linear
from cassini_bayes.criticism.oscillation import find_oscillation

Array = NDArray[np.float64]
TIME = np.arange(0.0, 1_200.0)
INERTIA = np.array([8_000.0, 7_000.0, 4_000.0])
NOISE = np.diag([0.02, 0.02, 0.01])  # N m s
SCALES = (1e-5, 0.01)


def body(time_s: Array) -> Array:
    """A smooth rate, rad/s, slow beside a sample."""
    return np.asarray(2e-4 * np.sin(2 * np.pi * time_s / 90.0) * np.exp(-time_s / 700.0))


@pytest.mark.parametrize(("frequency", "damping"), [(0.02, 0.0), (0.11, 0.003), (0.2, 0.05)])
def test_the_answer_to_the_bodys_motion_is_that_of_an_integrator(
    frequency: float, damping: float
) -> None:
    """θ'' + 2 ζ Ω θ' + Ω² θ = −ω', to what a line that goes on for one row misses of the rate."""
    omega = 2.0 * np.pi * frequency

    def slope(t: float, x: Array) -> Array:
        drive = (body(np.array(t + 1e-3)) - body(np.array(t - 1e-3))) / 2e-3
        return np.array([x[1], -2.0 * damping * omega * x[1] - omega**2 * x[0] - drive])

    wanted = solve_ivp(slope, (0.0, TIME[-1]), [0.0, 0.0], t_eval=TIME, rtol=1e-9, atol=1e-14).y[1]
    found = known_motion(TIME, body(TIME)[:, None]).appendage(frequency, damping)[:, 0]
    missed = (2.0 * np.pi / 90.0) ** 2 * 2e-4  # ω'' times a second squared
    assert found == pytest.approx(wanted, abs=1.2 * missed)
    assert np.abs(wanted).max() > 8.0 * missed


def test_gaps_between_rows_are_bridged() -> None:
    """Rows left out of a smooth motion change the answer by little."""
    kept = (np.arange(len(TIME)) % 50 > 2) | (np.arange(len(TIME)) < 10)
    whole = known_motion(TIME, body(TIME)[:, None]).appendage(0.05, 0.001)[kept]
    found = known_motion(TIME[kept], body(TIME[kept])[:, None]).appendage(0.05, 0.001)
    assert found == pytest.approx(whole, abs=0.12 * np.abs(whole).max())


def test_a_rows_own_noise_is_not_in_its_columns() -> None:
    """It would be regressed on itself; a column that has it would be (negative control)."""
    noise = np.random.default_rng(1).standard_normal((60_000, 1))
    time_s = np.arange(len(noise), dtype=np.float64)
    known = known_motion(time_s, noise)
    error = 5.0 / np.sqrt(len(noise))
    for column in (known.appendage(0.1, 0.02), known.body):
        alike = float((column * noise).mean() / column.std())
        assert abs(alike) < error
    naive = known.appendage(0.1, 0.02) + known.body - noise
    assert float((naive * noise).mean() / naive.std()) < -10.0 * error


def event(shown: Array, left: Array) -> tuple[EventRows, Linear]:
    """One event's innovations (n, 3) in N m s about a model that takes up constants alone."""
    n = len(TIME)
    white = left @ np.linalg.inv(NOISE).T
    none = np.zeros((n, 0))
    rows = EventRows("one", TIME, white, left, shown, none, none, (), (), NOISE, np.zeros((n, 4)))
    columns = np.kron(np.ones((n, 1)), np.eye(3))
    return rows, Linear(white.reshape(-1), columns, np.full(3, 1e-6), (n,))


def test_a_line_is_found_with_axis_and_frequency() -> None:
    """A free oscillation of 6 σ of everything together, about Y."""
    rng = np.random.default_rng(2)
    left = rng.standard_normal((len(TIME), 3)) @ NOISE.T
    left[:, 1] += 6.0 * NOISE[1, 1] * np.sqrt(2 / len(TIME)) * np.cos(0.37 * TIME + 1.0)
    rows, linear = event(1e-6 * rng.standard_normal((len(TIME), 3)), left)
    found = find_oscillation([rows], linear, INERTIA, SCALES)
    assert found is not None
    assert found.axis == 1
    assert found.frequency_hz == pytest.approx(0.37 / (2.0 * np.pi), abs=0.7 / TIME[-1])
    assert found.log_looks > np.log(3 * 500)


def test_an_appendage_that_only_the_body_drives_is_found() -> None:
    """Steps of the rate, as pulses make them, leave rings that do not keep one phase."""
    rng = np.random.default_rng(3)
    shown = np.zeros((len(TIME), 3))
    for at in rng.integers(20, 1_150, 12):
        shown[at:, 0] += rng.choice([-1.0, 1.0]) * 1e-4
    ring = known_motion(TIME, shown).appendage(0.04, 0.003)
    left = rng.standard_normal((len(TIME), 3)) @ NOISE.T
    left[:, 0] -= 0.006 * INERTIA[0] * ring[:, 0]
    rows, linear = event(shown + 2e-6 * rng.standard_normal(shown.shape), left)
    found = find_oscillation([rows], linear, INERTIA, SCALES)
    assert found is not None
    assert (found.axis, found.frequency_hz) == (0, pytest.approx(0.04, abs=1.0 / TIME[-1]))


def test_events_of_a_few_rows_have_no_oscillation() -> None:
    """Nothing is slower than a drift and faster than half the sampling rate."""
    rows, linear = event(np.zeros((len(TIME), 3)), np.zeros((len(TIME), 3)))
    short = EventRows(
        **{
            **rows.__dict__,
            "time_s": TIME[:6],
            "white": rows.white[:6],
            "rate_rad_s": rows.rate_rad_s[:6],
        }
    )
    assert find_oscillation([short], linear, INERTIA, SCALES) is None
