"""What the benchmark by another simulator says of finished trials, and that it judges them anew."""

from __future__ import annotations

import csv
import importlib
import io
import json
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"
CONDITIONS = {
    "branch": "B",
    "controller": "phase_plane",
    "events": ["bias", "slew"],
    "row_every_s": 1,
    "counter_every_s": 10,
    "counter_step_s": 0.01,
    "wheel_step_rpm": 0.1,
    "rate_noise_rad_s": 2e-6,
}


COMMAND = """#!/bin/sh
test "$1" = --version && echo cassini_bayes 9.9 && exit
echo "$@" >> {log}
while test "$1" != --out; do shift; done
mkdir -p "$2" && cp {said} "$2/diagnosis.json"
"""


def module_of(name: str, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """A module of the benchmark; it needs no Basilisk."""
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    module = importlib.import_module(f"closed_loop.{name}")
    for name in [name for name in sys.modules if name.startswith("closed_loop")]:
        monkeypatch.delitem(sys.modules, name)
    return module


@pytest.fixture
def answers(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """What finished trials say."""
    return module_of("answers", monkeypatch)


def trial(index: int, hidden: dict[str, float], causes: list[dict[str, Any]]) -> dict[str, Any]:
    """A finished trial that hides a leak of Z3 with some sizes."""
    return {
        "index": index,
        "package": "cassini_bayes 0.1.0",
        "stratum": "clear",
        "conditions": CONDITIONS,
        "hidden": [{"name": "thruster_leak:z3", "parameters": hidden, "sigma": 7.0}],
        "diagnosis": {"causes": causes, "p_value": 0.01 * index, "wall_s": 50.0, "exit_status": 2},
    }


def cause(name: str, likes: list[str], **sizes: tuple[float, float]) -> dict[str, Any]:
    """A cause with 90 % intervals of its sizes."""
    parameters = {key: {"hdi_90": list(bounds)} for key, bounds in sizes.items()}
    return {
        "name": name,
        "probability": 0.9,
        "confounded_with": likes,
        "parameters": parameters,
    }


def trials() -> list[dict[str, Any]]:
    """One right, one like the first, one none, one refused."""
    leak = cause("thruster_leak:z3", [], leak_n=(0.8, 1.2))
    return [
        trial(1, {"leak_n": 1.0}, [leak]),
        trial(3, {"leak_n": 2.0}, [cause("external_torque", ["thruster_leak:z3"]), leak]),
        trial(5, {"leak_n": 3.0}, [cause("none", [])]),
        trial(7, {"leak_n": 4.0}, []),
    ]


def test_shares_and_sizes_are_counted(answers: ModuleType) -> None:
    """Of four trials one is right and one like the first; of two sizes one is held.

    0.006 … 0.806 is the exact interval of one of four: (1 − p)⁴ and the like are 0.025 at its ends.
    """
    said = answers.summary(trials())
    assert "clear: 4: 1 right, 1 group, 1 none, 1 failed" in said
    assert "right: 1 of 4 (0.250; 0.006 … 0.806, 95 %)" in said
    assert "right, or listed as confounded with the first: 2 of 4" in said
    assert "p-values below 0.05: 2 of 4" in said
    assert "90 % HDIs of sizes that hold the truth: 1 of 2" in said
    assert "by kind: thruster_leak 2 of 4" in said
    assert "3 leak_n: 2 is not in 0.8 … 1.2 (90 % HDI)" in said


def test_what_the_oracle_cannot_tell_counts_as_named(answers: ModuleType) -> None:
    """Of 5 to 10 σ by the oracle; a trial without an oracle's size has the benchmark's own."""
    first = [cause("external_torque", [])]
    records = [trial(index, {"leak_n": 1.0}, first) for index in (1, 3, 5, 7)]
    alike = ["thruster_leak:z3", "external_torque"]
    for record, size, group in zip(
        records[:3], (None, 4.0, 12.0), (alike, alike, alike[:1]), strict=True
    ):
        record["oracle"] = {"sigma": size, "group": group}
    said = answers.summary(records)
    assert "right: 0 of 4" in said
    assert "first is in the oracle's group: 2 of 3" in said
    assert "oracle's group, 5 to 10 σ: 1 of 1" in said
    assert "oracle's group, more: 0 of 1" in said
    assert "oracle's group, less: 1 of 1" in said
    rows = list(csv.DictReader(io.StringIO(answers.table(records))))
    assert [row["oracle_sigma"] for row in rows] == ["7.00", "4.00", "12.00", ""]
    assert rows[0]["oracle_group"] == "thruster_leak:z3 external_torque"


def test_a_frequency_is_that_of_the_free_spacecraft(answers: ModuleType) -> None:
    """Where a record lacks it, it does not count: the spring alone swings slower."""
    found = cause("flexible_mode", [], frequency_hz=(0.101, 0.103))
    record = trial(1, {"frequency_hz": 0.1}, [found])
    record["hidden"][0]["name"] = "flexible_mode"
    assert list(answers.sizes(record)) == []
    record["free_frequency_hz"] = 0.102
    assert list(answers.sizes(record)) == [("frequency_hz", 0.102, (0.101, 0.103))]


def test_the_table_has_a_row_of_each(answers: ModuleType) -> None:
    """Conditions, what is hidden, what is first and how likely, of a refused one as well."""
    rows = list(csv.DictReader(io.StringIO(answers.table(trials()))))
    assert [row["first"] for row in rows] == [
        "thruster_leak:z3",
        "external_torque",
        "none",
        "failed",
    ]
    assert [row["named"] + row["confounded"] for row in rows] == ["10", "01", "00", "00"]
    assert rows[0]["events"] == "bias slew"
    assert rows[0]["sigma"] == "7.0"
    assert rows[3]["probability"] == "nan"


def test_kept_flights_are_judged_anew(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Facts of the flight stay, answers are new and the oracle's go; twice is once.

    What kept no telemetry is left alone.
    """
    judge, setting = (getattr(module_of("trials", monkeypatch), n) for n in ("judge", "Setting"))
    flights, out, log = tmp_path / "flights", tmp_path / "out", tmp_path / "called.txt"
    record = trials()[0] | {"oracle": {"sigma": 3.0}}
    for index in (1, 2):
        (flights / f"{index:05d}" / "record").mkdir(parents=True)
        (flights / f"{index:05d}.json").write_text(json.dumps(record | {"index": index}))
    (flights / "00002" / "record").rmdir()
    told = {"causes": [cause("none", [])], "discrepant": False, "p_value": 0.5, "gain": None}
    (said := tmp_path / "said.json").write_text(json.dumps(told | {"extended": {"causes": []}}))
    (command := tmp_path / "command").write_text(COMMAND.format(log=log, said=said))
    command.chmod(0o755)
    for index in (1, 1, 2):
        judge(setting(1, {}, out, str(command), keep=True), index, flights, lambda _: None)
    assert [path.name for path in sorted(out.glob("*.json"))] == ["00001.json"]
    own = json.loads((out / "00001.json").read_text())
    assert own["diagnosis"]["causes"] == told["causes"]
    assert own["diagnosis"]["exit_status"] == 0
    assert (own["package"], own["hidden"]) == ("cassini_bayes 9.9", record["hidden"])
    assert "oracle" not in own
    (called,) = log.read_text().splitlines()
    record_folder = out / "00001" / "record"
    assert called.startswith(f"diagnose {record_folder}/1-bias {record_folder}/2-slew --priors ")
    assert record_folder.is_dir()
