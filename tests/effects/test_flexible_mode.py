"""Oscillations: the appendage's answer against an integrator, what it must not see, the search."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from totals_cases import ROOT

from cassini_bayes.balance.linearised import EventRows, Linear
from cassini_bayes.balance.part_columns import ColumnsByPart
from cassini_bayes.balance.statistics.rows import Samples
from cassini_bayes.balance.statistics.turns import Pieces, WhiteTurns
from cassini_bayes.computing.arrays import Array
from cassini_bayes.diagnosis.hypotheses import none_hypothesis
from cassini_bayes.diagnosis.innovations import linearise
from cassini_bayes.diagnosis.sizes import summarised
from cassini_bayes.effects import line_directions
from cassini_bayes.effects.appendage import known_motion, oscillation_series, products_of_turns
from cassini_bayes.effects.effect import Remainder, Setting
from cassini_bayes.effects.flexible_mode import Oscillation, drawn, find_oscillation, search
from cassini_bayes.effects.line_directions import BODY_AXES
from cassini_bayes.effects.line_shapes import DAMPED, UNDAMPED
from cassini_bayes.priors.distributions import Distribution
from cassini_bayes.priors.reader import read_priors
from cassini_bayes.studies.blind.flights import Blind, Hidden, Scene
from cassini_bayes.studies.blind.shift import View, at_truth, held, squared_size
from cassini_bayes.studies.blind.sizes import hidden_oscillation

PRIORS = read_priors(ROOT / "priors" / "cassini_b_branch_telemetry.toml")
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
    and squares are good to a quarter.
    """
    rng = np.random.default_rng(7)
    time_s = np.delete(TIME, [5, 6, 40])
    pieces = Pieces(time_s, np.r_[0, 1, 9, 40, 41, np.arange(70, len(time_s), 32), len(time_s)])
    left, frequencies = rng.standard_normal((len(time_s), 3)), np.array([0.011, 0.13])
    left = pieces.centred(left)
    turns = WhiteTurns.over(pieces, np.array([0.0, 0.02, 0.1]))
    squares, along = products_of_turns(turns, 1.0, frequencies, 0.002, left)
    for f, frequency in enumerate(frequencies):
        rate = 2.0 * np.pi * frequency * (1j - 0.002)
        waves = pieces.centred(np.exp(rate * time_s)[:, None] / rate)[:, 0]
        plain = np.column_stack([waves.real, waves.imag])
        for axis, close in enumerate((1e-9, 0.15, 0.25)):
            columns = turns.whitened(plain, axis)
            size = np.diagonal(columns.T @ columns).max()
            assert squares[f, axis] == pytest.approx(columns.T @ columns, abs=close * size)
            assert along[f, :, axis] == pytest.approx(
                columns.T @ left[:, axis], abs=1e-9 * np.sqrt(size * len(left))
            )


def event(shown: Array, left: Array, time_s: Array = TIME) -> tuple[EventRows, Linear]:
    """One event's innovations (n, 3) in N m s about a model that takes up constants alone."""
    n = len(time_s)
    white = left @ np.linalg.inv(NOISE).T
    none = np.zeros((n, 0))
    rows = EventRows("one", time_s, white, left, shown, none, none, (), (), NOISE, np.zeros((n, 4)))
    columns = ColumnsByPart.of(np.kron(np.ones((n, 1)), np.eye(3)), [3 * n])
    return rows, Linear(white.reshape(-1), columns, np.full(3, 1e-6))


def found_in(shown: Array, left: Array, time_s: Array = TIME) -> Oscillation | None:
    """The search on one event."""
    rows, linear = event(shown, left, time_s)
    return find_oscillation([rows], [known_motion(time_s, shown)], linear, INERTIA, SCALES)


def white(rng: np.random.Generator, n: int = len(TIME)) -> tuple[Array, Array]:
    """Rates (rad/s) of nothing but noise, and innovations of it."""
    return 2e-6 * rng.standard_normal((n, 3)), rng.standard_normal((n, 3)) @ NOISE.T


