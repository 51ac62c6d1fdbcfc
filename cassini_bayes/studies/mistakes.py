"""Mistakes hidden in simulated telemetry: which are refused by name, and are honest events let be?

Each set flies a wheel bias, slews and a quiet period under conditions of its own (cadence, counter
step, noise), every second set with a clear effect of the catalogue. As recorded, each event should
pass; with each mistake of :data:`MISTAKEN` it should be refused under its name.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

import numpy as np

from cassini_bayes.arrays import Array
from cassini_bayes.balance.totals_terms import RAD_S_PER_RPM
from cassini_bayes.errors import InputError
from cassini_bayes.events.plausibility import MISTAKES, TelemetryCheck
from cassini_bayes.events.telemetry import Chunk, TelemetryEvent
from cassini_bayes.files.storage import write_text
from cassini_bayes.model.event_reduction import nominal_values
from cassini_bayes.priors.reader import Priors, read_priors
from cassini_bayes.simulation import SimulatedEvent, scenario_of
from cassini_bayes.studies.scenario import draw_wheel_rates, simulate_file, simulated_samples

KINDS: Final = ("bias", "slew", "quiescent")
EFFECTS: Final[Mapping[str, Mapping[str, float]]] = {
    "thrust_scale": {"thrust_factor": 0.85},
    "thruster_degraded:z4": {"thrust_factor": 0.7},
    "thrust_warmup": {"warmup_deficit": 0.3, "warmup_time_s": 4.0},
    "tail_off": {"tau_fall_s": 0.1},
    "pulse_shape": {"impulse_time_offset_s": 0.03},
    "center_of_mass:y": {"cm_y_m": 0.10},
    "wheel_inertia:2": {"rwa2_inertia_kg_m2": 0.168},
    "wheel_alignment:4": {"rwa4_tilt_u_rad": 0.05, "rwa4_tilt_v_rad": 0.02},
    "thruster_misalignment:y2": {"cant_a_rad": 0.05, "cant_b_rad": -0.05},
    "external_torque": {f"external_torque_{axis}_n_m": 1e-4 for axis in "xyz"},
    "thruster_leak:z1": {"leak_n": 1e-3},
    "inertia:xx": {"inertia_xx_kg_m2": 7200.0},
    "time_offset": {"time_offset_s": 1.5},
    "rate_bias:z": {"rate_bias_z_rad_s": 1e-5},
    "rate_scale:x": {"rate_scale": 0.02},
    "flexible_mode": {"frequency_hz": 0.13, "damping": 0.002, "amplitude_rad_s": 2e-5},
}
"""Clear effects of the catalogue, two to four of its prior's standard deviations."""


def conditions(rng: np.random.Generator) -> dict[str, float]:
    """Cadence, least steps and noise of one set."""
    fast = float(rng.choice([1.0, 4.0]))
    return {
        "attitude_every_s": fast,
        "rate_every_s": fast,
        "wheel_every_s": fast,
        "counter_every_s": float(rng.choice([1.0, 4.0, 10.0])) if fast == 1.0 else 4.0,
        "attitude_noise_rad": 2e-5,
        "rate_noise_rad_s": float(rng.choice([2e-6, 2e-5])),
        "wheel_noise_rpm": float(rng.choice([0.1, 0.5])),
        "wheel_resolution_rpm": float(rng.choice([0.0, 1.0])),
        "on_time_resolution_s": float(rng.choice([0.001, 0.01, 0.125])),
    }


def document(priors: Path, rng: np.random.Generator, effect: str | None) -> dict[str, Any]:
    """A scenario of one set."""
    slews = [
        {"start_s": start, "axis": axis, "angle_rad": angle}
        for start, axis, angle in (
            (20.0, [1.0, 0.0, 0.0], 0.15),
            (300.0, [0.0, 1.0, 0.0], -0.15),
            (580.0, [0.0, 0.0, 1.0], 0.2),
        )
    ]
    limits = {"rate_rad_s": 1.5e-3, "acceleration_rad_s2": 2.0e-5}
    epoch = "2010-05-01T00:00:00Z"
    rates: dict[str, Any] = {"from_rpm": [0.0] * 3, "to_rpm": [0.0] * 3}
    events: list[dict[str, Any]] = [
        {"id": "bias", "kind": "bias", "epoch": epoch, "settle_s": 150.0, **rates},
        {
            "id": "slew",
            "kind": "slew",
            "epoch": epoch,
            "from_rpm": [0.0] * 3,
            "duration_s": 860.0,
            "slew": [slew | limits for slew in slews],
        },
        {
            "id": "quiescent",
            "kind": "quiescent",
            "epoch": epoch,
            "from_rpm": [0.0] * 3,
            "duration_s": 600.0,
        },
    ]
    draw_wheel_rates(events, rng)
    effects = [] if effect is None else [{"name": effect, "parameters": dict(EFFECTS[effect])}]
    return {
        "spacecraft": {"name": "cassini", "branch": "B", "wheels": [1, 2, 4]},
        "truth": {"draw_from": str(priors.resolve()), "mass_kg": 2380.0},
        "start": {"attitude_spread": 1.0, "rate_rad_s": 2e-5},
        "telemetry": conditions(rng),
        "event": events,
        "effect": effects,
    }


