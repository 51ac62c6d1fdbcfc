"""Trials: fly a scene, hide something or nothing, let the command line diagnose it, keep what it
said.

One JSON file per trial, named by its number; a trial that has one is not done again, so that a
campaign can be stopped, gone on with, and shared out by ranges of numbers. A trial depends on seed,
number and the conditions given, on nothing else.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from closed_loop.hidden import Effect, Growth
    from closed_loop.scene import Flown, Scene

STRATA = ("empty", "clear", "empty", "clear", "empty", "clear", "empty", "clear", "uncatalogued")
"""What trials hide, over and over: 225 trials are 100 empty, 100 clear and 25 uncatalogued."""
CLEAR_SIGMA = (6.0, 14.0)
ACCEPTED_SIGMA = (5.0, 20.0)
MOST_STEPS = 3.0
"""Of a growth: beyond that an effect is no longer believable."""
_MOST_FLIGHTS = 4
_MOST_NAMES = 30
_KEPT_CAUSES = 8
_LAST_LINES = 15
_PATIENCE_S = 3 * 3600


@dataclass(frozen=True)
class Setting:
    """A campaign: seed and conditions of its trials, where they go, what diagnoses them."""

    seed: int
    given: Mapping[str, Any]
    out: Path
    command: str
    fit: bool = False
    keep: bool = False


class NothingClearError(Exception):
    """No effect of a believable size stands out on a flight."""


def run(setting: Setting, index: int, log: Callable[[str], None]) -> None:
    """Do one trial, unless it has been done."""
    from closed_loop.scene import draw_scene, write_scene
    from closed_loop.vehicle import free_frequency_hz

    record_file = setting.out / f"{index:05d}.json"
    if record_file.exists():
        return
    began = time.monotonic()
    rng = np.random.default_rng([setting.seed, index])
    scene = draw_scene(int(rng.integers(2**31)), setting.given)
    stratum = STRATA[index % len(STRATA)]
    folder = setting.out / f"{index:05d}"
    shutil.rmtree(folder, ignore_errors=True)  # of a trial that was cut off
    record: dict[str, Any] = {
        "index": index,
        "seed": setting.seed,
        "scene_seed": scene.seed,
        "given": dict(setting.given),
        "package": _version(setting),
        "stratum": stratum,
        "conditions": scene.record(),
        "hidden": [],
        "diagnosis": {"causes": []},
    }
    try:
        effects, flown = choose(stratum, scene, rng)
    except NothingClearError as nothing:
        _keep(record | {"not_flown": str(nothing)}, record_file, log)
        return
    write_scene(folder / "record", scene, effects, flown)
    record["flight_s"] = time.monotonic() - began
    record["hidden"] = [
        {"name": e.name, "parameters": dict(e.parameters), "sigma": e.sigma} for e in effects
    ]
    if flown[2].slosh is not None:
        # as a diagnosis reports it: the hidden one is that of the spring alone
        body = flown[1].body(scene.events[0].name)
        record["free_frequency_hz"] = free_frequency_hz(body, flown[2].slosh)
    record["baseline"] = dict(scene.truth.parameters)  # without what is hidden
    record["truth"] = {"parameters": dict(flown[1].parameters), "thrust_n": dict(flown[1].thrust_n)}
    _keep(record | _judged(setting, record, folder), record_file, log)
    if not setting.keep:
        shutil.rmtree(folder)


def judge(setting: Setting, index: int, flights: Path, log: Callable[[str], None]) -> None:
    """Let the command line judge a trial anew whose telemetry ``flights`` kept, unless it has.

    The record is what it was, but for the answers; those of an oracle go, as it knows the package.
    """
    record_file, name = setting.out / f"{index:05d}.json", f"{index:05d}"
    before, kept = flights / f"{name}.json", flights / name / "record"
    if record_file.exists() or not before.exists() or not kept.is_dir():
        return
    folder = setting.out / name
    shutil.rmtree(folder, ignore_errors=True)  # of a trial that was cut off
    shutil.copytree(kept, folder / "record")
    record = json.loads(before.read_text("utf-8")) | {"package": _version(setting)}
    record = {key: value for key, value in record.items() if key not in ("oracle", "fit")}
    _keep(record | _judged(setting, record, folder), record_file, log)
    if not setting.keep:
        shutil.rmtree(folder)


def _judged(setting: Setting, record: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """What the command line says of the telemetry in a trial's folder."""
    telemetry, kinds = folder / "record", record["conditions"]["events"]
    events = [str(telemetry / f"{i + 1}-{kind}") for i, kind in enumerate(kinds)]
    inputs = [*events, "--priors", str(telemetry / "priors.toml"), "--seed", "1"]
    where = ["--out", str(folder / "diagnosis"), "--no-gain"]  # no trial reads it
    said = _called([setting.command, "diagnose", *inputs, *where])
    answers = {"diagnosis": said | read_diagnosis(folder / "diagnosis" / "diagnosis.json")}
    if setting.fit:
        where = ["--out", str(folder / "fit"), "--no-report"]
        fitted = _called([setting.command, "fit", *inputs, *where])
        summary = folder / "fit" / "summary.csv"
        table = summary.read_text("utf-8") if summary.exists() else None
        answers["fit"] = fitted | {"summary": table}
    return answers


def _keep(record: Mapping[str, Any], path: Path, log: Callable[[str], None]) -> None:
    """Write a trial's record, and say it in a line."""
    write(record, path)
    log(line(record))


def write(record: Mapping[str, Any], path: Path) -> None:
    """Write a trial's record whole or not at all."""
    part = path.with_suffix(".part")
    part.parent.mkdir(parents=True, exist_ok=True)
    part.write_text(json.dumps(record, indent=1) + "\n", "utf-8")
    part.replace(path)


