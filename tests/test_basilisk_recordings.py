"""Recordings of an independent flight: read as any telemetry, and true to the truth beside them.

``benchmarks/basilisk_closed_loop.py --recordings`` makes them with Basilisk's dynamics. Momentum is
balanced here from the telemetry and ``truth.json`` alone.
"""

from __future__ import annotations

import importlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import pytest

from cassini_bayes.balance.telemetry_noise import own_thrusts_n
from cassini_bayes.computing.arrays import Array
from cassini_bayes.diagnosis.hypotheses import none_hypothesis
from cassini_bayes.diagnosis.read import read_events
from cassini_bayes.events.plausibility import check_telemetry
from cassini_bayes.events.telemetry import Mends, load_event, read_chunks, read_event
from cassini_bayes.model.nominal import nominal_values
from cassini_bayes.priors.reader import read_priors

ROOT: Final = Path(__file__).parents[1]
DATA: Final = ROOT / "tests" / "data" / "basilisk"
RECORDINGS: Final = tuple(sorted(path.parent for path in DATA.glob("*/truth.json")))
EVENTS: Final = tuple(sorted(path.parent for path in DATA.glob("*/*/event.toml")))
THRUSTERS: Final = ("z1", "z2", "z3", "z4", "y1", "y2", "y3", "y4")
QUIET_S: Final = 1.0
SIGMAS: Final = 5.0


def name(path: Path) -> str:
    """Recording and event, as the name of a test."""
    return str(path.relative_to(DATA))


@pytest.fixture(params=EVENTS, ids=name)
def folder(request: pytest.FixtureRequest) -> Path:
    """An event of a recording."""
    return Path(request.param)


def truth_of(folder: Path) -> dict[str, Any]:
    """What was flown."""
    return dict(json.loads((folder.parent / "truth.json").read_text("utf-8")))


# ---- balance of momentum, written out ------------------------------------------------------------


def rotations(q: Array) -> Array:
    """Inertial-to-body matrices, written out element by element."""
    x, y, z, w = q.T
    return np.array(
        [
            [w * w + x * x - y * y - z * z, 2 * (x * y + w * z), 2 * (x * z - w * y)],
            [2 * (x * y - w * z), w * w - x * x + y * y - z * z, 2 * (y * z + w * x)],
            [2 * (x * z + w * y), 2 * (y * z - w * x), w * w - x * x - y * y + z * z],
        ]
    ).transpose(2, 0, 1)


def wheel_axes(value: dict[str, float], numbers: tuple[int, ...]) -> Array:
    """Spin axes as columns; wheel 4 stands beside wheel 3, tilted."""
    up = np.array([0.0, 0.0, 1.0])
    columns = []
    for number in numbers:
        angle = np.deg2rad({1: 90.0, 2: 210.0, 3: 330.0, 4: 330.0}[number])
        out = np.array([np.cos(angle), np.sin(angle), 0.0])
        axis = np.sqrt(2.0 / 3.0) * out + np.sqrt(1.0 / 3.0) * up
        first = np.cross(up, out)
        axis = axis + value.get(f"rwa{number}_tilt_u_rad", 0.0) * first
        axis = axis + value.get(f"rwa{number}_tilt_v_rad", 0.0) * np.cross(axis, first)
        columns.append(axis / np.linalg.norm(axis))
    return np.stack(columns, axis=1)


