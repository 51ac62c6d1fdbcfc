"""Mistakes that no single cell shows are refused by name; faults of a spacecraft never are."""

from __future__ import annotations

import copy
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, replace
from functools import cache
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from scipy import signal
from simulation_cases import BIAS, EPOCH, PARAMETERS, SLEWS
from spacecraft_cases import TWELVE, middle
from totals_cases import B_BRANCH, FLIGHT

from cassini_bayes.computing.arrays import Array
from cassini_bayes.diagnosis.read import read_events
from cassini_bayes.errors import InputError
from cassini_bayes.events.plausibility import (
    STRICT,
    MistakeError,
    Nominal,
    Policy,
    TelemetryCheck,
    check_telemetry,
    check_totals,
    content_of_totals,
    likelier,
    momentum,
    refuse_duplicates,
)
from cassini_bayes.events.plausibility.cells import CellSearch
from cassini_bayes.events.plausibility.departures import WIDTHS, Correction
from cassini_bayes.events.plausibility.evidence import Evidence, without_cut_pulses
from cassini_bayes.events.plausibility.hypotheses import (
    SILENT,
    _is_sharp,
    _lies_along,
    explanations,
)
from cassini_bayes.events.plausibility.likelier import (
    LIKELIER,
    Likelier,
    by_evidence,
    likeliest,
    with_scaled_rates,
)
from cassini_bayes.events.plausibility.rows import Motion, RowCollector, Rows
from cassini_bayes.events.plausibility.shifts import of_shifts
from cassini_bayes.events.plausibility.turning import BY_CHANCE, turning_of
from cassini_bayes.events.plausibility.undone import of_wheels
from cassini_bayes.events.plausibility.verdict import SUSPECT, Explanation
from cassini_bayes.events.telemetry import (
    Chunk,
    TelemetryEvent,
    load_event,
    read_chunks,
    read_event,
)
from cassini_bayes.events.telemetry.channel_map import channel_map_of
from cassini_bayes.events.totals import TotalsEvent, read_totals
from cassini_bayes.model.nominal import check_rows, nominal_values
from cassini_bayes.pipeline.inputs import read_inputs
from cassini_bayes.pipeline.run_file import check_run
from cassini_bayes.pipeline.starting import write_starting_files
from cassini_bayes.priors.distributions import Distribution
from cassini_bayes.priors.reader import Priors, read_priors
from cassini_bayes.simulation import read_scenario, scenario_of
from cassini_bayes.spacecraft import load_spacecraft
from cassini_bayes.spacecraft.units import RAD_S_PER_RPM
from cassini_bayes.studies.mistakes.kinds import TELEMETRY
from cassini_bayes.studies.mistakes.oracle import answer_of
from cassini_bayes.studies.scenario import simulate_file, write_simulation

CASSINI = load_spacecraft("cassini")
NOMINAL = {**PARAMETERS, "thrust_common_n": 0.75, "fsw_impulse_offset_s": 0.01}
DOCUMENT: Mapping[str, Any] = {
    "spacecraft": {"name": "cassini", "branch": "B", "wheels": [1, 2, 4]},
    "truth": NOMINAL,
    "event": [
        {**BIAS, "epoch": EPOCH},
        {
            "id": "slews",
            "kind": "slew",
            "epoch": EPOCH,
            "from_rpm": (300.0, -500.0, 700.0),
            "slew": [slew.model_dump() for slew in SLEWS[:4]],
        },
    ],
    "telemetry": {
        "rate_noise_rad_s": 2e-6,
        "wheel_noise_rpm": 0.2,
        "attitude_noise_rad": 2e-5,
        "on_time_resolution_s": 0.001,
    },
}
ROOT = Path(__file__).parents[2]
Event = tuple[TelemetryEvent, Chunk]


def simulated(
    folder: Path, truth: Mapping[str, float], effect: Mapping[str, Any] | None
) -> list[Event]:
    """The bias and the slews of a scenario, read back."""
    document = copy.deepcopy(dict(DOCUMENT))
    document["truth"] = {**NOMINAL, **truth}
    document["effect"] = [] if effect is None else [dict(effect)]
    write_simulation(simulate_file(scenario_of(document), 5), folder)
    events = [read_event(folder / name, CASSINI) for name in ("bias", "slews")]
    return [(event, load_event(event, CASSINI)) for event in events]


@pytest.fixture(scope="module")
def honest(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Event]:
    """Events without any fault."""
    events = simulated(tmp_path_factory.mktemp("honest"), {}, None)
    return {event.kind: (event, chunk) for event, chunk in events}


# ---- telemetry -----------------------------------------------------------------------------------

QUICK = {
    "bias": (
        "first two wheels exchanged",
        "wheels in rad/s",
        "z1 and z3 exchanged",
        "y1 and y2 exchanged",
        "pulses doubled",
        "x and y rates exchanged",
        "quaternions scalar-first",
        "times in ms",
        "second wheel jumps by 100 rpm",
        "on-times in ms",
        "counters 8 s early",
        "attitudes 8 s late",
    ),
    "slew": (
        "wheels rotated",
        "second wheel stuck",
        "second wheel + 500 rpm",
        "first wheel − 50 rpm",
        "last wheel × 1.2",
        "wheels 8 s late",
        "sign of y rate",
        "rates × 1.1",
        "rates zero",
        "quaternions inverse",
    ),
}
"""A part of the table of docs/results/mistakes.md: one of each family, where it shows."""


@pytest.fixture(scope="module")
def refusal(honest: dict[str, Event]) -> Callable[[str, str], InputError]:
    """The error with which a mistake in an event of a kind is refused, worked out once."""

    @cache
    def refused(kind: str, mistake: str) -> InputError:
        event, chunk = honest[kind]
        with pytest.raises(InputError) as caught:
            check_telemetry(event, [TELEMETRY[mistake].change(chunk)], CASSINI, NOMINAL)
        return caught.value

    return refused


@pytest.mark.parametrize(
    ("kind", "mistake"), [(kind, mistake) for kind, names in QUICK.items() for mistake in names]
)
def test_a_mistake_is_named(
    refusal: Callable[[str, str], InputError], kind: str, mistake: str
) -> None:
    """Refused with the file in the message, under the right name, which is how to accept it."""
    error = refusal(kind, mistake)
    assert error.fix.rpartition("--accept ")[2] in TELEMETRY[mistake].names
    assert "telemetry.csv" in error.where


@pytest.mark.parametrize(
    ("left", "is_along"),
    [((60.0, 0.0, 0.0), True), ((30.0, 10.0, 30.0), False), ((20.0, 20.0, 0.0), False)],
)
def test_a_channel_that_stands_still_is_stuck_only_if_the_misfit_is_along_it(
    left: tuple[float, ...], is_along: bool
) -> None:
    """Without any axis some misfit is gone: of a wheel at rest that says nothing.

    Six biases by another simulator with pulses of 20 to 125 ms: two had a misfit of 58 and 44, no
    axis in particular, and were refused for a wheel that had ended its ramp.
    """

    class Shared:
        """A misfit with parts along the three axes."""

        def excess_across(self, axis: np.ndarray) -> float:
            return float(np.sum(np.array(left) * (1.0 - axis**2)))

    axis = np.array([1.0, 0.0, 0.0])
    evidence = cast("Evidence", Shared())
    assert _lies_along(evidence, axis, SILENT * evidence.excess_across(axis)) == is_along


