"""Mistakes hidden in simulated telemetry: which are refused by name, and are honest events let be?

Each set flies a wheel bias, slews and a quiet period under conditions of its own (cadence, counter
step, noise), every second set with a clear effect of the catalogue. As recorded, each event should
pass; with each mistake of :data:`MISTAKEN` it should be refused under its name.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from cassini_bayes.computing.arrays import Array
from cassini_bayes.errors import InputError
from cassini_bayes.events.plausibility import MISTAKES, TelemetryCheck
from cassini_bayes.events.telemetry import Chunk, TelemetryEvent
from cassini_bayes.files.code import identity
from cassini_bayes.model.event_reduction import nominal_values
from cassini_bayes.priors.reader import Priors, read_priors
from cassini_bayes.simulation import SimulatedEvent, scenario_of
from cassini_bayes.spacecraft.units import RAD_S_PER_RPM
from cassini_bayes.studies.scenario import draw_wheel_rates, simulate_file, simulated_samples
from cassini_bayes.studies.study import Arrays, Study

MODULE: Final = "studies.mistakes"
FULL: Final[Mapping[str, int]] = {"honest": 240, "mistaken": 3}
QUICK: Final[Mapping[str, int]] = {"honest": 12, "mistaken": 1}
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
        accelerometer_counts=np.full(rows, np.nan),
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


CASES: Final = tuple((name, kind) for name, each in MISTAKEN.items() for kind in each.kinds)
"""Every mistake with every kind of event that it is for."""


# ---- sets ----------------------------------------------------------------------------------------

VERDICTS: Final = ("passed", "flagged", "refused", *MISTAKES)
"""``refused`` is under no name that can be accepted."""

NO_EFFECT: Final = -1


def judge(event: TelemetryEvent, chunk: Chunk, priors: Priors) -> tuple[str, float]:
    """One of :data:`VERDICTS`, the name if it was refused under one, and the misfit."""
    check = TelemetryCheck(event, priors.spacecraft, nominal_values(priors))
    check.take(chunk)
    try:
        found = check.verdict()
    except InputError as error:
        name = error.fix.rpartition("--accept ")[2]
        return (name if name in MISTAKES else "refused"), np.nan
    return ("flagged" if found.findings else "passed"), found.misfit


def fly(
    priors: Priors, path: Path, rng: np.random.Generator, effect: str | None
) -> Iterator[tuple[TelemetryEvent, Chunk]]:
    """The events of one set, one of each of :data:`KINDS`."""
    scene = document(path, rng, effect)
    flight = simulate_file(scenario_of(scene), int(rng.integers(2**31)), priors=priors)
    yield from map(recorded, flight.events)


@dataclass(frozen=True)
class Honest:
    """Sets as recorded, every second one with a clear effect of the catalogue."""

    priors: Path
    seed: int
    per_file: int = 4

    def identity(self) -> str:
        """Hash of all that a repetition depends on."""
        return identity(["honest", self.seed], [self.priors], MODULE)

    def repetition(self, index: int) -> Mapping[str, NDArray[Any] | float]:
        """Place of the effect in :data:`EFFECTS`; verdict and misfit of each kind."""
        priors, rng = read_priors(self.priors), np.random.default_rng([self.seed, index])
        names = list(EFFECTS)
        effect = int(rng.integers(len(names))) if index % 2 else NO_EFFECT
        hidden = None if effect == NO_EFFECT else names[effect]
        events = fly(priors, self.priors, rng, hidden)
        judged = [judge(event, chunk, priors) for event, chunk in events]
        return {
            "effect": effect,
            "verdict": np.array([VERDICTS.index(verdict) for verdict, _ in judged]),
            "misfit": np.array([misfit for _, misfit in judged]),
        }


@dataclass(frozen=True)
class WithMistakes:
    """Sets without effects, one thing at a time: every mistake in turn."""

    priors: Path
    seed: int
    per_file: int = 1

    def identity(self) -> str:
        """Hash of all that a repetition depends on."""
        return identity(["mistaken", self.seed], [self.priors], MODULE)

    def repetition(self, index: int) -> Mapping[str, NDArray[Any]]:
        """Verdict on each of :data:`CASES`."""
        priors, rng = read_priors(self.priors), np.random.default_rng([self.seed, index])
        flown = dict(zip(KINDS, fly(priors, self.priors, rng, None), strict=True))
        verdicts = []
        for name, kind in CASES:
            event, chunk = flown[kind]
            verdicts.append(judge(event, MISTAKEN[name].change(chunk), priors)[0])
        return {"verdict": np.array([VERDICTS.index(verdict) for verdict in verdicts])}


def run_mistakes(study: Study, priors: Path, numbers: Mapping[str, int]) -> None:
    """Fly, judge and write the page; ``numbers`` are sets by part, as in :data:`FULL`."""
    honest = study.repeat("honest", "honest sets", Honest(priors, study.seed), numbers["honest"])
    mistaken = study.repeat(
        "mistaken", "sets with mistakes", WithMistakes(priors, study.seed), numbers["mistaken"]
    )
    study.publish("Mistakes in telemetry", _body(honest, mistaken), MODULE, {}, {})


def _body(honest: Arrays, mistaken: Arrays) -> str:
    """Rates as a page: honest events by kind, and every mistake by kind of event."""
    return "\n".join(
        [
            "What the checks of `cassini_bayes.events.plausibility` say of simulated events:",
            "honest ones under varied conditions, every second set with a clear effect of the",
            "catalogue, and events with one mistake each. Derivation:",
            "[Mistakes in data](../topics/plausibility.md).",
            "",
            *_honest_lines(honest),
            "",
            *_mistaken_lines(mistaken),
        ]
    )


def _honest_lines(honest: Arrays) -> Sequence[str]:
    names, hides = list(EFFECTS), honest["effect"] != NO_EFFECT
    lines = [
        f"## Honest events ({len(hides)} sets)",
        "",
        "| kind | effect hidden | events | refused | flagged | largest misfit |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for k, kind in enumerate(KINDS):
        for hidden in (False, True):
            counts = _counted(honest["verdict"][hides == hidden, k])
            misfits = honest["misfit"][hides == hidden, k]
            refused = counts.total() - counts["passed"] - counts["flagged"]
            lines.append(
                f"| {kind} | {'yes' if hidden else 'no'} | {counts.total()} | {refused} |"
                f" {counts['flagged']} | {np.max(misfits[np.isfinite(misfits)], initial=0.0):.1f} |"
            )
    for row, k in np.argwhere(honest["verdict"] != VERDICTS.index("passed")):
        effect = names[honest["effect"][row]] if hides[row] else "no effect"
        verdict = VERDICTS[honest["verdict"][row, k]]
        said = f"{verdict} (misfit {honest['misfit'][row, k]:.1f})"
        lines += ["", f"Not passed: set {row}, {KINDS[k]}, {effect}: {said}."]
    return lines


def _mistaken_lines(mistaken: Arrays) -> Sequence[str]:
    lines = [
        "## Mistakes",
        "",
        "| mistake | event | sets | named | refused otherwise | flagged | passed |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for (name, kind), verdicts in zip(CASES, mistaken["verdict"].T, strict=True):
        counts = _counted(verdicts)
        named = sum(counts[each] for each in MISTAKEN[name].names)
        others = counts.total() - named - counts["flagged"] - counts["passed"]
        lines.append(
            f"| {name} | {kind} | {counts.total()} | {named} | {others} | {counts['flagged']} |"
            f" {counts['passed']} |"
        )
    return lines


def _counted(verdicts: NDArray[Any]) -> Counter[str]:
    return Counter(VERDICTS[verdict] for verdict in verdicts)