def torques(truth: dict[str, Any], event: str) -> tuple[Array, Array]:
    """Torque of each thruster (8, 3) at its steady thrust, and of all that is steady (3,)."""
    value = truth["parameters"]
    effects = {effect["name"]: effect["parameters"] for effect in truth["effects"]}
    centre = np.array([value[f"cm_{axis}_m"] for axis in "xyz"])
    rows, steady = [], np.array([value[f"external_torque_{axis}_n_m"] for axis in "xyz"])
    for thruster in THRUSTERS:
        side = {"1": (1, 1), "2": (-1, 1), "3": (-1, -1), "4": (1, -1)}[thruster[1]]
        height = value["thruster_lzz_m" if thruster[0] == "z" else "thruster_lzy_m"]
        place = (side[0] * value["thruster_lx_m"], side[1] * value["thruster_ly_m"], height)
        force = np.array([0.0, 0.0, -1.0] if thruster[0] == "z" else [0.0, -side[1], 0.0])
        cant = effects.get(f"thruster_misalignment:{thruster}", {})
        force[0] += cant.get("cant_a_rad", 0.0)
        force[1 if thruster[0] == "z" else 2] += cant.get("cant_b_rad", 0.0)
        turn = np.cross(np.array(place) - centre, force / np.linalg.norm(force))
        rows.append(turn * truth["events"][event]["thrust_n"][thruster])
        steady = steady + turn * effects.get(f"thruster_leak:{thruster}", {}).get("leak_n", 0.0)
    return np.array(rows), steady


def tails_s(pulses: list[list[int]], value: dict[str, float]) -> Array:
    """What each pulse delivers beyond its width: slow rise, long tail, unless the next cuts it."""
    rise, fall = value["tau_rise_s"], value["tau_fall_s"]
    before, after = [], []
    level, closed = 0.0, -np.inf
    for start, width in pulses:
        level *= np.exp(-1e-3 * (start - closed) / fall)
        before.append(level)
        level = 1.0 - (1.0 - level) * np.exp(-1e-3 * width / rise)
        after.append(level)
        closed = start + width
    left = np.array([*before[1:], 0.0]) if before else np.zeros(0)
    return fall * (np.array(after) - left) - rise * (np.array(after) - np.array(before))


@dataclass(frozen=True)
class Closure:
    """What is left of the balance at rows long after a firing (n, 3), in units of its noise.

    ``rounded``: counters round the on-times; their rounding, no white noise, is only bounded.
    """

    left: Array
    rounded: bool

    @property
    def excess(self) -> float:
        """(χ² − n)/√(2 n): about a standard normal if the truth is true and the noise white."""
        count = 3 * (len(self.left) - 1)
        return float((np.sum(self.left**2) - count) / np.sqrt(2.0 * count))


def closure(folder: Path, truth: dict[str, Any], priors_of: Path) -> Closure:
    """Balance of momentum in the inertial frame at the truth, whitened row by row."""
    spacecraft = read_priors(priors_of / "priors.toml").spacecraft
    event = read_event(folder, spacecraft)
    chunk = load_event(event, spacecraft)
    value, conditions = truth["parameters"], truth["conditions"]
    own = truth["events"][event.id]
    whole = ~np.isnan(chunk.attitude[:, 0])
    if event.kind == "bias":
        whole &= ~np.isnan(chunk.on_time_s[:, 0])
    time_s, turn = chunk.time_s[whole], rotations(chunk.attitude[whole])
    inertia = np.array(
        [[value[f"inertia_{''.join(sorted(a + b))}_kg_m2"] for a in "xyz"] for b in "xyz"]
    )
    spin = np.array([value[f"rwa{number}_inertia_kg_m2"] for number in event.wheels])
    arms = wheel_axes(value, event.wheels) * spin
    wheels = chunk.wheel_rpm[whole] * np.pi / 30.0
    body = chunk.rate_rad_s[whole] @ inertia + wheels @ arms.T
    thruster, steady = torques(truth, event.id)
    impulse = np.diff(time_s)[:, None] * steady
    quiet = np.ones(len(time_s), dtype=bool)
    rounded, rounding = False, np.zeros((3, 3))
    if event.kind == "bias":
        fired = [own["firings_ms"].get(k, []) for k in THRUSTERS]
        effective = chunk.on_time_s[whole].copy()
        for k, pulses in enumerate(fired):
            counted = chunk.pulses[whole, k].astype(int)
            effective[:, k] += np.concatenate([[0.0], np.cumsum(tails_s(pulses, value))])[counted]
            for start, width in pulses:
                since = time_s - 1e-3 * start
                quiet &= (since < 0.0) | (since > 1e-3 * width + QUIET_S)
        impulse += np.diff(effective, axis=0) @ thruster
        step = conditions["counter_step_s"]
        widths = np.array([width for pulses in fired for _, width in pulses])
        rounded = bool(np.any(widths % round(1e3 * step)))
        rounding = rounded * step**2 / 12.0 * thruster.T @ thruster
    inertial = np.einsum("nji,nj->ni", turn, body)
    middle = 0.5 * (turn[1:] + turn[:-1])
    inertial[1:] -= np.cumsum(np.einsum("nji,nj->ni", middle, impulse), axis=0)
    left = (inertial - inertial[quiet].mean(axis=0))[quiet]
    noise = rounding + row_noise(conditions, inertia, arms, body)
    seen = np.einsum("nij,nj->ni", turn[quiet], left)
    return Closure(np.linalg.solve(np.linalg.cholesky(noise), seen.T).T, rounded)