@pytest.mark.parametrize(("shift", "inverted"), [(1, True), (-1, False), (-1, True)])
@pytest.mark.parametrize("kind", ["bias", "slew"])
def test_a_scalar_in_the_wrong_place_of_a_channel_map_is_named(
    honest: dict[str, Event], kind: str, shift: int, *, inverted: bool
) -> None:
    """With the direction right, the order wrong: no clock is blamed, and the map is pointed to."""
    event, chunk = honest[kind]
    inverse = np.array([-1.0, -1.0, -1.0, 1.0]) if inverted else np.ones(4)
    read = replace(chunk, attitude=np.roll(chunk.attitude * inverse, shift, axis=1) * inverse)
    mapped = replace(event, channels=channel_map_of({"channels": {}}, "own/channels.toml"))
    with pytest.raises(InputError, match="quaternions that look scalar-") as caught:
        check_telemetry(mapped, [read], CASSINI, NOMINAL)
    assert "order or direction in own/channels.toml" in caught.value.fix


def test_an_accepted_mistake_is_said(honest: dict[str, Event]) -> None:
    """What was refused passes with its name accepted, and stays among the findings."""
    event, chunk = honest["bias"]
    wrong = TELEMETRY["first two wheels exchanged"].change(chunk)
    found = check_telemetry(event, [wrong], CASSINI, NOMINAL, Policy.of(["wheel-order"]))
    assert len(found.findings) == 1
    assert "wheel-order" in found.findings[0]


def test_rows_far_apart_are_asked_for_no_shift(honest: dict[str, Event]) -> None:
    """Times in ms: a row lies further off than any shift, so that there is none to try."""
    event, chunk = honest["bias"]
    collected = RowCollector()
    collected.add(TELEMETRY["times in ms"].change(chunk))
    nominal = Nominal.of(CASSINI, event.branch, event.wheels, NOMINAL, fires=True)
    evidence = Evidence(nominal, collected.motion(), collected.rows())
    assert not list(of_shifts(evidence, 1e9))


def evidence_of(event: TelemetryEvent, chunk: Chunk) -> Evidence:
    """What the checks look at."""
    collected = RowCollector()
    collected.add(chunk)
    nominal = Nominal.of(CASSINI, event.branch, event.wheels, NOMINAL, fires=bool(event.thrusters))
    return Evidence(nominal, collected.motion(), collected.rows())


def test_messages_name_the_wheels_as_the_spacecraft_file_does(honest: dict[str, Event]) -> None:
    """Units, orders, factors, still columns and bad cells: none speaks of Cassini's rwa columns."""
    event, chunk = honest["bias"]
    twelve = load_spacecraft(TWELVE)
    own = Nominal.of(twelve, "P", (1, 2, 5), middle("twelve"), fires=True).wheel_names
    assert own == ("w1", "w2", "w5")
    still = chunk.wheel_rpm.copy()
    still[:, 1] = still[0, 1]
    evidence = evidence_of(event, replace(chunk, wheel_rpm=still))
    evidence = replace(evidence, nominal=replace(evidence.nominal, wheel_names=own))
    found = list(explanations(evidence, event.wheels, event.thrusters))
    said = " ".join(f"{each.what} {each.fix}" for each in found)
    assert "convert w1_rpm, w2_rpm, w5_rpm to rev/min" in said
    assert "a column w2_rpm that stands still" in said
    assert "rwa" not in said
    cell = chunk.wheel_rpm.copy()
    cell[40, 0] += 300.0
    search = CellSearch(evidence.nominal)
    assert [bad.column for bad in search.find(replace(chunk, wheel_rpm=cell))] == ["w1_rpm"]


def test_a_small_error_hides_in_any_torque_and_any_bias(
    honest: dict[str, Event], monkeypatch: pytest.MonkeyPatch
) -> None:
    """50 rpm too few are named: not so if torque may wander as it likes, or rates be off so.

    The honest slew gains nothing by any mistake.
    """
    event, chunk = honest["slew"]
    wrong = TELEMETRY["first wheel − 50 rpm"].change(chunk)

    def gain(given: Chunk) -> float:
        return by_evidence(evidence_of(event, given), event.wheels, event.thrusters)[0].gain

    found, nothing = gain(wrong), gain(chunk)
    monkeypatch.setattr(momentum, "DRIFT_LEVELS", (1.0,))
    any_torque = gain(wrong)
    monkeypatch.setattr(Evidence, "_bias_rad_s", None)
    assert nothing < 0.0
    assert found > 5.0 * LIKELIER
    assert any_torque < 0.5 * found
    assert gain(wrong) < min(any_torque, LIKELIER)


