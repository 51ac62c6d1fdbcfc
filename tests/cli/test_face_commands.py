"""`check`, `causes`, `parameters`, `quantities`, `-h`, completion: what they print and refuse."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from event_cases import events, priors
from run_cases import B_BRANCH, EVENTS, FLIGHT, command
from sweep_cases import small_fit

import cassini_bayes as cb
from cassini_bayes.effects.catalogue import named_effects
from cassini_bayes.results.record import save_fit

Captured = pytest.CaptureFixture[str]
FIRST = [f"{FLIGHT}:{EVENTS[0]}", f"{FLIGHT}:{EVENTS[1]}"]


def printed(capsys: Captured, *arguments: str) -> str:
    """Standard output of a command that must end with 0."""
    capsys.readouterr()
    assert command(arguments) == 0
    return capsys.readouterr().out


def test_check_says_all_that_is_known(capsys: Captured) -> None:
    """Events and rows used, what they can see, size and time, on one page; the same as JSON."""
    text = printed(capsys, "check", *FIRST, "--priors", str(B_BRANCH))
    for said in (*EVENTS, "What these events can see", "walked and", "Sampling takes about"):
        assert said in text
    assert len(text.splitlines()) < 40
    record = json.loads(printed(capsys, "check", *FIRST, "--priors", str(B_BRANCH), "--json"))
    assert [row["event"] for row in record["rows"]] == list(EVENTS)
    ratio = {row["quantity"]: row["ratio"] for row in record["seen"]}
    assert all(0.0 < own <= 1.0 + 1e-9 for own in ratio.values())
    assert ratio["thrust[all events,z1]"] < 0.95
    assert record["seconds"][0] < record["seconds"][1]


def test_a_conflict_is_found_before_sampling(capsys: Captured) -> None:
    """A prior that slews contradict is named, the shipped one is not: `--strict` ends with 0."""
    shifted = priors().scaled(["inertia_xy_kg_m2"], shift=6.0)
    found = cb.check(events("slews"), shifted)
    assert any("inertia_xy_kg_m2: the data pull it" in line for line in found.warnings)
    assert not cb.check(events("slews"), priors()).warnings
    assert command(["check", *FIRST, "--priors", str(B_BRANCH), "--strict", "--quiet"]) == 0
    assert capsys.readouterr().err == ""


def test_a_thrust_that_the_events_contradict_is_found_before_sampling() -> None:
    """Thrusts are summed over and not walked: a common one eight widths low is still named."""
    shifted = priors().scaled(["thrust_common_n"], shift=-8.0)
    found = cb.check(events("bias"), shifted).warnings
    assert any(line.startswith("thrust_common_n: the data pull it +") for line in found)


def test_priors_that_nobody_has_replaced_are_named() -> None:
    """Placeholders of `init`, counted, in one line; of priors with sources nothing is said."""
    known = priors()
    made_up = {
        name: replace(known.parameters[name], source="placeholder: from a drawing")
        for name in ("cm_x_m", "tau_rise_s")
    }
    unknown = replace(known, parameters={**known.parameters, **made_up})
    found = cb.check(events("slews"), unknown)
    said = "2 of the priors are placeholders: tau_rise_s, cm_x_m"
    assert found.warnings == (said,)
    assert repr(found).endswith(said)
    assert found.as_record()["placeholders"] == ["tau_rise_s", "cm_x_m"]
    assert cb.check(found.model).placeholders == ()


def test_causes_that_a_fit_takes_are_told() -> None:
    """What `causes` says of names is what `fit` does: all others are refused by it."""
    table = cb.causes(B_BRANCH).drop_duplicates("name").set_index("name")["fitted_by_name"]
    assert sorted(table.index[~table]) == ["firing_logic", "flexible_mode"]
    known = priors()
    for name, fitted in table.items():
        try:
            named_effects([str(name)], known, known.wheels, ("telemetry", "totals"))
        except cb.InputError:
            assert not fitted, name
        else:
            assert fitted, name


def test_what_was_mended_stands_below_the_table() -> None:
    """A sentence of its own, not a cell as wide as the screen twice over."""
    found = cb.check(events("slews"), priors())
    said = "time_s: a row that repeats the one before it was dropped (2×, rows 42 to 82)"
    lines = repr(replace(found, rows=found.rows.assign(mended=said))).splitlines()
    assert f"mended in slews: {said}" in lines
    assert max(map(len, lines[:3])) < 100
    assert "mended" not in repr(found)


def test_lists_are_tables_and_json(capsys: Captured, tmp_path: Path) -> None:
    """Every name once with its unit; JSON has the same names."""
    save_fit(small_fit()[1], tmp_path / "fit.nc")
    for arguments, name, unit in (
        (["causes", "--priors", str(B_BRANCH)], "thruster_degraded:z3", "1"),
        (["parameters"], "tau_fall_s", "s"),
        (["parameters", "--priors", str(B_BRANCH)], "cm_x_m", "m"),
        (["quantities", str(tmp_path)], "thrust_level_n[z1]", "N"),
    ):
        text = printed(capsys, *arguments)
        rows = json.loads(printed(capsys, *arguments, "--json"))
        assert len(text.splitlines()) == len(rows) + 1
        (own, *_) = [row for row in rows if row["name"] == name]
        assert own["unit"] == unit
        assert any(line.startswith(name) for line in text.splitlines())


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["check", "nothing.csv", "--priors", str(B_BRANCH)], "nothing.csv"),
        (["check", FIRST[0], "--priors", "nothing.toml"], "nothing.toml"),
        (["causes", "--priors", "nothing.toml"], "nothing.toml"),
        (["parameters", "--spacecraft", "nowhere"], "nowhere"),
        (["quantities", "nothing"], "nothing"),
        (["report", "nothing"], "nothing"),
    ],
)
def test_mistakes_are_one_line(capsys: Captured, arguments: list[str], said: str) -> None:
    """Exit status 2, one line on standard error, nothing on standard output."""
    assert command(arguments) == 2
    output = capsys.readouterr()
    assert output.out == ""
    assert output.err.startswith("error: ")
    assert output.err.count("\n") == 1
    assert said in output.err


def test_help_is_short_and_completion_is_offered(capsys: Captured) -> None:
    """`-h` is `--help`, of the program and of each command."""
    assert printed(capsys, "-h") == printed(capsys, "--help")
    assert "--install-completion" in printed(capsys, "-h")
    assert "--priors" in printed(capsys, "check", "-h")


@pytest.mark.parametrize(
    ("line", "offered"),
    [("cassini-bayes dia", "diagnose"), ("cassini-bayes fit --pri", "--priors")],
)
def test_the_shell_completes_commands_and_options(line: str, offered: str) -> None:
    """What the script asks that `--install-completion` writes, in a process of its own."""
    asked = {
        "_CASSINI_BAYES_COMPLETE": "complete_bash",
        "COMP_WORDS": line,
        "COMP_CWORD": str(line.count(" ")),
    }
    program = "import sys; sys.argv = ['cassini-bayes']; from cassini_bayes.cli import app; app()"
    done = subprocess.run(
        [sys.executable, "-c", program],
        env={**os.environ, **asked}, capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    assert offered in done.stdout.split()