@pytest.mark.parametrize(("hertz", "seconds"), [(0.059, 1_200), (0.41, 3_600)])
def test_a_line_is_found_with_axis_and_frequency(
    hertz: float, seconds: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A free oscillation of 8 σ about Y, at high frequencies of a long event as well."""
    rng = np.random.default_rng(2)
    time_s = np.arange(0.0, seconds)
    shown, left = white(rng, seconds)
    left[:, 1] += 8.0 * NOISE[1, 1] * np.sqrt(2 / seconds) * np.cos(2 * np.pi * hertz * time_s + 1)
    found = found_in(shown, left, time_s)
    assert found is not None
    assert found.direction == (0.0, 1.0, 0.0)
    assert found.frequency_hz == pytest.approx(hertz, abs=1.0 / seconds)
    looks = (np.ceil(0.5 * (seconds - 1)) - 4) * 5  # lines, dampings
    # a body axis is one of three, or of six where no oblique direction has any of the evidence
    assert np.log(3.0 * looks) < found.log_looks < np.log(6.0 * looks) + 0.1
    monkeypatch.setattr(line_directions, "ALONG_AXES", 1.0 - 1e-12)
    about_axis = found_in(shown, left, time_s)
    assert about_axis is not None
    assert about_axis.log_looks == pytest.approx(np.log(3.0 * looks), abs=1e-2)


OBLIQUE = np.array([0.31, -0.82, 0.49]) / np.linalg.norm([0.31, -0.82, 0.49])


def swing(direction: Array, sigmas: float, rng: np.random.Generator) -> tuple[Array, Array]:
    """Rates and innovations of a free swing of 0.059 Hz about a direction, of so many σ."""
    shown, left = white(rng)
    wave = np.cos(2.0 * np.pi * 0.059 * TIME + 1.0)
    one = np.linalg.norm(np.outer(wave, direction) @ np.linalg.inv(NOISE).T)
    return shown, left + sigmas / one * np.outer(wave, direction)


def test_an_oblique_line_is_found_with_its_direction(monkeypatch: pytest.MonkeyPatch) -> None:
    """A line of 9 σ, 2.1, 5.6 and 6.7 of them along X, Y and Z, has its direction.

    A direction is known to 1/9 rad across where all axes are as noisy. Control: about body axes
    alone the line is worth less, by more than what directions cost.
    """
    rates, left = swing(OBLIQUE, 9.0, np.random.default_rng(5))
    found = found_in(rates, left)
    assert found is not None
    assert found.frequency_hz == pytest.approx(0.059, abs=1.0 / TIME[-1])
    assert abs(np.dot(found.direction, OBLIQUE)) > np.cos(3.5 / 9.0)
    assert found.direction_sd_deg == pytest.approx(np.degrees(1.0 / 9.0), rel=0.3)
    x, y, z = (f"{part:.2f}".replace("-", "−") for part in found.direction)
    off = f"{found.direction_sd_deg:.0f}"
    assert found.said == f"about ({x}, {y}, {z}) in body axes, ± {off}° (1 σ)"
    monkeypatch.setattr(line_directions, "ALONG_AXES", 1.0 - 1e-12)
    about_axis = found_in(rates, left)
    assert about_axis is not None
    assert about_axis.direction in BODY_AXES
    assert about_axis.said in {"about X", "about Y", "about Z"}
    assert about_axis.record["direction_sd_deg"] == 0.0
    assert found.log_gain - found.log_looks > about_axis.log_gain - about_axis.log_looks + 10.0


def test_an_appendage_that_only_the_body_drives_is_found() -> None:
    """Steps of the rate, as pulses make them, leave rings that do not keep one phase."""
    rng = np.random.default_rng(3)
    shown = np.zeros((len(TIME), 3))
    for at in rng.integers(20, 1_150, 12):
        shown[at:, 0] += rng.choice([-1.0, 1.0]) * 1e-4
    ring = known_motion(TIME, shown).driven(TIME, 0.04, 0.003)
    noise, left = white(rng)
    left[:, 0] -= 0.006 * INERTIA[0] * ring[:, 0]
    found = found_in(shown + noise, left)
    assert found is not None
    assert (found.direction, found.frequency_hz) == (
        (1.0, 0.0, 0.0),
        pytest.approx(0.04, abs=1.0 / TIME[-1]),
    )


def remainder_with(share: float, line: tuple[float, float], rng: np.random.Generator) -> Remainder:
    """An hour of a body that wheels turn by steps, rates with noise as flown, as a fit leaves it.

    Of the body's motion ω₀ the appendage takes φ q away, and the balance lacks φ J q.
    """
    time_s = np.arange(0.0, 3_600.0)
    still = np.zeros((len(time_s), 3))
    for at in rng.integers(20, 3_500, 60):
        still[at:, 0] += rng.choice([-1.0, 1.0]) * 1e-4
    taken = share / (1.0 - share) * known_motion(time_s, still).driven(time_s, *line)[:, :1]
    taken = taken * np.eye(1, 3)
    noise = 2e-5 * rng.standard_normal(still.shape)
    measured = still - taken + noise
    left = INERTIA * (noise - taken) + rng.standard_normal(still.shape) @ (NOISE / 10.0).T
    none = np.zeros((len(time_s), 0))
    factor = np.diag(2e-5 * INERTIA)
    white = left @ np.linalg.inv(factor).T
    rows = EventRows(
        "one", time_s, white, left, measured, none, none, (), (), factor, np.zeros((len(left), 4))
    )
    columns = np.kron(np.ones((len(left), 1)), np.eye(3))
    linear = Linear(white.reshape(-1), ColumnsByPart.of(columns, [len(columns)]), np.full(3, 1e-6))
    samples = Samples(time_s, np.zeros((len(left), 4)), measured, none, none, none)
    parameters = {
        f"inertia_{axis * 2}_kg_m2": own for axis, own in zip("xyz", INERTIA, strict=True)
    }
    # attitudes that say nothing
    blind = replace(rows, white=0.0 * white, noise_factor=1e9 * factor)
    nothing = 0.0 * columns
    both = Linear(
        np.concatenate([linear.target, nothing[:, 0]]),
        ColumnsByPart.of(np.concatenate([columns, nothing]), [len(columns)] * 2),
        linear.precision,
    )
    return Remainder((samples,), (rows,), linear, parameters, lambda: (both, (rows, blind)))


SHARE_PRIORS = {
    "cosine_rad_s": Distribution("norm", {"loc": 0.0, "scale": SCALES[0]}),
    "inertia_fraction": Distribution("halfnorm", {"scale": SCALES[1]}),
}


def shares(line: Oscillation | None) -> Array:
    """Draws of the share of the inertia."""
    assert line is not None
    setting = Setting(PRIORS.spacecraft, PRIORS.branch, "", line)
    return np.asarray(drawn(setting, np.random.default_rng(1), 4_000)["inertia_fraction"])


def test_noise_of_rates_does_not_hide_what_the_body_drives() -> None:
    """A share of 0.02 is in two or more of three central 90 % intervals, their mean within 20 %.

    Of three sizes of sd 0.0025 the mean is good to 7 %. Driven by measured rates (negative control)
    it comes out half as large: noise drives the answer as well, and goes with nothing.
    """
    share, line = 0.02, (0.08, 0.002)
    found, naive, held = [], [], 0
    for seed in range(3):
        left = remainder_with(share, line, np.random.default_rng(seed))
        draws = shares(search(left, SHARE_PRIORS))
        low, high = np.quantile(draws, [0.05, 0.95])
        held += low < share < high
        found.append(draws.mean())
        motion = known_motion(left.samples[0].time_s, left.samples[0].rate_rad_s)
        naive.append(
            shares(find_oscillation(left.rows, [motion], left.linear, INERTIA, SCALES)).mean()
        )
    assert held >= 2
    assert np.mean(found) == pytest.approx(share, rel=0.2)
    assert np.mean(naive) < 0.7 * share


@pytest.mark.parametrize("hertz", [0.03, 0.06, 0.1])
def test_a_swing_is_integrated_as_it_swings(hertz: float) -> None:
    """Rows four seconds apart: trapezoids see 0.95 to 0.41 of the integral, columns all of it."""
    time_s = np.arange(0.0, 400.0, 4.0)
    none = np.zeros((len(time_s), 0))
    samples = Samples(time_s, np.zeros((len(time_s), 4)), np.zeros((len(time_s), 3)), *[none] * 3)
    cosine = Oscillation(hertz, 0.0, (1.0, 0.0, 0.0)).columns(samples)[0]
    omega = 2.0 * np.pi * hertz
    pieces = Pieces(time_s, np.array([0, 40, 100]))
    by_rows = pieces.integrated(np.cos(omega * time_s)[:, None])[:, 0]
    exact = pieces.centred(np.sin(omega * time_s)[:, None] / omega)[:, 0]
    assert cosine.over_trapezoids * by_rows == pytest.approx(exact, abs=1e-9 / omega)
    assert cosine.over_trapezoids > 1.04


def test_sizes_of_lines_from_the_prior_are_held() -> None:
    """90 % intervals over all lines hold nine of ten of 150, most of which no search could tell.

    Binomial to 3 in 10,000: 135 ± 13. By the best line alone (negative control) fewer than 110 of
    the frequencies are held.
    """
    rng, scales = np.random.default_rng(3), (SCALES[0] / 20.0, SCALES[1] / 20.0)
    time_s = TIME[:600]
    held = dict.fromkeys(("frequency_hz", "inertia_fraction", "amplitude_rad_s", "alone"), 0)
    for _ in range(150):
        noise, left = white(rng, len(time_s))
        shown = noise + body(time_s)[:, None] * np.array([1.0, -0.7, 0.5])
        motion, axis = known_motion(time_s, shown), int(rng.integers(3))
        hertz, damped = rng.uniform(0.007, 0.5), rng.random() > UNDAMPED
        damping = damped * np.exp(rng.uniform(*np.log(DAMPED)))
        cosine, sine, driven = oscillation_series(time_s, motion, hertz, damping)
        c, s = scales[0] * rng.standard_normal(2)
        share = scales[1] * abs(rng.standard_normal())
        left[:, axis] += INERTIA[axis] * (c * cosine + s * sine - share * driven[:, axis])
        rows, linear = event(shown, left, time_s)
        found = find_oscillation([rows], [motion], linear, INERTIA, scales)
        assert found is not None
        assert found.shapes is not None
        # as if rows were those of the balance, which lack what the appendage gives its body
        setting = Setting(PRIORS.spacecraft, PRIORS.branch, "", replace(found, measured=0.0))
        sizes = summarised(drawn(setting, rng, 1_000), np.ones(1_000))
        true = {
            "frequency_hz": hertz,
            "inertia_fraction": share / (1.0 + share),
            "amplitude_rad_s": float(np.hypot(c, s)),
        }
        for key, value in true.items():
            low, high = sizes[key].interval
            held[key] += low <= value <= high
        width = 5.0 * float(np.hypot(1.0 / time_s[-1], found.damping * found.frequency_hz))
        held["alone"] += abs(found.frequency_hz - hertz) < width
    assert held.pop("alone") < 110
    assert all(122 <= count <= 148 for count in held.values()), held


def test_events_of_a_few_rows_have_no_oscillation() -> None:
    """Nothing is slower than a drift and faster than half the sampling rate."""
    short = TIME[:6]
    assert found_in(np.zeros((6, 3)), np.zeros((6, 3)), short) is None


def left_by(view: View, values: dict[str, float], line: Oscillation) -> float:
    """σ of what the true parameters leave with the oscillation in the model at these values."""
    effect = replace(view.events.catalogue.effect("flexible_mode"), search_result=line)
    events = view.events.with_columns_of([effect])
    changed = held(none_hypothesis(events), effect, values)
    other, _ = linearise(changed, view.point, smooth_channels=False)
    left = view.left + other.target - view.linear.target
    return float(np.sqrt(squared_size(view.linear, left)))


def test_an_appendage_flown_in_closed_loop_is_what_the_model_says() -> None:
    """Firings and wheels drive and damp it; frequency, amplitude, share and signs are the model's.

    The parameters of the truth leave a fifth or less (3.7 of 23.8 σ, where a flight with nothing
    hidden leaves 2 to 3); a share of the other sign leaves more than
    no oscillation does, and a free one alone three times as much as what the body drives with it.
    """
    scenario = ROOT / "runs" / "scenarios" / "calibration.toml"
    campaign = Blind(scenario, ROOT / "priors" / "x", 7, ("bias-1",))
    document = campaign.document(np.random.default_rng(7))
    document["truth"] |= {"rate_noise_rad_s": 2e-6, "attitude_noise_rad": 2e-5}
    scene = Scene(campaign, document, 7, PRIORS)
    hidden = {"frequency_hz": 0.04, "damping": 0.002, "axis": 2.0}
    hidden |= {"amplitude_rad_s": 4e-6, "inertia_fraction": 0.01}
    events = scene.fly_quietly((Hidden("flexible_mode", hidden, float("nan")),))
    view = at_truth(events, scene.truth())
    line, values = hidden_oscillation(hidden)
    without = float(np.sqrt(squared_size(view.linear, view.left)))
    assert without > 20.0
    assert left_by(view, values, line) < without / 5.0
    assert left_by(view, values | {"cosine_rad_s": 4e-6}, line) > without
    free = left_by(view, values | {"inertia_fraction": 0.0}, line)
    assert free > 2.0 * left_by(view, values, line)