def test_where_thrusters_fire_what_is_likelier_must_close_the_balance_better(
    honest: dict[str, Event], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A step of a wheel, which evidence prefers, is no mistake of an honest bias; in slews it is.

    (There the evidence alone finds 50 rpm, as the misfit lets any torque wander.)
    """

    def preferred(given: Evidence, wheels: Sequence[int], _thrusters: Sequence[str]) -> list[Any]:
        assert given.rows is not None
        found = of_wheels(given.as_recorded, given.nominal, wheels, given.rows)
        return [
            Likelier(next(each for each in found if each.correction.wheel_jump), 2.0 * LIKELIER)
        ]

    monkeypatch.setattr(likelier, "by_evidence", preferred)
    for kind, mistakes in (("bias", []), ("slew", ["wheel-offset"])):
        event, chunk = honest[kind]
        found = likeliest(evidence_of(event, chunk), event.wheels, event.thrusters)
        assert [each.mistake for each in found] == mistakes


def test_a_wheel_at_rest_has_no_factor(honest: dict[str, Event]) -> None:
    """One that shows a value and its neighbours: what seems to move is its rounding.

    A drift of half a step looks five times as large where its noise is a twelfth of a step, and a
    factor of 0.64 closed the balance of an honest flight. A wheel that turns keeps its factor.
    """
    event, chunk = honest["slew"]
    given = evidence_of(event, chunk)
    rows = given.rows
    assert rows is not None
    resting = rows.wheel_rpm.copy()
    resting[:, 1] = np.where(np.arange(len(resting)) % 5 < 2, -346.0, -345.0)
    for wheel_rpm, scaled in ((rows.wheel_rpm, [0, 1, 2]), (resting, [0, 2])):
        own = replace(rows, wheel_rpm=wheel_rpm)
        found = of_wheels(given.as_recorded, given.nominal, event.wheels, own)
        assert [w for each in found for w in each.correction.wheel_factor] == scaled


def settling(seed: int) -> Evidence:
    """Wheels that come to rest between two printed values, steps of 1 rpm; the body answers."""
    rng, time_s = np.random.default_rng(seed), np.arange(0.0, 1500.0, 2.0)
    nominal = Nominal.of(CASSINI, "B", (1, 2, 4), NOMINAL, fires=False)
    left = np.exp(-time_s / 100.0)[:, None] * rng.uniform(0.3, 1.0, 3)
    wheels = np.array([-641.0, -160.0, -176.0]) + rng.uniform(-0.5, 0.5, 3) + left
    answered = -np.linalg.solve(nominal.inertia, nominal.of_wheels(left).T).T
    rates = answered + 2e-6 * rng.standard_normal(left.shape)
    printed = np.round(wheels + 0.02 * rng.standard_normal(left.shape))
    attitude = np.tile([0.0, 0.0, 0.0, 1.0], (len(time_s), 1))
    nothing = np.zeros((len(time_s), 0))
    return Evidence(nominal, None, Rows(time_s, attitude, rates, printed, nothing, nothing))


def test_wheels_that_come_to_rest_close_as_well_as_their_steps(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """What a printed value is off by stays while it stays, which second differences do not see.

    An honest quiescent event by another simulator (1,491 rows) had a misfit of 38, and was refused.
    Control: with roundings as white noise some of thirty events have half of what is asked about.
    """
    assert max(settling(seed).misfit() for seed in range(30)) < 1.0
    monkeypatch.setattr(momentum, "rest_of", lambda wheel_rpm: np.zeros(wheel_rpm.shape[1]))
    assert max(settling(seed).misfit() for seed in range(30)) > 0.5 * SUSPECT


def test_a_resting_wheel_is_off_for_as_long_as_it_shows_a_value() -> None:
    """Runs of four rows in steps of 0.5 rpm; one value alone, and a wheel that turns, add none."""
    runs = np.repeat([3.0, 3.5, 3.0, 3.5, 3.0], 4)
    wheels = np.column_stack([runs, np.full(20, 7.0), np.arange(20.0)])
    expected = 4.0 * (0.5 * RAD_S_PER_RPM) ** 2 / 12.0
    assert momentum.rest_of(wheels) == pytest.approx([expected, 0.0, 0.0])


def test_wheels_beside_a_body_at_rest_have_no_order(
    honest: dict[str, Event], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of noise about constant rates no exchange, sign or factor gains; those of a slew may.

    Control: without the rule some of twenty such events gain by chance of noises unlike by axis.
    """
    event, chunk = honest["slew"]
    evidence = evidence_of(event, chunk)
    assert evidence.momentum is not None
    nominal = evidence.nominal
    wrong = [replace(Correction.nothing(nominal), wheel=np.eye(3)[[1, 0, 2]])]
    assert np.isfinite(evidence.momentum.gains(nominal, wrong)[0]).all()

    def resting(seed: int) -> Chunk:
        rng, rows = np.random.default_rng(seed), len(chunk.time_s)
        angle = np.column_stack([1e-5 * rng.standard_normal((rows, 3)), np.ones(rows)])
        wheels = np.array([762.0, -381.0, 354.0]) + 0.7 * rng.standard_normal((rows, 3))
        return replace(
            chunk,
            attitude=angle / np.linalg.norm(angle, axis=1, keepdims=True),
            rate_rad_s=2e-6 * rng.standard_normal((rows, 3)),
            wheel_rpm=np.round(wheels),
        )

    def best(seed: int) -> float:
        given = evidence_of(event, resting(seed))
        return by_evidence(given, event.wheels, event.thrusters)[0].gain

    assert max(best(seed) for seed in range(20)) < 0.5 * LIKELIER
    monkeypatch.setattr(momentum, "MOST_NOISE_SHARE", np.inf)
    assert max(best(seed) for seed in range(20)) > 0.5 * LIKELIER


@pytest.mark.parametrize("kind", ["bias", "slew"])
def test_a_gain_is_that_of_the_evidence(honest: dict[str, Event], kind: str) -> None:
    """Against dense covariances of all rows, V = σ² + Σ departures: yᵀV⁻¹y + log|V|."""
    event, chunk = honest[kind]
    evidence = evidence_of(event, chunk)
    nominal, whole = evidence.nominal, evidence.momentum
    assert whole is not None
    nothing = Correction.nothing(nominal)
    wrong = replace(nothing, wheel=np.eye(3)[[1, 0, 2]])
    names, design = nominal.departures
    noise = whole.noise(nominal, nothing)

    def cost(target: Array, level: float) -> float:
        scale = np.where(np.array(names) == "drift", level, 1.0)
        departed = whole.flat @ (design * scale) / noise
        covariance = np.eye(len(departed)) + departed @ departed.T
        left = whole.flat @ target / noise
        volume = np.linalg.slogdet(covariance)[1]
        price = np.log(level * WIDTHS["drift"] / momentum.USUAL_DRIFT) ** 2
        return float(left @ np.linalg.solve(covariance, left) + volume + price)

    def least(correction: Correction) -> float:
        moved = momentum.corrected(whole.columns, nominal.exchanges[:, :1], correction)[:, 0]
        return min(cost(moved, level) for level in momentum.DRIFT_LEVELS)

    (gain,), (size,) = whole.gains(nominal, [wrong])
    assert size == 1.0
    assert gain <= least(nothing) - least(wrong) + 1e-6  # firing that vanishes has a price besides
    if kind == "slew":
        assert gain == pytest.approx(least(nothing) - least(wrong), rel=1e-6)
    assert whole.evidence(nominal, noise) == pytest.approx(least(nothing), rel=1e-6)


def test_a_unit_is_named_where_it_fits_better_than_others_nearby(
    honest: dict[str, Event],
) -> None:
    """Wheels in deg/s are; a factor that takes wheels out of an honest balance is not."""
    event, chunk = honest["slew"]
    for given, sharp in ((TELEMETRY["wheels in deg/s"].change(chunk), True), (chunk, False)):
        evidence = evidence_of(event, given)
        assert evidence.rows is not None
        shown = (evidence.as_recorded, evidence.nominal, event.wheels, evidence.rows)
        units = [
            each
            for each in of_wheels(*shown)
            if each.is_unit and each.correction.wheel[0, 0] == pytest.approx(1.0 / 6.0)
        ]
        fits = [(each.correction, evidence.balance(each.correction)) for each in units]
        found = [_is_sharp(evidence, own, fit.excess) for own, fit in fits if fit is not None]
        assert found == [sharp]


def test_scaled_rates_are_said_with_a_scaled_wheel(honest: dict[str, Event]) -> None:
    """Where doubled rates explain as much as a wheel's factor; not where they do not."""
    event, chunk = honest["slew"]
    best = (Explanation("wheel-factor", "a wheel", "check it", 5.0, 12.0),)
    halved = evidence_of(event, TELEMETRY["rates × 0.5"].change(chunk))
    assert "rate-factor" in [each.mistake for each in with_scaled_rates(halved, best)]
    assert with_scaled_rates(evidence_of(event, chunk), best) == best


def test_an_unknown_mistake_cannot_be_accepted() -> None:
    """A misspelt name is told the nearest."""
    with pytest.raises(InputError, match="wheel-order"):
        Policy.of(["wheels-order"])


def test_an_honest_event_closes(honest: dict[str, Event]) -> None:
    """Without faults nothing is left beyond noise."""
    for event, chunk in honest.values():
        found = check_telemetry(event, [chunk], CASSINI, NOMINAL)
        assert found.misfit < 15.0
        assert found.rows > 100
        assert not found.findings


FAULTS: list[tuple[dict[str, float], dict[str, Any] | None]] = [
    ({"thrust_common_n": 0.75 * 1.3}, None),
    ({"thrust_common_n": 0.75 * 0.7}, None),
    ({"cm_x_m": 0.23, "cm_y_m": -0.043, "cm_z_m": 1.164}, None),
    ({"rwa1_inertia_kg_m2": 0.161 * 1.05, "rwa2_inertia_kg_m2": 0.16 * 0.95}, None),
    ({"rwa1_inertia_kg_m2": 0.161 * 0.9}, None),
    ({"rwa4_tilt_u_rad": 0.0275, "rwa4_tilt_v_rad": -0.0375}, None),
    ({"inertia_xx_kg_m2": 6558 * 1.1, "inertia_xy_kg_m2": 0.0}, None),
    ({"tau_fall_s": 0.12}, None),
    (dict.fromkeys([f"external_torque_{axis}_n_m" for axis in "xyz"], 0.004), None),
    ({}, {"name": "thruster_leak:z3", "parameters": {"leak_n": 0.006}}),
    ({}, {"name": "thruster_degraded:z3", "parameters": {"thrust_factor": 0.6}}),
    ({}, {"name": "pulse_shape", "parameters": {"impulse_time_offset_s": 0.06}}),
    ({}, {"name": "time_offset", "parameters": {"time_offset_s": 1.5}}),
    ({}, {"name": "rate_bias:x", "parameters": {"rate_bias_x_rad_s": 1e-5}}),
    ({}, {"name": "rate_scale:y", "parameters": {"rate_scale": 0.02}}),
]


@pytest.mark.parametrize(("truth", "effect"), FAULTS)
def test_an_honest_fault_is_never_refused(
    tmp_path: Path, truth: dict[str, float], effect: dict[str, Any] | None
) -> None:
    """Faults of the spacecraft as large as the diagnosis must find pass."""
    for event, chunk in simulated(tmp_path, truth, effect):
        check_telemetry(event, [chunk], CASSINI, NOMINAL)


@pytest.mark.parametrize("factor", [0.7, 1.3])
def test_what_is_left_of_all_firings_is_what_was_fired(tmp_path: Path, factor: float) -> None:
    """Thrust that falls costs more than its normal prior says, and not thrust that grows."""
    (event, chunk), _ = simulated(tmp_path, {"thrust_common_n": factor * 0.75}, None)
    balance = evidence_of(event, chunk).balance()
    assert balance is not None
    assert balance.impulse == pytest.approx(factor, rel=0.03)


def test_a_balance_that_nothing_closes_is_flagged(honest: dict[str, Event]) -> None:
    """Wheel rates of another event: no mistake is named, and the event is not passed silently."""
    event, chunk = honest["bias"]
    swing = 1500.0 * np.sin(np.linspace(0.0, 20.0, chunk.rows))
    wrong = replace(chunk, wheel_rpm=swing[:, None] * np.array([1.0, 0.3, -0.9]))
    try:
        found = check_telemetry(event, [wrong], CASSINI, NOMINAL).findings
    except InputError as error:
        found = (error.got,)
    assert len(found) == 1
    assert "% of the exchanged momentum unexplained" in found[0]


def test_chunks_are_judged_alike(honest: dict[str, Event], monkeypatch: pytest.MonkeyPatch) -> None:
    """Rows kept do not depend on the chunks, stay few, and give the same verdict and digest."""
    event, chunk = honest["bias"]
    monkeypatch.setattr("cassini_bayes.events.plausibility.rows.MOST_BALANCE_ROWS", 200)
    check = TelemetryCheck(event, CASSINI, NOMINAL)
    for part in read_chunks(event, CASSINI, 300):
        check.take(part)
    by_parts = check.verdict()
    whole = check_telemetry(event, [chunk], CASSINI, NOMINAL)
    assert by_parts == whole
    assert 100 <= whole.rows <= 200


def test_too_few_rows_are_not_judged(honest: dict[str, Event]) -> None:
    """Without common rows nothing is checked, and the record says so."""
    event, chunk = honest["slew"]
    blind = replace(chunk, rate_rad_s=np.full_like(chunk.rate_rad_s, np.nan))
    found = check_telemetry(event, [blind], CASSINI, NOMINAL)
    assert found.rows == 0
    assert np.isnan(found.misfit)


def quick_limit_cycle(late_rows: int = 0, factor: float = 1.0) -> Motion:
    """A body fired at every few seconds, sampled every 4 s: noise of 1e-5 rad and 1.7e-5 rad/s."""
    rng = np.random.default_rng(18)
    kicks = rng.normal(0.0, 1e-4, (3_000, 3)) * (rng.random((3_000, 3)) < 0.3)
    rate = signal.lfilter([1.0], [1.0, -0.6], kicks, axis=0)
    angle = np.cumsum(rate, axis=0)[::4] + rng.normal(0.0, 1e-5, (750, 3))
    attitude = np.concatenate([0.5 * angle, np.ones((750, 1))], axis=1)
    attitude /= np.linalg.norm(attitude, axis=1, keepdims=True)
    measured = factor * (rate[::4] + rng.normal(0.0, 1.7e-5, (750, 3)))
    whole = slice(late_rows, 750)
    return Motion(4.0 * np.arange(750 - late_rows), attitude[: 750 - late_rows], measured[whole])


def test_a_body_at_rest_has_no_axes() -> None:
    """An hour of noise is no rotation of noise; control: a body that moves, by other axes."""
    rng, rows = np.random.default_rng(2), 3_600
    time_s = np.arange(float(rows))
    rates = 2e-5 * rng.standard_normal((rows, 3))
    turn = 0.5e-5 * rng.standard_normal((rows, 3))
    resting = turning_of(Motion(time_s, np.column_stack([turn, np.ones(rows)]), rates))
    assert resting is not None
    assert resting.misaligned(np.eye(3)) < 0.3 * BY_CHANCE
    slow = 1e-4 * np.sin(0.01 * time_s[:, None] + np.array([0.0, 1.0, 2.0]))
    moved = 0.5 * np.cumsum(slow, axis=0) + turn
    attitude = np.column_stack([moved, np.ones(rows)])
    attitude /= np.linalg.norm(attitude, axis=1, keepdims=True)
    exchanged = turning_of(Motion(time_s, attitude, slow[:, [1, 0, 2]] + rates))
    assert exchanged is not None
    assert exchanged.misaligned(np.eye(3)) > 10.0 * BY_CHANCE


def test_attitudes_are_aligned_where_neighbours_know_nothing() -> None:
    """A quick limit cycle: the same interval tells axes, signs and lags; honest, it is chance."""
    honest = turning_of(quick_limit_cycle())
    late = turning_of(quick_limit_cycle(late_rows=2))
    assert honest is not None
    assert late is not None
    assert honest.misaligned(np.eye(3)) < 0.5 * BY_CHANCE
    for wrong in (-np.eye(3), np.eye(3)[[1, 0, 2]], np.diag([1.0, -1.0, -1.0])):
        assert honest.misaligned(wrong) > 4.0 * BY_CHANCE
    assert late.misaligned(np.eye(3)) > 4.0 * BY_CHANCE
    # a factor or another unit of time must not hide a lag
    assert late.misaligned(57.3 * np.eye(3)) > 2.0 * BY_CHANCE


def test_a_first_catch_turns_no_axes() -> None:
    """Seconds of thrust in the first row, before what its rates show: no rotation by degrees.

    A flight by another simulator was refused for it (body rates about z × 0.90). Control: nothing
    is known of what was fired.
    """
    rng, rows = np.random.default_rng(19), 300
    time_s = 4.0 * np.arange(rows)
    slow = 1e-5 * np.sin(0.005 * time_s[:, None] + np.array([0.0, 1.0, 2.0]))
    fired = np.zeros((rows, 3))
    fired[1:] = [1.6e-4, -0.2e-4, 4.0e-4]
    rate = slow - fired[-1] * (np.arange(rows) == 0)[:, None]
    turn = np.concatenate([np.zeros((1, 3)), np.cumsum(2.0 * (rate[1:] + rate[:-1]), axis=0)])
    turn[1:] += 1.5 * fired[-1] * [1.0, 1.0, -1.0]  # at other moments about each axis
    attitude = np.column_stack([0.5 * (turn + rng.normal(0.0, 1e-5, turn.shape)), np.ones(rows)])
    attitude /= np.linalg.norm(attitude, axis=1, keepdims=True)
    motion = Motion(time_s, attitude, rate + rng.normal(0.0, 2e-6, rate.shape))
    unknown, known = turning_of(motion), turning_of(motion, None, fired[None])
    assert unknown is not None
    assert known is not None
    assert unknown.misaligned(np.eye(3)) > 2.0 * BY_CHANCE
    assert known.misaligned(np.eye(3)) < 0.3 * BY_CHANCE
    exchanged = np.eye(3)[[1, 0, 2]]
    assert known.misaligned(exchanged) > 4.0 * BY_CHANCE


def fired_with_the_rows() -> tuple[Motion, Array]:
    """Rows every second while wheels ramp, all pulses beginning with a row; and the wheels' drive.

    Rates have noise of 2e-6 rad/s, attitudes of 1e-5 rad.
    """
    rng, rows = np.random.default_rng(21), 1_900
    time_s = np.arange(float(rows))
    ramp = np.select([time_s < 500, time_s < 1_400], [0.0, 1.0], 0.0)[:, None] * [1.0, -0.7, 0.5]
    gained = 1.5e-5 * ramp
    rate, turn, kick = np.zeros((rows, 3)), np.zeros((rows, 3)), 8e-5
    for i in range(rows - 1):
        fired = -kick * np.sign(rate[i]) * (np.abs(rate[i] + 0.02 * turn[i]) > 4e-5)
        turn[i + 1] = turn[i] + rate[i] + fired + 0.5 * gained[i]
        rate[i + 1] = rate[i] + fired + gained[i]
    attitude = np.column_stack([0.5 * (turn + rng.normal(0.0, 1e-5, turn.shape)), np.ones(rows)])
    attitude /= np.linalg.norm(attitude, axis=1, keepdims=True)
    measured = rate + rng.normal(0.0, 2e-6, rate.shape)
    return Motion(time_s, attitude, measured), np.cumsum(gained, axis=0)


def test_pulses_that_begin_with_rows_are_no_factor_of_rates() -> None:
    """The mean of two rates is off by half the fall between pulses, as long as wheels ramp.

    With the wheels' drive that is no misfit; without, it is far beyond chance. A factor of two
    stays one.
    """
    motion, drive = fired_with_the_rows()
    plain, driven = turning_of(motion), turning_of(motion, drive)
    assert plain is not None
    assert driven is not None
    chance = 18.0 + 4.0 * 6.0  # of 18 moments, four standard deviations
    assert plain.misfit(np.eye(3)) > 2.0 * chance
    assert driven.misfit(np.eye(3)) < chance
    assert driven.misfit(2.0 * np.eye(3)) > 2.0 * chance


def cycle_in_step_with_rows() -> tuple[Motion, Array, Array]:
    """Rows every 4 s, a pulse every 8.03 s beside a slow swing; rates by wheels, by thrusters.

    Rates have noise of 2e-6 rad/s, attitudes of 1e-5 rad. The moment of a pulse drifts past the
    rows once in 2,100 s.
    """
    rng, rows, every_s, kick = np.random.default_rng(22), 420, 8.03, 1.5e-5
    time_s = 4.0 * np.arange(rows)
    fine_s = np.arange(0.0, time_s[-1] + 0.005, 0.01)
    fired, drive = kick * np.floor(fine_s / every_s), -kick * fine_s / every_s
    rate = fired + drive + 5e-5 * np.sin(2.0 * np.pi * fine_s / 900.0)
    turn = np.concatenate([[0.0], np.cumsum(0.005 * (rate[1:] + rate[:-1]))])
    at = np.searchsorted(fine_s, time_s - 1e-6)
    turn, rate, drive, fired = (np.tile(each[at, None], 3) for each in (turn, rate, drive, fired))
    attitude = np.column_stack([0.5 * (turn + rng.normal(0.0, 1e-5, turn.shape)), np.ones(rows)])
    attitude /= np.linalg.norm(attitude, axis=1, keepdims=True)
    measured = rate + rng.normal(0.0, 2e-6, rate.shape)
    return Motion(time_s, attitude, measured), drive, fired


def test_a_limit_cycle_in_step_with_the_rows_is_no_factor_of_rates() -> None:
    """The mean of two rates is off by up to half a pulse, the same for many rows.

    A bias by another simulator, with a pulse in every other row of 4 s, was refused for body rates
    about z × 0.63. A factor of two stays one.
    """
    motion, drive, fired = cycle_in_step_with_rows()
    unknown, known = turning_of(motion, drive), turning_of(motion, drive, fired[None])
    assert unknown is not None
    assert known is not None
    chance = 18.0 + 4.0 * 6.0  # of 18 moments, four standard deviations
    assert unknown.misfit(np.eye(3)) > chance
    assert known.misfit(np.eye(3)) < chance
    assert known.misfit(2.0 * np.eye(3)) > 2.0 * chance


def pushed_to_and_fro() -> tuple[Motion, Array]:
    """Rows every second, and near the ends of a slow swing a pulse back and one forth in each.

    The motion, and what was gained one way (n, 3); as much was lost the other way. Rates have noise
    of 2e-6 rad/s, attitudes of 1e-5 rad.
    """
    rng, rows, size, kick = np.random.default_rng(23), 640, 2e-4, 4e-4
    time_s = np.arange(float(rows))
    rate = size * np.sin(2.0 * np.pi * time_s / 100.0)
    middle = 0.5 * (rate[1:] + rate[:-1])
    kicked = kick * (np.abs(middle) > 0.98 * size)
    # for a quarter of a second the body turns back
    turn = np.concatenate([[0.0], np.cumsum(middle - 0.25 * np.sign(middle) * kicked)])
    gained = np.concatenate([[0.0], np.cumsum(kicked)])
    turn, rate, gained = (np.tile(each[:, None], 3) for each in (turn, rate, gained))
    attitude = np.column_stack([0.5 * (turn + rng.normal(0.0, 1e-5, turn.shape)), np.ones(rows)])
    attitude /= np.linalg.norm(attitude, axis=1, keepdims=True)
    return Motion(time_s, attitude, rate + rng.normal(0.0, 2e-6, rate.shape)), gained


def test_pulses_to_and_fro_within_a_row_are_no_factor_of_rates() -> None:
    """Opposite pulses in one row leave its rates as they were, and its turn is another.

    What stays of them is nothing, and turns then speak against honest rates; each is counted by
    itself. A factor of two stays one.
    """
    motion, gained = pushed_to_and_fro()
    left = turning_of(motion, None, (gained - gained)[None])
    each = turning_of(motion, None, np.stack([gained, -gained]))
    assert left is not None
    assert each is not None
    chance = 18.0 + 4.0 * 6.0  # of 18 moments, four standard deviations
    assert left.misfit(np.eye(3)) > chance
    assert each.misfit(np.eye(3)) < 0.6 * chance
    assert each.misfit(2.0 * np.eye(3)) > 10.0 * chance


@pytest.fixture(scope="module")
def observed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Event, Priors]:
    """A flight of the example spacecraft, as the how-to for another spacecraft has it.

    One pulse turns it ten times as fast as one turns Cassini.
    """
    folder = tmp_path_factory.mktemp("observer")
    shutil.copy(ROOT / "docs" / "examples" / "observer.toml", folder)
    write_starting_files(folder, str(folder / "observer.toml"))
    (folder / "scenario.toml").write_text(OBSERVED, encoding="utf-8")
    scenario = read_scenario(folder / "scenario.toml")
    write_simulation(simulate_file(scenario, 15), folder / "flown")
    priors = read_priors(folder / "priors.toml")
    event = read_event(folder / "flown" / "first", priors.spacecraft)
    return (event, load_event(event, priors.spacecraft)), priors