def row_noise(conditions: dict[str, Any], inertia: Array, arms: Array, body: Array) -> Array:
    """Covariance of one row: noise and least steps of rates, wheel rates and attitudes."""
    rate = conditions["rate_noise_rad_s"] ** 2 + conditions["rate_step_rad_s"] ** 2 / 12.0
    wheel = conditions["wheel_noise_rpm"] ** 2 + conditions["wheel_step_rpm"] ** 2 / 12.0
    printed = (2.0 * 10.0 ** -conditions["attitude_digits"]) ** 2 / 12.0
    across = np.mean(np.sum(body**2, axis=1)) * np.eye(3) - body.T @ body / len(body)
    return np.asarray(
        rate * inertia @ inertia
        + wheel * (np.pi / 30.0) ** 2 * arms @ arms.T
        + (conditions["attitude_noise_rad"] ** 2 + printed) * across
    )


# ---- tests ---------------------------------------------------------------------------------------


def test_there_are_six_small_recordings() -> None:
    """Six recordings, three with a hidden effect, together at most 4 MB."""
    hidden = [json.loads((r / "truth.json").read_text("utf-8"))["effects"] for r in RECORDINGS]
    assert len(RECORDINGS) == 6
    assert sum(bool(effects) for effects in hidden) == 3
    assert sum(path.stat().st_size for path in DATA.rglob("*") if path.is_file()) <= 4e6


def test_every_event_is_read_without_a_mend_and_is_plausible(folder: Path) -> None:
    """The readers take every row as it is, and the balance at nominal values names no mistake."""
    priors = read_priors(folder.parent / "priors.toml")
    event = read_event(folder, priors.spacecraft)
    mends = Mends()
    chunks = list(read_chunks(event, priors.spacecraft, mends=mends))
    assert [line for line in mends.lines() if "norm" not in line] == []
    found = check_telemetry(event, chunks, priors.spacecraft, nominal_values(priors))
    assert found.rows >= 12
    assert not found.findings


def test_counters_are_those_of_the_commanded_firings(folder: Path) -> None:
    """On-times and pulses at every row are those of the firings in the truth, to half a step."""
    truth = truth_of(folder)
    spacecraft = read_priors(folder.parent / "priors.toml").spacecraft
    event = read_event(folder, spacecraft)
    if event.kind != "bias":
        pytest.skip("no counters in a slew")
    chunk = load_event(event, spacecraft)
    sampled = ~np.isnan(chunk.on_time_s[:, 0])
    now_ms = np.round(1e3 * chunk.time_s[sampled])[:, None]
    half = 0.5 * truth["conditions"]["counter_step_s"] + 1e-9
    for k, thruster in enumerate(THRUSTERS):
        firings = truth["events"][event.id]["firings_ms"].get(thruster, [])
        start, width = np.array(firings).reshape(-1, 2).T
        on_time = 1e-3 * np.clip(now_ms - start, 0.0, width).sum(axis=1)
        assert np.abs(chunk.on_time_s[sampled, k] - on_time).max() <= half
        assert np.array_equal(chunk.pulses[sampled, k], (now_ms >= start).sum(axis=1))