def recorded(event: SimulatedEvent) -> tuple[TelemetryEvent, Chunk]:
    """A simulated event as the reader would give it."""
    samples, thrusters = simulated_samples(event)
    settings, rows = event.plan.event, len(samples)
    place = Path(settings.id)
    described = TelemetryEvent(
        id=settings.id,
        kind=settings.kind,
        epoch=settings.epoch,
        branch=event.plan.branch,
        wheels=tuple(event.plan.wheel_numbers),
        thrusters=thrusters,
        delta_v_source=None,
        source="simulation",
        folder=place,
        telemetry=place / "telemetry.csv",
        digest="",
    )
    chunk = Chunk(
        first_row=2,
        time_s=samples.time_s.copy(),
        attitude=samples.attitude.copy(),
        rate_rad_s=samples.rate_rad_s.copy(),
        wheel_rpm=samples.wheel_rad_s / RAD_S_PER_RPM,
        on_time_s=samples.on_time_s.copy(),
        pulses=samples.pulses.copy(),
        delta_v_m_s=np.zeros((rows, 0)),
        tank_pressure_kpa=np.full(rows, np.nan),
    )
    return described, chunk


# ---- mistakes ------------------------------------------------------------------------------------

Change = Callable[[Chunk], Chunk]
CHANNELS: Final = ("attitude", "rate_rad_s", "wheel_rpm", "on_time_s", "pulses")


def times(channel: str, factor: float | Sequence[float]) -> Change:
    """A channel, or each of its columns, times a factor."""
    return lambda chunk: replace(chunk, **{channel: getattr(chunk, channel) * np.asarray(factor)})


def ordered(channel: str, order: Sequence[int]) -> Change:
    """Columns of a channel in another order."""
    return lambda chunk: replace(chunk, **{channel: getattr(chunk, channel)[:, list(order)]})


def exchanged(a: int, b: int) -> Change:
    """Counters of two thrusters exchanged."""

    def change(chunk: Chunk) -> Chunk:
        order = list(range(chunk.on_time_s.shape[1]))
        order[a], order[b] = order[b], order[a]
        return replace(chunk, on_time_s=chunk.on_time_s[:, order], pulses=chunk.pulses[:, order])

    return change


def moved(channel: str, late_s: float) -> Change:
    """A channel that comes late: rows of it slip down; what was before the first is repeated."""

    def change(chunk: Chunk) -> Chunk:
        values = getattr(chunk, channel)
        there = np.flatnonzero(~np.isnan(values).any(axis=1))
        source = np.searchsorted(chunk.time_s[there], chunk.time_s[there] - late_s + 1e-9) - 1
        slipped = values.copy()
        slipped[there] = values[there[np.maximum(source, 0)]]
        return replace(chunk, **{channel: slipped})

    return change


def with_column(channel: str, column: int, value: Callable[[Array], Array | float]) -> Change:
    """One column of a channel as a function of the channel."""

    def change(chunk: Chunk) -> Chunk:
        values = getattr(chunk, channel).copy()
        values[:, column] = value(values)
        return replace(chunk, **{channel: values})

    return change


def both(first: Change, second: Change) -> Change:
    """One after the other."""
    return lambda chunk: second(first(chunk))


CONJUGATE: Final = (-1.0, -1.0, -1.0, 1.0)
ALL: Final = ("bias", "slew")
BIAS: Final = ("bias",)
SLEW: Final = ("slew",)


@dataclass(frozen=True)
class Mistaken:
    """A mistake: what it does, names under which it counts as found, kinds of event it is for."""

    change: Change
    names: tuple[str, ...]
    kinds: tuple[str, ...] = ALL


