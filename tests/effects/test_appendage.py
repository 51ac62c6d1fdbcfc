"""An appendage's answer to its body, against an integrator; what it must not see; its sums."""

from __future__ import annotations

import numpy as np
import pytest
from line_cases import TIME, body
from scipy.integrate import solve_ivp

from cassini_bayes.balance.statistics.turns import Pieces, WhiteTurns
from cassini_bayes.computing.arrays import Array
from cassini_bayes.effects.appendage import known_motion, oscillation_series, products_of_turns


@pytest.mark.parametrize(("frequency", "damping"), [(0.02, 0.0), (0.11, 0.003), (0.2, 0.05)])
def test_the_answer_to_the_bodys_motion_is_that_of_an_integrator(
    frequency: float, damping: float
) -> None:
    """θ'' + 2 ζ Ω θ' + Ω² θ = −ω': what lines between rows leave falls with the step squared."""
    omega = 2.0 * np.pi * frequency

    def slope(t: float, x: Array) -> Array:
        drive = (body(np.array(t + 1e-3)) - body(np.array(t - 1e-3))) / 2e-3
        return np.array([x[1], -2.0 * damping * omega * x[1] - omega**2 * x[0] - drive])

    wanted = solve_ivp(slope, (0.0, TIME[-1]), [0.0, 0.0], t_eval=TIME, rtol=1e-9, atol=1e-14).y[1]
    errors = []
    for step in (1.0, 0.25):
        fine = np.arange(0.0, TIME[-1] + step / 2, step)
        found = known_motion(fine, body(fine)[:, None]).driven(TIME, frequency, damping)[:, 0]
        errors.append(np.abs(found - wanted).max())
    assert errors[1] < 0.1 * errors[0]
    assert errors[1] < 0.01 * np.abs(wanted).max()


def test_samples_that_are_missing_are_bridged() -> None:
    """Channels at other times are NaN in between: the grid is that of the rate's own samples."""
    slow = np.where(np.arange(len(TIME)) % 4 == 0, body(TIME), np.nan)[:, None]
    at = TIME[::4]
    whole = known_motion(at, body(at)[:, None]).driven(at, 0.02, 0.001)
    assert known_motion(TIME, slow).driven(at, 0.02, 0.001) == pytest.approx(whole)


def test_a_rows_own_noise_is_not_in_its_columns() -> None:
    """It would be regressed on itself; a column that has it is (negative control)."""
    noise = np.random.default_rng(1).standard_normal((60_000, 1))
    time_s = np.arange(len(noise), dtype=np.float64)
    column = known_motion(time_s, noise).driven(time_s, 0.1, 0.02)
    error = 1.0 / np.sqrt(len(noise))
    assert abs(float((column * noise).mean() / column.std())) < 5.0 * error
    naive = column + np.roll(noise, 1) - noise  # the body's rate of the row itself
    assert float((naive * noise).mean() / naive.std()) < -50.0 * error


def test_sums_over_rows_are_those_of_the_series() -> None:
    """Products made in one pass equal those of the series, with rows missing and times uneven."""
    rng = np.random.default_rng(6)
    time_s = np.delete(TIME, [5, 6, 40]) + 1e-7 * rng.standard_normal(len(TIME) - 3)
    motion = known_motion(time_s, rng.standard_normal((len(time_s), 3)))
    left, frequencies = rng.standard_normal((len(time_s), 3)), np.array([0.011, 0.13])
    squares, along = motion.products(time_s, frequencies, 0.002, left)
    for f, frequency in enumerate(frequencies):
        cosine, sine, driven = oscillation_series(time_s, motion, frequency, 0.002)
        columns = np.column_stack([cosine, sine, driven])
        size = np.sqrt(np.diagonal(columns.T @ columns))
        assert squares[f] == pytest.approx(columns.T @ columns, abs=1e-9 * size.max() ** 2)
        assert along[f] == pytest.approx(
            columns.T @ left, abs=1e-9 * size.max() * np.sqrt(len(left))
        )


def test_sums_over_turns_are_those_of_the_integrated_series() -> None:
    """One pass over pieces of unlike lengths, rows missing, equals series written out.

    Where attitudes have all the noise; where wheels have some, sums with what is left stay exact
    and squares are good to a quarter. Directions are whitened axes, or lie between them.
    """
    rng = np.random.default_rng(7)
    time_s = np.delete(TIME, [5, 6, 40])
    pieces = Pieces(time_s, np.r_[0, 1, 9, 40, 41, np.arange(70, len(time_s), 32), len(time_s)])
    left, frequencies = rng.standard_normal((len(time_s), 3)), np.array([0.011, 0.13])
    left = pieces.centred(left)
    turns = WhiteTurns.over(pieces, np.array([0.0, 0.02, 0.1]))
    units = np.array([[1.0, 0.0, 0.6], [0.0, 1.0, -0.8], [0.0, 0.0, 2.0]])
    motion = known_motion(TIME, np.zeros((len(TIME), 3)))
    squares, along = products_of_turns(turns, motion, frequencies, 0.002, left, units)
    for f, frequency in enumerate(frequencies):
        rate = 2.0 * np.pi * frequency * (1j - 0.002)
        waves = pieces.centred(np.exp(rate * time_s)[:, None] / rate)[:, 0]
        plain = np.column_stack([waves.real, waves.imag])
        for place, close in enumerate((1e-9, 0.15, 0.25)):
            momentum = units[:, place, None] * plain[:, None, :]
            columns = turns.whitened_axes(momentum).reshape(3 * len(left), -1)
            size = np.diagonal(columns.T @ columns).max()
            assert squares[f, place] == pytest.approx(columns.T @ columns, abs=close * size)
            assert along[f, :, place] == pytest.approx(
                columns.T @ left.reshape(-1), abs=1e-9 * np.sqrt(size * left.size)
            )


@pytest.mark.parametrize("start_s", [600.0, 3_600.0, 86_400.0])
def test_a_free_oscillation_begins_with_its_event(start_s: float) -> None:
    """Series and sums of events that begin long after their epoch are those of one that does not.

    Had it rung since the epoch, a twelfth of the line at 0.13 Hz would be left after 600 s, and
    4e-7 after an hour.
    """
    rng = np.random.default_rng(8)
    rate, left = rng.standard_normal((2, len(TIME), 3))
    frequencies, damping = np.array([0.011, 0.13]), 0.005
    pieces = Pieces(TIME, np.r_[np.arange(0, len(TIME), 32), len(TIME)])
    later = Pieces(TIME + start_s, pieces.ends)
    motion, own = known_motion(TIME, rate), known_motion(TIME + start_s, rate)
    for frequency in frequencies:
        plain = oscillation_series(TIME, motion, frequency, damping)
        found = oscillation_series(TIME + start_s, own, frequency, damping)
        for one, other in zip(found, plain, strict=True):
            assert one == pytest.approx(other, abs=1e-7 * np.abs(other).max())
    each = (
        (
            motion.products(TIME, frequencies, damping, left),
            own.products(TIME + start_s, frequencies, damping, left),
        ),
        tuple(
            products_of_turns(
                WhiteTurns.over(of, np.full(3, 0.02)), moved, frequencies, damping, left, np.eye(3)
            )
            for of, moved in ((pieces, motion), (later, own))
        ),
    )
    for plain_sums, sums in each:
        for one, other in zip(sums, plain_sums, strict=True):
            assert one == pytest.approx(other, abs=1e-7 * np.abs(other).max())
    assert np.exp(-damping * 2.0 * np.pi * 0.13 * start_s) < 0.1