def test_momentum_closes_at_the_truth(folder: Path) -> None:
    """With the true parameters the balance of momentum is left with the channels' noise alone."""
    found = closure(folder, truth_of(folder), folder.parent)
    assert found.excess < SIGMAS
    assert found.rounded or found.excess > -SIGMAS


@pytest.mark.parametrize("recording", RECORDINGS, ids=name)
def test_momentum_does_not_close_away_from_the_truth(recording: Path) -> None:
    """A wheel of 3 % more inertia, or thrusts 5 % higher, and the balance stays open."""
    folder = recording / "1-bias"
    heavier = truth_of(folder)
    heavier["parameters"]["rwa2_inertia_kg_m2"] *= 1.03
    stronger = truth_of(folder)
    thrusts = stronger["events"]["1-bias"]["thrust_n"]
    thrusts |= {thruster: 1.05 * thrust for thruster, thrust in thrusts.items()}
    for wrong in (heavier, stronger):
        assert closure(folder, wrong, recording).excess > SIGMAS


HIDDEN: Final = tuple(
    r for r in RECORDINGS if json.loads((r / "truth.json").read_text("utf-8"))["effects"]
)


@pytest.mark.parametrize("recording", HIDDEN, ids=name)
def test_what_is_hidden_shows(recording: Path) -> None:
    """Without its hidden effect the truth does not close every bias of a recording."""
    folders = [event.parent for event in recording.glob("*-bias/event.toml")]
    without = truth_of(folders[0])
    for effect in without["effects"]:
        kind, _, target = effect["name"].partition(":")
        if kind == "thruster_degraded":
            for event in without["events"].values():
                event["thrust_n"][target] /= effect["parameters"]["thrust_factor"]
    without["effects"] = []
    assert max(closure(folder, without, recording).excess for folder in folders) > SIGMAS