OBSERVED = """
[spacecraft]
file = "observer.toml"
branch = "main"
wheels = [1, 2, 3]

[truth]
draw_from = "priors.toml"

[[event]]
id = "first"
kind = "bias"
epoch = 2026-01-01T00:00:00Z
from_rpm = [-900.0, 800.0, 500.0]
to_rpm = [700.0, -300.0, 400.0]
"""


@pytest.mark.parametrize(("factor", "refused"), [(1.0, ""), (1.0 / 60.0, "rate")])
def test_a_nimble_spacecraft_is_judged_by_its_rates(
    observed: tuple[Event, Priors], factor: float, refused: str
) -> None:
    """The how-to's own flight passes, which was refused for body rates about z × 0.55.

    Rates that are sixty times too large are named.
    """
    (event, chunk), priors = observed
    check = TelemetryCheck(event, priors.spacecraft, nominal_values(priors))
    check.take(replace(chunk, rate_rad_s=factor * chunk.rate_rad_s))
    if not refused:
        assert check.verdict().misfit < SUSPECT
        return
    with pytest.raises(MistakeError) as error:
        check.verdict()
    assert error.value.mistakes[0].startswith(refused)


@pytest.mark.parametrize(
    ("element", "departure"), [("inertia_xz_kg_m2", -900.0), ("inertia_yz_kg_m2", 900.0)]
)
def test_a_product_of_inertia_is_no_mistake(tmp_path: Path, element: str, departure: float) -> None:
    """A product of inertia far from nominal acts with every pulse, which the mean of the rows
    around does not show: the misfits were 104 and 134.

    Two biases by another simulator were refused for wheels × 1.18 and × 1.24.
    """
    event, chunk = simulated(tmp_path, {element: NOMINAL[element] + departure}, None)[0]
    assert check_telemetry(event, [chunk], CASSINI, NOMINAL).misfit < 30.0  # where one is asked