MISTAKEN: Final[Mapping[str, Mistaken]] = {
    "wheels 1 and 2 exchanged": Mistaken(ordered("wheel_rpm", (1, 0, 2)), ("wheel-order",)),
    "wheels 2 and 4 exchanged": Mistaken(ordered("wheel_rpm", (0, 2, 1)), ("wheel-order",)),
    "wheels rotated": Mistaken(ordered("wheel_rpm", (1, 2, 0)), ("wheel-order",)),
    "all wheel signs": Mistaken(times("wheel_rpm", -1.0), ("wheel-sign",)),
    "sign of wheel 2": Mistaken(times("wheel_rpm", (1.0, -1.0, 1.0)), ("wheel-sign",)),
    "wheels in rad/s": Mistaken(times("wheel_rpm", RAD_S_PER_RPM), ("wheel-unit",)),
    "wheels in deg/s": Mistaken(times("wheel_rpm", 6.0), ("wheel-unit",)),
    "wheel 1 doubled": Mistaken(times("wheel_rpm", (2.0, 1.0, 1.0)), ("wheel-factor",)),
    "wheel 2 + 500 rpm": Mistaken(
        lambda chunk: replace(chunk, wheel_rpm=chunk.wheel_rpm + np.array([0.0, 500.0, 0.0])),
        ("wheel-offset",),
        SLEW,
    ),
    "wheel 2 stuck": Mistaken(with_column("wheel_rpm", 1, lambda v: v[0, 1]), ("wheel-silent",)),
    "wheel 2 repeats wheel 1": Mistaken(
        with_column("wheel_rpm", 1, lambda v: v[:, 0]), ("wheel-silent",)
    ),
    "wheels 8 s late": Mistaken(moved("wheel_rpm", 8.0), ("wheel-time",)),
    "z1 and z3 exchanged": Mistaken(exchanged(0, 2), ("thruster-order",), BIAS),
    "z1 and z2 exchanged": Mistaken(exchanged(0, 1), ("thruster-order",), BIAS),
    "z1 and y1 exchanged": Mistaken(exchanged(0, 4), ("thruster-order",), BIAS),
    "y1 and y2 exchanged": Mistaken(exchanged(4, 5), ("thruster-order",), BIAS),
    "z1 with z2, z3 with z4": Mistaken(
        both(exchanged(0, 1), exchanged(2, 3)), ("thruster-order",), BIAS
    ),
    "pulses doubled": Mistaken(times("pulses", 2.0), ("pulse-count",), BIAS),
    "counters 20 s late": Mistaken(
        both(moved("on_time_s", 20.0), moved("pulses", 20.0)), ("counter-time",), BIAS
    ),
    "rates zero": Mistaken(times("rate_rad_s", 0.0), ("rate-silent",)),
    "x rate zero": Mistaken(times("rate_rad_s", (0.0, 1.0, 1.0)), ("rate-silent",)),
    "all rate signs": Mistaken(times("rate_rad_s", -1.0), ("rate-sign",)),
    "sign of y rate": Mistaken(times("rate_rad_s", (1.0, -1.0, 1.0)), ("rate-sign",)),
    "x and y rates exchanged": Mistaken(ordered("rate_rad_s", (1, 0, 2)), ("rate-axes",)),
    "rates in deg/s": Mistaken(times("rate_rad_s", 180.0 / np.pi), ("rate-unit",)),
    "rates in mrad/s": Mistaken(times("rate_rad_s", 1e3), ("rate-unit", "time-unit")),
    "rates × 1.1": Mistaken(times("rate_rad_s", 1.1), ("rate-factor",), SLEW),
    "y rate × 1.1": Mistaken(times("rate_rad_s", (1.0, 1.1, 1.0)), ("rate-factor",), SLEW),
    "rates × 2": Mistaken(times("rate_rad_s", 2.0), ("rate-factor",)),
    "rates 8 s late": Mistaken(moved("rate_rad_s", 8.0), ("rate-time",)),
    "quaternions inverse": Mistaken(times("attitude", CONJUGATE), ("attitude-convention",)),
    "quaternions scalar-first": Mistaken(
        ordered("attitude", (3, 0, 1, 2)), ("attitude-convention",)
    ),
    "attitudes 8 s late": Mistaken(moved("attitude", 8.0), ("attitude-time",)),
    "times in ms": Mistaken(times("time_s", 1e3), ("time-unit",)),
    "times in min": Mistaken(times("time_s", 1.0 / 60.0), ("time-unit",)),
}


@dataclass(frozen=True)
class Campaign:
    """Priors that truths are drawn from, seed, sets, and how many of them get mistakes too."""

    priors: Path
    seed: int
    sets: int
    mistaken_sets: int