def choose(
    stratum: str, scene: Scene, rng: np.random.Generator
) -> tuple[tuple[Effect, ...], Flown]:
    """What a trial hides, and its flight: nothing, or one effect of 5 to 20 σ (wanted: 6 to 14)."""
    from closed_loop.cassini import spread
    from closed_loop.hidden import CLEAR, NEEDS_FIRING, UNCATALOGUED, draw_growth, targets
    from closed_loop.scene import fly_scene

    if stratum == "empty":
        return (), fly_scene(scene, ())
    tables = scene.priors["parameters"]
    widths = {k: spread(t) for k, t in tables.items() if "fixed" in t or t["dist"] == "norm"}
    fires = any(event.kind == "bias" for event in scene.events)
    kinds = [
        kind
        for kind in (UNCATALOGUED if stratum == "uncatalogued" else CLEAR)
        if (fires or kind not in NEEDS_FIRING) and targets(kind, scene.truth.wheels)
    ]
    plain = fly_scene(scene, ())
    for _ in range(_MOST_NAMES):
        kind = str(rng.choice(kinds))
        target = str(rng.choice(targets(kind, scene.truth.wheels)))
        name = f"{kind}:{target}" if target else kind
        growth = draw_growth(name, scene.truth, widths, rng)
        wanted = float(np.exp(rng.uniform(*np.log(CLEAR_SIGMA))))
        found = _sized(scene, growth, wanted, plain)
        if found is not None:
            return (found[0],), found[1]
    raise NothingClearError(f"nothing clear to hide in {_MOST_NAMES} draws")


def _sized(
    scene: Scene, growth: Growth, wanted: float, plain: Flown
) -> tuple[Effect, Flown] | None:
    """The effect that stands out by about so many σ, flown; None where no believable size does."""
    from closed_loop.hidden import ON_RECORD, Effect, applied
    from closed_loop.scene import fly_scene
    from closed_loop.sizes import sigma

    size = _first_size(scene, growth, wanted, plain)
    for _ in range(_MOST_FLIGHTS):
        effect = None if size is None else growth.effect(size, scene.truth)
        if effect is None or size is None:
            return None
        if effect.kind in ON_RECORD:
            flown = (plain[0], *applied(scene.truth, (effect,)))
        else:
            flown = fly_scene(scene, (effect,))
        own = sigma(flown[0], scene.truth, (effect,), flown[2], scene.channels, scene.priors)
        if ACCEPTED_SIGMA[0] <= own <= ACCEPTED_SIGMA[1] and 0.7 <= own / wanted <= 1.4:
            return Effect(effect.name, effect.parameters, own), flown
        following = min(size * min(max(wanted / max(own, 1e-3), 0.05), 20.0), MOST_STEPS)
        if following == size:
            return None
        size = following
    return None


def _first_size(scene: Scene, growth: Growth, wanted: float, plain: Flown) -> float | None:
    """Where to begin: what the balance of the flight without it would take the effect for.

    Only for what acts on parameters and thrusts; None where no believable size would be enough.
    """
    from closed_loop.hidden import ON_PARAMETERS, ON_THRUSTS, applied
    from closed_loop.sizes import sigma

    effect = growth.effect(0.5, scene.truth)
    if effect is None or effect.kind not in (*ON_PARAMETERS, *ON_THRUSTS):
        return 1.0
    changed, departures = applied(scene.truth, (effect,))
    own = sigma(plain[0], changed, (effect,), departures, scene.channels, scene.priors)
    size = 0.5 * wanted / max(own, 1e-6)
    return size if size <= MOST_STEPS else None


def _called(arguments: Sequence[str]) -> dict[str, Any]:
    """Run a command: its exit status, the time it took, the last lines of what it said."""
    began = time.monotonic()
    try:
        done = subprocess.run(  # noqa: S603 - the command is the caller's own
            arguments, capture_output=True, text=True, check=False, timeout=_PATIENCE_S
        )
        status, said = done.returncode, done.stderr
    except subprocess.TimeoutExpired:
        status, said = None, f"no end after {_PATIENCE_S} s"
    return {
        "exit_status": status,
        "wall_s": time.monotonic() - began,
        "last_lines": said.splitlines()[-_LAST_LINES:],
    }


def _version(setting: Setting) -> str:
    asked = [setting.command, "--version"]
    done = subprocess.run(asked, capture_output=True, text=True, check=True)  # noqa: S603
    return done.stdout.strip()


def read_diagnosis(path: Path) -> dict[str, Any]:
    """What is kept of ``diagnosis.json``; nothing where there is none."""
    if not path.exists():
        return {"causes": []}
    document = json.loads(path.read_text("utf-8"))
    causes = document["causes"]
    return {
        "discrepant": document["discrepant"],
        "p_value": document["p_value"],
        "extended": document["extended"]["causes"],
        "gain": document["gain"],
        "causes": causes[:_KEPT_CAUSES],
        "probabilities": {cause["name"]: cause["probability"] for cause in causes},
    }


def line(record: Mapping[str, Any]) -> str:
    """A trial in one line."""
    hidden = ", ".join(f"{h['name']} ({h['sigma']:.1f} σ)" for h in record["hidden"]) or "nothing"
    said = record["diagnosis"]
    if not said["causes"]:
        problem = record.get("not_flown") or f"exit status {said['exit_status']}"
        return f"{record['index']:5d} {hidden}: {problem}"
    first = said["causes"][0]
    answer = f"{first['name']} {first['probability']:.2f} in {said['wall_s']:.0f} s"
    return f"{record['index']:5d} {hidden}: {answer}"