def test_rows_between_equal_counters_are_used(honest: dict[str, Event]) -> None:
    """Counters every 10 s: quiet rows between count, the same however the chunks are cut."""
    chunk = honest["bias"][1]
    sparse = np.arange(chunk.rows) % 10 != 0
    counters = {name: getattr(chunk, name).copy() for name in ("on_time_s", "pulses")}
    for values in counters.values():
        values[sparse] = np.nan
    rare = replace(chunk, **counters)
    whole, parts = RowCollector(), RowCollector()
    whole.add(rare)
    for start in range(0, chunk.rows, 37):
        parts.add(rows_of_chunk(rare, slice(start, start + 37)))
    rows, again = whole.rows(), parts.rows()
    assert rows is not None
    assert again is not None
    assert len(rows.time_s) > 1.5 * np.count_nonzero(~sparse)
    np.testing.assert_array_equal(rows.on_time_s, again.on_time_s)
    # filled in with what the counters were
    place = np.searchsorted(chunk.time_s, rows.time_s)
    np.testing.assert_array_equal(rows.on_time_s, chunk.on_time_s[place])


def test_readings_amid_pulses_are_no_mistake(tmp_path: Path) -> None:
    """A row in the middle of a pulse has counted a tail that is still to come."""
    document = copy.deepcopy(dict(DOCUMENT))
    each = ("attitude", "rate", "wheel", "counter")
    document["telemetry"] |= {f"{name}_every_s": 0.025 for name in each}
    document["telemetry"] |= {"rate_noise_rad_s": 2e-7, "wheel_resolution_rpm": 0.1}
    document["event"] = document["event"][:1]
    write_simulation(simulate_file(scenario_of(document), 5), tmp_path)
    event = read_event(tmp_path / "bias", CASSINI)
    amid = rows_of_chunk(load_event(event, CASSINI), slice(2, None, 40))
    # one pulse in eight begins so; by another simulator all did, with a misfit of 200
    cut = evidence_of(event, amid)
    assert cut.misfit() > 25.0
    assert without_cut_pulses(cut).misfit() < 0.5 * cut.misfit()
    check_telemetry(event, [amid], CASSINI, NOMINAL)


