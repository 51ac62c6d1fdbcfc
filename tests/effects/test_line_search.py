"""The search for a line: frequency, direction and cost, and sizes over all lines."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from line_cases import INERTIA, NOISE, SCALES, TIME, body
from totals_cases import ROOT

from cassini_bayes.balance.linearised import InnovationRows, Linear
from cassini_bayes.balance.part_columns import ColumnsByPart, PartColumns
from cassini_bayes.computing.arrays import Array
from cassini_bayes.diagnosis.sizes import summarised
from cassini_bayes.effects import line_directions, line_search, line_shapes
from cassini_bayes.effects.appendage import known_motion, oscillation_series
from cassini_bayes.effects.effect import Setting
from cassini_bayes.effects.flexible_mode import drawn
from cassini_bayes.effects.line_directions import BODY_AXES
from cassini_bayes.effects.line_search import find_oscillation
from cassini_bayes.effects.line_shapes import DAMPED, SIZES, UNDAMPED
from cassini_bayes.effects.line_starts import LineStarts
from cassini_bayes.effects.oscillation import Oscillation
from cassini_bayes.priors.reader import read_priors

PRIORS = read_priors(ROOT / "priors" / "cassini_b_branch_telemetry.toml")


def event(shown: Array, left: Array, time_s: Array = TIME) -> tuple[InnovationRows, Linear]:
    """One event's innovations (n, 3) in N m s about a model that takes up constants alone."""
    n = len(time_s)
    white = left @ np.linalg.inv(NOISE).T
    none = np.zeros((n, 0))
    rows = InnovationRows(
        "one", time_s, white, left, shown, none, none, (), (), NOISE, np.zeros((n, 4))
    )
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
    # a body axis is one of three, or of six where no oblique direction has any of the evidence, and
    # a pair of scales one of sixteen
    assert np.log(3.0 * looks) < found.log_looks < np.log(6.0 * len(SIZES) ** 2 * looks) + 0.1
    monkeypatch.setattr(line_directions, "ALONG_AXES", 1.0 - 1e-12)
    monkeypatch.setattr(line_shapes, "SIZES", (1.0,))
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


def test_a_small_swing_pays_less_for_its_size(monkeypatch: pytest.MonkeyPatch) -> None:
    """A line of 7 σ, a tenth of the prior's scale, gains 3 nats and more by scales of its order.

    Its prior has the scale that it was found with. Control: one as large as the scale gains none,
    and pays what the choice among nine costs at most.
    """
    small = found_in(*swing(OBLIQUE, 7.0, np.random.default_rng(8)))
    noise, left = white(np.random.default_rng(8))
    large = INERTIA[1] * 1.5e-5 * np.cos(2.0 * np.pi * 0.059 * TIME + 1.0)
    left = left + large[:, None] * np.eye(3)[1]
    plain = found_in(noise, left)
    monkeypatch.setattr(line_shapes, "SIZES", (1.0,))
    alone, of_one = found_in(*swing(OBLIQUE, 7.0, np.random.default_rng(8))), found_in(noise, left)
    assert small is not None
    assert plain is not None
    assert alone is not None
    assert of_one is not None

    def net(line: Oscillation) -> float:
        return line.log_gain - line.log_looks

    assert net(small) > net(alone) + 3.0
    assert small.swing_scale < 0.5
    assert small.prior_scales["cosine_rad_s"] == small.swing_scale
    assert plain.swing_scale == 1.0
    assert net(of_one) - 2.0 * np.log(len(SIZES)) < net(plain) < net(of_one) + 2.0


EVENTS = 5