def judge(event: TelemetryEvent, chunk: Chunk, priors: Priors) -> tuple[str, float]:
    """``passed``, ``flagged`` or the name it was refused under, and the misfit."""
    check = TelemetryCheck(event, priors.spacecraft, nominal_values(priors))
    check.take(chunk)
    try:
        found = check.verdict()
    except InputError as error:
        name = error.fix.rpartition("--accept ")[2]
        return (name if name in MISTAKES else "refused"), np.nan
    return ("flagged" if found.findings else "passed"), found.misfit


def fly(campaign: Campaign, number: int) -> Iterator[dict[str, Any]]:
    """One set: every event as recorded, and with every mistake if it is among the first sets."""
    priors = read_priors(campaign.priors)
    rng = np.random.default_rng([campaign.seed, number])
    # sets with mistakes have none of the catalogue's effects: one thing at a time
    clean = number < campaign.mistaken_sets or number % 2 == 0
    effect = None if clean else str(rng.choice(list(EFFECTS)))
    scene = document(campaign.priors, rng, effect)
    flight = simulate_file(scenario_of(scene), int(rng.integers(2**31)), priors=priors)
    for simulated in flight.events:
        event, chunk = recorded(simulated)
        verdict, misfit = judge(event, chunk, priors)
        base = {"set": number, "kind": event.kind, "effect": effect, **scene["telemetry"]}
        yield base | {"mistake": None, "verdict": verdict, "misfit": misfit}
        if number >= campaign.mistaken_sets:
            continue
        for name, mistaken in MISTAKEN.items():
            if event.kind in mistaken.kinds:
                copy = replace(chunk, **{f.name: getattr(chunk, f.name) for f in fields(chunk)})
                verdict, misfit = judge(event, mistaken.change(copy), priors)
                yield base | {"mistake": name, "verdict": verdict, "misfit": misfit}


def run_campaign(campaign: Campaign, work: Path) -> Iterator[int]:
    """Fly what has not been flown yet; one file per set."""
    for number in range(campaign.sets):
        path = work / f"{number:04}.json"
        if not path.exists():
            write_text(path, json.dumps(list(fly(campaign, number))) + "\n")
        yield number + 1


def write_page(work: Path, page: Path, command: Sequence[str]) -> None:
    """Rates as a page: honest events by kind, and every mistake by kind of event."""
    rows = [row for path in sorted(work.glob("*.json")) for row in json.loads(path.read_text())]
    honest = [row for row in rows if row["mistake"] is None]
    lines = [
        "# Mistakes in telemetry",
        "",
        "What the checks of `cassini_bayes.events.plausibility` say of simulated events: honest",
        "ones under varied conditions, every second set with a clear effect of the catalogue, and",
        "events with one mistake each. Derivation: [Mistakes in data](../plausibility.md).",
        "",
        f"`{' '.join(command)}`, {datetime.now(UTC):%Y-%m-%d};"
        f" {len({row['set'] for row in rows})} sets.",
        "",
        "## Honest events",
        "",
        "| kind | effect hidden | events | refused | flagged | largest misfit |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for kind in KINDS:
        for hidden in (False, True):
            own = [r for r in honest if r["kind"] == kind and (r["effect"] is not None) == hidden]
            verdicts = Counter(row["verdict"] for row in own)
            refused = len(own) - verdicts["passed"] - verdicts["flagged"]
            misfits = [row["misfit"] for row in own if np.isfinite(row["misfit"])]
            lines.append(
                f"| {kind} | {'yes' if hidden else 'no'} | {len(own)} | {refused} |"
                f" {verdicts['flagged']} | {max(misfits, default=0.0):.1f} |"
            )
    odd = [row for row in honest if row["verdict"] != "passed"]
    for row in odd:
        lines += ["", f"Not passed: set {row['set']}, {row['kind']}, {row['effect']}:"]
        lines.append(f"{row['verdict']} (misfit {row['misfit']:.1f}).")
    lines += [
        "",
        "## Mistakes",
        "",
        "| mistake | event | sets | named | refused otherwise | flagged | passed |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for name, mistaken in MISTAKEN.items():
        for kind in mistaken.kinds:
            own = [r for r in rows if r["mistake"] == name and r["kind"] == kind]
            verdicts = Counter(row["verdict"] for row in own)
            named = sum(verdicts[each] for each in mistaken.names)
            others = len(own) - named - verdicts["flagged"] - verdicts["passed"]
            lines.append(
                f"| {name} | {kind} | {len(own)} | {named} | {others} | {verdicts['flagged']} |"
                f" {verdicts['passed']} |"
            )
    write_text(page, "\n".join(lines) + "\n")