def rows_of_chunk(chunk: Chunk, part: slice) -> Chunk:
    """Some rows of a chunk."""
    arrays = [field.name for field in fields(chunk) if field.name != "first_row"]
    return replace(chunk, **{name: getattr(chunk, name)[part] for name in arrays})


def test_an_error_carries_the_names(refusal: Callable[[str, str], InputError]) -> None:
    """The error carries the names, the best first, and keeps them on its way from a worker."""
    error = refusal("bias", "wheels in rad/s")
    assert isinstance(error, MistakeError)
    assert error.mistakes[0] == "wheel-unit"
    again = copy.copy(error)
    assert again.mistakes == error.mistakes


# ---- single cells --------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["bias", "slew"])
@pytest.mark.parametrize("count", [1, 5, 50])
def test_bad_cells_are_found(honest: dict[str, Event], kind: str, count: int) -> None:
    """One, five, fifty wrong cells: named with row and column; left out, all others stay."""
    event, chunk = honest[kind]
    rng = np.random.default_rng(count)
    rows = rng.choice(np.arange(4, chunk.rows - 4, 5), count, replace=False)
    wheel = chunk.wheel_rpm.copy()
    wheel[rows, 1] += 300.0
    wrong = replace(chunk, wheel_rpm=wheel)
    with pytest.raises(InputError) as caught:
        check_telemetry(event, [wrong], CASSINI, NOMINAL)
    assert caught.value.fix.endswith("--accept bad-cell")
    assert "column rwa2_rpm" in caught.value.got
    check = TelemetryCheck(event, CASSINI, NOMINAL, Policy(leave_out=True))
    mended = check.take(wrong)
    gone = np.flatnonzero(np.isnan(mended.wheel_rpm).any(axis=1))
    assert set(gone) == set(rows)
    assert np.array_equal(np.delete(mended.wheel_rpm, gone, 0), np.delete(wheel, gone, 0))
    assert "left out" in check.verdict().findings[0]