def ringing(phases: Array, sigmas: float, rng: np.random.Generator) -> Oscillation | None:
    """The search on events that each swing by so many σ, 0.059 Hz about Y, from their phases."""
    rows, motions, targets, parts = [], [], [], []
    one = sigmas * NOISE[1, 1] * np.sqrt(2.0 / len(TIME))
    for place, phase in enumerate(phases.tolist()):
        shown, left = white(rng)
        left[:, 1] += one * np.cos(2.0 * np.pi * 0.059 * TIME + phase)
        own, _ = event(shown, left)
        constants = np.kron(np.ones((len(TIME), 1)), np.eye(3))
        rows.append(own)
        motions.append(known_motion(TIME, shown))
        targets.append(own.white.reshape(-1))
        parts.append(PartColumns(np.arange(3 * place, 3 * place + 3), constants))
    width = 3 * len(phases)
    columns = ColumnsByPart(tuple(parts), width)
    linear = Linear(np.concatenate(targets), columns, np.full(width, 1e-6))
    return find_oscillation(rows, motions, linear, INERTIA, SCALES)


def test_events_that_each_start_anew_have_a_line_together(monkeypatch: pytest.MonkeyPatch) -> None:
    """Five events of 6 σ with phases of their own are one line, each with its phase.

    Control: as if all started alike, the same is worth less by tens of nats. Events that do start
    alike are found to, and what the choice costs is the log of two at most.
    """
    rng = np.random.default_rng(12)
    phases = 2.0 * np.pi * np.array([0.0, 0.21, 0.43, 0.62, 0.81])
    own = ringing(phases, 6.0, rng)
    same = ringing(np.zeros(EVENTS), 6.0, np.random.default_rng(13))
    assert own is not None
    assert same is not None
    assert own.direction == (0.0, 1.0, 0.0)
    assert own.frequency_hz == pytest.approx(0.059, abs=0.5 / TIME[-1])
    # c + i s of cos(ωt + p) has the phase −p, the largest event's is 0
    found = np.array([complex(*turn) for turn in own.turns])
    off = found * np.exp(1j * phases)
    assert np.abs(np.angle(off / off.mean())).max() < 3.0 / 6.0
    assert np.abs(found) == pytest.approx(np.ones(EVENTS), abs=3.0 / 6.0)
    assert same.turns == ()
    sizes = drawn_from(own)["amplitude_rad_s"]
    truth = 6.0 * NOISE[1, 1] * np.sqrt(2.0 / len(TIME)) / INERTIA[1]
    assert np.quantile(sizes, 0.01) < truth < np.quantile(sizes, 0.99)
    # of all events' sizes; what dies faster began larger, so that it is known less well
    assert 0.9 < np.std(sizes) / truth * 6.0 * np.sqrt(EVENTS) < 3.0
    net = own.log_gain - own.log_looks
    # every start pays for both its sizes, and one of all is paid for anyway
    scale = own.swing_scale * SCALES[0] * INERTIA[1] / NOISE[1, 1]
    known = scale**2 * len(TIME) / 2.0
    cost = np.log1p(known) - np.log1p(EVENTS * known) / EVENTS
    assert own.log_start == pytest.approx(cost, abs=0.3)
    monkeypatch.setattr(line_search, "starts_of", lambda rows: LineStarts((0,) * len(rows)))
    of_own = ringing(phases, 6.0, np.random.default_rng(12))
    of_same = ringing(np.zeros(EVENTS), 6.0, np.random.default_rng(13))
    assert of_own is not None
    assert of_same is not None
    assert net > of_own.log_gain - of_own.log_looks + 30.0
    paid = of_same.log_gain - of_same.log_looks - (same.log_gain - same.log_looks)
    assert paid == pytest.approx(np.log(2.0), abs=0.05)


def drawn_from(line: Oscillation) -> dict[str, Array]:
    """Sizes drawn as a diagnosis has them."""
    rng = np.random.default_rng(1)
    return {**drawn(Setting(PRIORS.spacecraft, PRIORS.branch, "", line), rng, 4_000)}


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
        swing, moved = rng.choice(SIZES, 2)
        c, s = swing * scales[0] * rng.standard_normal(2)
        share = moved * scales[1] * abs(rng.standard_normal())
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