@pytest.mark.parametrize("branch", ["A", "B"])
def test_the_generator_reads_the_priors_as_they_are(
    branch: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It draws a truth from the shipped priors, and what it states of channels is a distribution
    or a value, never both: only flights need Basilisk.
    """
    if not (ROOT / "benchmarks").is_dir():
        pytest.skip("benchmarks are no part of a source distribution")
    monkeypatch.syspath_prepend(ROOT / "benchmarks")
    cassini = importlib.import_module("closed_loop.cassini")
    priors = cassini.read_priors(ROOT / "priors" / "cassini_b_branch_telemetry.toml", branch)
    truth = cassini.draw_truth(priors, ("1-bias",), np.random.default_rng(1))
    assert set(truth.thrust_n["1-bias"]) == set(cassini.THRUSTERS)
    assert 0.1 < truth.parameters["rwa1_inertia_kg_m2"] < 0.2
    stated = cassini.stated_priors(priors, 2e-6, {"attitude_noise_rad": 1e-5})["parameters"]
    assert stated["attitude_noise_rad"]["fixed"] == 1e-5
    assert all(("fixed" in table) != ("dist" in table) for table in stated.values())


@pytest.mark.parametrize("law", ["phase_plane", "pulse_frequency", "pulse_width"])
def test_controllers_command_nothing_in_the_past(law: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Far outside its dead-band and first called in a later cycle, each fires from then on.

    The filters of one had run from time zero, so that its first pulses were counted and never
    flown: their valves would have had to open before anybody asked.
    """
    if not (ROOT / "benchmarks").is_dir():
        pytest.skip("benchmarks are no part of a source distribution")
    monkeypatch.syspath_prepend(ROOT / "benchmarks")
    control = importlib.import_module("closed_loop.thruster_control")
    rng = np.random.default_rng(2)
    pilot = control.draw_law(law, (7e3, 6e3, 4e3), 1e-3, rng).start()
    fired = []
    for cycle in range(1, 17):
        now_ms = cycle * control.CYCLE_MS
        firings = pilot.fire([0.02, -0.02, 0.02], [1e-3, -1e-3, 1e-3], now_ms)
        fired += firings
        assert all(f.start_ms >= now_ms for f in firings)
    assert len(fired) > 3


def test_the_generator_does_not_know_the_package() -> None:
    """No file that makes the recordings so much as names the package's modules."""
    if not (ROOT / "benchmarks").is_dir():
        pytest.skip("benchmarks are no part of a source distribution")
    sources = [ROOT / "benchmarks" / "basilisk_closed_loop.py"]
    sources += sorted((ROOT / "benchmarks" / "closed_loop").glob("*.py"))
    assert len(sources) > 10
    for source in sources:
        assert "cassini_bayes" not in source.read_text("utf-8"), source.name


@pytest.mark.parametrize("recording", ["degraded-thruster", "leak", "misaligned-thruster"])
def test_what_pulses_delivered_is_known_as_well_as_stated(
    recording: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What first-order valves deliver for the recorded firings is what the balance takes, or noise.

    Negative control: without twenty pulses of a thruster, which counters have, it is far from that.
    """
    if not (ROOT / "benchmarks").is_dir():
        pytest.skip("benchmarks are no part of a source distribution")
    monkeypatch.syspath_prepend(ROOT / "benchmarks")
    pulses = importlib.import_module("basilisk_pulses")
    monkeypatch.setattr(pulses, "SHARES", (0.003, 0.3))
    truth = truth_of(DATA / recording / "1-bias")
    fired = [event for event in truth["events"] if event.endswith("bias")]
    told = pulses.told_of(DATA / recording, fired, truth)
    assert not told.is_fault, told
    firings = truth["events"][fired[0]]["firings_ms"]
    thruster = max(firings, key=lambda each: len(firings[each]))
    middle = len(firings[thruster]) // 2
    del firings[thruster][middle : middle + 20]
    monkeypatch.setattr(pulses, "SHARES", (told.share,))
    lacking = pulses.told_of(DATA / recording, fired, truth)
    assert lacking.is_fault, lacking


@pytest.mark.parametrize(("recording", "least"), [("pulse-width-sparse", 0.9), ("leak", 0.95)])
def test_thrusts_that_size_noise_are_those_of_the_tails_at_a_point(
    recording: str, least: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What counters leave open is momentum by the true thrust at the true time constants.

    Negative control: told at the prior means, thrusts are a quarter too small where tails are 17 ms
    for 50, and 8 % where they are 44 ms.
    """
    if not (ROOT / "benchmarks").is_dir():
        pytest.skip("benchmarks are no part of a source distribution")
    monkeypatch.syspath_prepend(ROOT / "benchmarks")
    pulses = importlib.import_module("basilisk_pulses")
    folder, truth = DATA / recording, truth_of(DATA / recording / "1-bias")
    fired = [event for event in truth["events"] if event.endswith("bias")]
    none = none_hypothesis(read_events([folder / name for name in fired], folder / "priors.toml"))
    points = none.model.points(pulses.point_of(none, truth, 0.1)[None])
    for term in none.model.telemetry:
        event = term.event
        fires = np.nanmax(event.samples.pulses, axis=0) > 5.0  # those of few pulses tell less
        true = np.array([truth["events"][event.id]["thrust_n"][name] for name in event.thrusters])
        own = own_thrusts_n(term.balance, term.physics(points))[0] / true
        assert own[fires].mean() == pytest.approx(1.0, abs=0.03)
        assert (term.balance.thrusts_n / true)[fires].mean() < least