def test_firings_to_and_fro_between_two_readings_are_no_bad_cell(honest: dict[str, Event]) -> None:
    """Counters every 10 s, and a rate that jumps for one row, as two thrusters that fire in it do.

    Control: the same jump where counters show nothing.
    """
    event, chunk = honest["bias"]
    nominal = evidence_of(event, chunk).nominal
    pairs = nominal.torques.T[:, None] + nominal.torques.T
    one, other = np.unravel_index(np.argmin(np.linalg.norm(pairs, axis=2)), pairs.shape[:2])
    row, read = 455, np.arange(len(chunk.time_s)) % 10 == 0
    rate = chunk.rate_rad_s.copy()
    rate[row, 0] += nominal.torques[0, one] / nominal.inertia[0, 0]

    def found(fired_s: float) -> int:
        on_time = chunk.on_time_s.copy()
        on_time[row + 1 :, [one, other]] += fired_s
        on_time[~read] = np.nan
        pulses = np.where(read[:, None], chunk.pulses, np.nan)
        given = replace(chunk, rate_rad_s=rate, on_time_s=on_time, pulses=pulses)
        return len(CellSearch(nominal).find(given))

    assert found(0.0) > found(1.0) == 0


@pytest.mark.parametrize("count", [1, 5, 50])
def test_bad_cells_left_out_change_no_answer(honest: dict[str, Event], count: int) -> None:
    """Among 1,200 rows: within 0.3 σ of the fit without those rows; left in, they move it.

    Wheel rates wrong by 30 to 3,000 rpm and body rates by 1e-4 to 1e-2 rad/s, in any rows.
    """
    event, chunk = honest["bias"]
    rng = np.random.default_rng([18, count])
    rows = rng.choice(np.arange(2, chunk.rows - 2), count, replace=False)
    wheel, rate = chunk.wheel_rpm.copy(), chunk.rate_rad_s.copy()
    for row in rows:
        size = rng.choice([-1.0, 1.0]) * 10.0 ** rng.uniform(0.0, 2.0)
        column = int(rng.integers(3))
        if rng.random() < 0.5:
            wheel[row, column] += 30.0 * size
        else:
            rate[row, column] += 1e-4 * size
    wrong = replace(chunk, wheel_rpm=wheel, rate_rad_s=rate)
    gone = np.zeros(chunk.rows, dtype=bool)
    gone[rows] = True
    blank = {"wheel_rpm": chunk.wheel_rpm, "rate_rad_s": chunk.rate_rad_s}
    without = replace(
        chunk, **{name: np.where(gone[:, None], np.nan, v) for name, v in blank.items()}
    )
    priors = read_priors(ROOT / "priors" / "cassini_b_branch_telemetry.toml")
    mended = TelemetryCheck(event, CASSINI, NOMINAL, Policy(leave_out=True)).take(wrong)
    clean, left_out = (answer_of([(event, each)], priors) for each in (without, mended))
    assert clean is not None
    assert left_out is not None
    assert clean.moved(left_out) < 0.3
    if count == 1:  # negative control
        left_in = answer_of([(event, wrong)], priors)
        assert left_in is not None
        assert clean.moved(left_in) > 1.0


# ---- totals --------------------------------------------------------------------------------------

PRIORS = read_priors(Path(B_BRANCH))


def flight() -> tuple[TotalsEvent, ...]:
    """The eight flight biases."""
    return read_totals(FLIGHT, PRIORS.spacecraft)


def judged(events: list[TotalsEvent], policy: Policy = STRICT, size: float = 1.0) -> str:
    """The name under which rows are refused, empty if they are not.

    By a spacecraft whose masses and thrusts are ``size`` times Cassini's.
    """
    values = {
        name: value * (size if PRIORS.parameters[name].spec.unit in ("N", "kg", "kg m2") else 1.0)
        for name, value in nominal_values(PRIORS).items()
    }
    try:
        check_totals(events, PRIORS.spacecraft, values, "table.csv", policy)
    except InputError as error:
        return error.fix.rpartition("--accept ")[2] + " " + error.got
    return ""


def swapped(event: TotalsEvent, a: int, b: int) -> TotalsEvent:
    """Totals of two thrusters exchanged."""
    order = list(range(8))
    order[a], order[b] = b, a
    assert event.pulses is not None
    return replace(event, on_time_s=event.on_time_s[order], pulses=event.pulses[order])


def reversed_(event: TotalsEvent) -> TotalsEvent:
    """Start and end exchanged."""
    return replace(event, rwa_start_rpm=event.rwa_end_rpm, rwa_end_rpm=event.rwa_start_rpm)


@pytest.mark.parametrize("source", ["flight", "gsw", "gsw_ideal"])
def test_published_tables_pass(source: str) -> None:
    """Flight's biases and what ground software made of them are refused nothing."""
    assert judged(list(read_totals(FLIGHT, PRIORS.spacecraft, source))) == ""


def test_a_row_of_any_length_is_judged() -> None:
    """A duration whose square is no number: the torque over it explains everything."""
    assert judged([replace(row, duration_s=1e200) for row in flight()]) == ""


def test_mistakes_in_all_rows_are_named() -> None:
    """Redundancy over events: exchanged thrusters and ends."""
    rows = flight()
    assert judged([reversed_(row) for row in rows]).startswith("start-end")
    assert "z1 with z3" in judged([swapped(row, 0, 2) for row in rows])
    assert "y1 with y2" in judged([swapped(row, 4, 5) for row in rows])


def with_sign_of_first_wheel(event: TotalsEvent) -> TotalsEvent:
    """The first wheel's rates about the opposite axis."""
    signs = np.array([-1.0, 1.0, 1.0])
    return replace(
        event,
        rwa_start_rpm=event.rwa_start_rpm * signs,
        rwa_end_rpm=event.rwa_end_rpm * signs,
    )


def with_first_wheels_exchanged(event: TotalsEvent) -> TotalsEvent:
    """The first two wheels exchanged."""
    order = [1, 0, 2]
    return replace(
        event, rwa_start_rpm=event.rwa_start_rpm[order], rwa_end_rpm=event.rwa_end_rpm[order]
    )


@pytest.mark.parametrize("size", [0.01, 100.0])
@pytest.mark.parametrize(
    ("recorded", "mistake"),
    [
        (replace, ""),
        (with_sign_of_first_wheel, "wheel-sign"),
        (with_first_wheels_exchanged, "wheel-order"),
    ],
)
def test_spacecraft_of_any_mass_have_the_same_verdicts(
    size: float, recorded: Callable[[TotalsEvent], TotalsEvent], mistake: str
) -> None:
    """All masses and thrusts times one factor: the same rates in the same time.

    With a body's momentum and torque as large as Cassini's nothing contradicted a hundredth of it.
    """
    rows = [recorded(row) for row in flight()]
    verdict = judged(rows, size=size)
    assert verdict.startswith(mistake)
    assert verdict == judged(rows)


def test_torques_that_priors_allow_explain_totals() -> None:
    """A steady torque of 1 N m hides exchanged ends; the priors' own does not."""
    rows = [reversed_(row) for row in flight()]
    wide = PRIORS
    for axis in "xyz":
        name, torque = f"external_torque_{axis}_n_m", Distribution("norm", {"scale": 1.0})
        wide = wide.with_distribution(name, torque)
    assert check_rows(rows, wide, "table.csv") == ()
    with pytest.raises(MistakeError, match="before and after exchanged"):
        check_rows(rows, PRIORS, "table.csv")


def in_rad_s(event: TotalsEvent) -> TotalsEvent:
    """Wheel rates in rad/s where rev/min belong."""
    return replace(
        event,
        rwa_start_rpm=event.rwa_start_rpm * np.pi / 30.0,
        rwa_end_rpm=event.rwa_end_rpm * np.pi / 30.0,
    )


def test_wheel_rates_in_rad_s_are_named() -> None:
    """In every row, in one of eight, and in each row that stands alone: firing cannot vanish."""
    rows = list(flight())
    assert judged([in_rad_s(row) for row in rows]).startswith("wheel-unit")
    one = judged([*rows[:3], in_rad_s(rows[3]), *rows[4:]])
    assert one.startswith("wheel-unit")
    assert rows[3].id in one
    for row in rows:
        assert judged([in_rad_s(row)]).startswith("wheel-unit")
        assert judged([row]) == ""


def test_a_mistake_in_one_row_is_named_with_the_row() -> None:
    """One row with its ends exchanged, or one cell, among seven good ones."""
    rows = list(flight())
    ends = judged([*rows[:3], reversed_(rows[3]), *rows[4:]])
    assert ends.startswith("start-end")
    assert rows[3].id in ends
    on_time = rows[3].on_time_s.copy()
    on_time[2] *= 10.0
    cell = judged([*rows[:3], replace(rows[3], on_time_s=on_time), *rows[4:]])
    assert cell.startswith("bad-cell")
    assert rows[3].id in cell


def test_a_thruster_in_another_unit_is_named_and_a_weak_one_is_not() -> None:
    """One column of on-times × 10 in every row; two fifths of the thrust gone are physics."""
    z1 = np.arange(8) == 0

    def times(factor: float) -> list[TotalsEvent]:
        return [
            replace(row, on_time_s=row.on_time_s * np.where(z1, factor, 1.0)) for row in flight()
        ]

    assert judged(times(10.0)).startswith("on-time-unit")
    assert judged(times(1.0 / 0.6)) == ""


def test_a_decimal_point_in_one_column_is_named() -> None:
    """z2's on-times × 10 in all rows cost its prior less than a free factor does; / 1.4 is none."""
    z2 = np.arange(8) == 1

    def told(factor: float) -> str:
        rows = [
            replace(row, on_time_s=row.on_time_s * np.where(z2, factor, 1.0)) for row in flight()
        ]
        return judged(rows)

    assert told(10.0).startswith("on-time-unit")
    assert told(1.4) == ""


def test_a_long_cell_is_free_by_as_much_as_it_says() -> None:
    """One on-time of minutes instead of seconds is found, whatever its size."""
    row = flight()[2]
    longest = int(np.argmax(row.on_time_s))
    on = row.on_time_s * np.where(np.arange(8) == longest, 10.0, 1.0)
    wrong = [*flight()[:2], replace(row, on_time_s=on, duration_s=1e5), *flight()[3:]]
    assert judged(wrong).startswith("bad-cell")


@pytest.mark.parametrize("place", range(8))
def test_a_row_in_ms_is_named_alone(place: int) -> None:
    """Momentum alone does not tell it; that no thruster fires for longer than its event does."""
    row = flight()[place]
    told = judged([replace(row, on_time_s=1e3 * row.on_time_s)])
    assert told.startswith("on-time-unit")
    accepted = Policy.of(["on-time-unit"])
    assert not judged([replace(row, on_time_s=1e3 * row.on_time_s)], accepted).startswith("on-t")


@pytest.mark.parametrize("factor", [1.0 / 60.0, 1e-3])
def test_pulses_shorter_than_a_valve_allows_are_named(
    honest: dict[str, Event], factor: float
) -> None:
    """On-times in minutes or divided by 1,000 once too often: tails would close the balance."""
    event, chunk = honest["bias"]
    short = replace(chunk, on_time_s=factor * chunk.on_time_s)
    with pytest.raises(InputError, match=r"at least 0\.005 s on average") as caught:
        check_telemetry(event, [short], CASSINI, NOMINAL)
    assert caught.value.fix.endswith("--accept on-time-unit")
    assert "telemetry.csv" in caught.value.where


def test_on_times_that_are_a_thrust_cannot_be_known() -> None:
    """On-times × 1.2 are a weaker thrust: no check can tell, and none pretends to."""
    assert judged([replace(row, on_time_s=1.2 * row.on_time_s) for row in flight()]) == ""


def test_the_same_data_under_another_name_is_refused() -> None:
    """Duplicates are found by content; other rows are not taken for them."""
    rows = flight()
    twice = [*rows, replace(rows[2], id="another")]
    with pytest.raises(InputError, match=rows[2].id):
        refuse_duplicates([(row.id, content_of_totals(row)) for row in twice])
    assert refuse_duplicates([(row.id, content_of_totals(row)) for row in rows]) == ()


def test_telemetry_under_another_id_is_refused(tmp_path: Path) -> None:
    """A copied folder with another id, for a fit and a diagnosis; accepted, it is said."""
    simulated(tmp_path, {}, None)
    first, copied = tmp_path / "slews", tmp_path / "copied"
    shutil.copytree(first, copied)
    described = copied / "event.toml"
    described.write_text(described.read_text().replace('"slews"', '"another"'))
    priors = ROOT / "priors" / "cassini_b_branch_telemetry.toml"
    table = {"events": [str(first), str(copied)], "priors": str(priors)}
    with pytest.raises(InputError, match="under another name"):
        read_inputs(check_run(table, "run"), Path())
    with pytest.raises(InputError, match="under another name"):
        read_events(table["events"], priors)
    accepted = read_inputs(check_run(table | {"accept": ["same-telemetry"]}, "run"), Path())
    assert [finding.count("same-telemetry") for finding in accepted.findings] == [1]


# ---- another spacecraft --------------------------------------------------------------------------

COUPLES = ROOT / "tests" / "data" / "pure_couples"


@pytest.mark.parametrize("seed", [3, 17])
def test_rows_in_step_with_the_pulses_are_no_mistake(seed: int, tmp_path: Path) -> None:
    """Twelve thrusters in pure couples, cycles of 0.2 s, rows every second: tails come late.

    Readings catch pulses whose tail is still to come, and to and fro within a second they cancel in
    the counters. A wheel's factor of 0.6 and two bad cells were named. Control: a wheel of the
    opposite sign still is. (A factor cannot be known where each thruster has a thrust of its own.)
    """
    priors = read_priors(COUPLES / "priors.toml")
    craft, nominal = priors.spacecraft, nominal_values(priors)
    write_simulation(simulate_file(read_scenario(COUPLES / "scenario.toml"), seed), tmp_path)
    for name in ("first", "second"):
        event = read_event(tmp_path / name, craft)
        chunk = load_event(event, craft)
        assert check_telemetry(event, [chunk], craft, nominal).misfit <= SUSPECT
        turned = chunk.wheel_rpm * np.array([1.0, -1.0, 1.0])
        with pytest.raises(InputError, match="wheel"):
            check_telemetry(event, [replace(chunk, wheel_rpm=turned)], craft, nominal)
    with pytest.raises(InputError, match="the same event twice"):
        refuse_duplicates([("first", "digest"), ("first", "digest")])
