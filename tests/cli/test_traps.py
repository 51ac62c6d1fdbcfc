"""Traps of the command line: bounds, special files, damage, interrupts: one line each, at once."""

from __future__ import annotations

import os
import re
import shutil
import zipfile
from pathlib import Path

import numpy as np
import pytest
import run_cases
from run_cases import B_BRANCH, EVENTS, FLIGHT

from cassini_bayes.diagnosis.estimates import is_estimates, read_estimates
from cassini_bayes.errors import InputError
from cassini_bayes.files import storage
from cassini_bayes.files.checkpoint import CheckpointStore
from cassini_bayes.results.record import read_fit

pytestmark = pytest.mark.usefixtures("short_warm_start")
Captured = pytest.CaptureFixture[str]
DIGITS = "9" * 27
ESTIMATES = run_cases.ROOT / "priors" / "cassini_a_branch_2004_estimates.csv"


def refused(capsys: Captured, *arguments: str) -> str:
    """The error of a command that must end with 2, without a traceback."""
    capsys.readouterr()
    assert run_cases.command(arguments) == 2
    output = capsys.readouterr()
    assert output.out == ""
    assert "Traceback" not in output.err
    return output.err


def one_line(capsys: Captured, *arguments: str) -> str:
    """The same, where the package says the error: place, expected, got, fix."""
    error = refused(capsys, *arguments)
    assert error.startswith("error: ")
    assert error.count("\n") == 1
    assert "expected" in error
    return error


def test_arithmetic_that_breaks_down_is_one_line(capsys: Captured, tmp_path: Path) -> None:
    """A scale of 1e300 N overflows: said with what to compare, and no traceback."""
    text = B_BRANCH.read_text(encoding="utf-8").replace("scale = 0.05", "scale = 1e300", 1)
    path = tmp_path / "priors.toml"
    path.write_text(text, encoding="utf-8")
    error = refused(capsys, "check", f"{FLIGHT}:{EVENTS[0]}", "--priors", str(path))
    assert error.startswith("error: the arithmetic broke down")
    assert error.count("\n") == 1
    assert "out of range" in error


COMMANDS = {
    "run": ["run", "x.toml"],
    "fit": ["fit", "x.csv", "--priors", "p.toml", "--out", "o"],
    "diagnose": ["diagnose", "x.csv", "--priors", "p.toml", "--out", "o"],
    "simulate": ["simulate", "x.toml", "--out", "o"],
    "predict": ["predict", "--fit", "f.nc", "--bias", "rwa1: 0 -> 5"],
    "plan": ["plan", "--fit", "f.nc", "--from", "rwa1: 0"],
    "published": ["diagnose-published"],
    **{
        name: ["calibrate", name]
        for name in ("totals", "sbc", "perturbations", "blind", "prediction", "simulation")
    },
}


@pytest.mark.parametrize("name", COMMANDS)
def test_a_seed_of_27_digits_is_refused_at_the_start(
    capsys: Captured, name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not when the fit is saved: no file could hold it."""
    monkeypatch.chdir(tmp_path)
    assert "--seed" in refused(capsys, *COMMANDS[name], "--seed", DIGITS)
    assert not list(tmp_path.iterdir())


def test_a_seed_of_27_digits_in_a_run_file_is_refused(capsys: Captured, tmp_path: Path) -> None:
    """By its place in the file."""
    text = run_cases.write_run(tmp_path).read_text()
    text = text.replace("[sampler]", f"[sampler]\nseed = {DIGITS}")
    (tmp_path / "small.toml").write_text(text)
    assert "sampler.seed" in one_line(capsys, "run", str(tmp_path / "small.toml"))


@pytest.mark.parametrize("device", ["/dev/zero", "pipe"])
@pytest.mark.parametrize("command", ["fit", "diagnose"])
def test_special_files_are_refused_unread(
    capsys: Captured, tmp_path: Path, command: str, device: str
) -> None:
    """As priors, as events, as effects: neither waits nor fills the memory."""
    os.mkfifo(tmp_path / "pipe")
    place = device if device.startswith("/") else str(tmp_path / device)
    out = ["--quiet", "--out", str(tmp_path / "out")]
    one_line(capsys, command, str(FLIGHT), "--priors", place, *out)
    one_line(capsys, command, place, "--priors", str(B_BRANCH), *out)
    if command == "diagnose":
        one_line(capsys, command, str(FLIGHT), "--priors", str(B_BRANCH), "--effects", place, *out)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("key", ["events", "priors"])
def test_a_null_in_a_path_is_refused(capsys: Captured, tmp_path: Path, key: str) -> None:
    """A run file can name a path that no file has."""
    table = run_cases.small_table()
    table[key] = ["a\0.csv"] if key == "events" else "a\0.toml"
    path = run_cases.write_run(tmp_path, table)
    assert "null character" in one_line(capsys, "run", str(path), "--out", str(tmp_path / "out"))


@pytest.mark.parametrize(
    "epoch",
    ["0001-01-01T00:00:00+05:00", "9999-12-31T23:59:59-05:00", "20100-01-01", "-2010-02-13", "0"],
)
def test_an_epoch_out_of_range_is_refused(capsys: Captured, tmp_path: Path, epoch: str) -> None:
    """In totals, by line and column."""
    header, *rows = FLIGHT.read_text().splitlines()
    cells = rows[0].split(",")
    cells[header.split(",").index("epoch")] = epoch
    (tmp_path / "t.csv").write_text(f"{header}\n{','.join(cells)}\n")
    place = ["--priors", str(B_BRANCH), "--out", str(tmp_path / "out"), "--source", cells[-1]]
    assert "line 2, column epoch" in one_line(capsys, "fit", str(tmp_path / "t.csv"), *place)


def test_estimates_with_blank_lines_are_read_and_latin_ones_refused(
    capsys: Captured, tmp_path: Path
) -> None:
    """Blank lines at the start, between rows and at the end; a byte of Latin-1 by its line."""
    lines = ESTIMATES.read_text().splitlines()
    spread = tmp_path / "spread.csv"
    spread.write_text("\n\n" + "\n\n".join(lines) + "\n\n\n")
    names = ("z1", "z2", "z3", "z4", "y1", "y2", "y3", "y4")
    assert read_estimates(spread, names) == read_estimates(ESTIMATES, names)
    assert is_estimates(spread)
    latin = tmp_path / "latin.csv"
    latin.write_bytes(ESTIMATES.read_bytes() + b"\xb5,\n")
    priors = run_cases.A_BRANCH
    out = ["--quiet", "--out", str(tmp_path / "out")]
    error = one_line(capsys, "diagnose", str(latin), "--priors", str(priors), *out)
    assert f"line {len(lines) + 1}" in error


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a small run."""
    folder = tmp_path_factory.mktemp("finished")
    assert run_cases.command(["run", str(run_cases.write_run(folder)), "--quiet"]) in (0, 1)
    return folder / "small"


def test_a_damaged_fit_is_one_line_at_once(
    capsys: Captured, tmp_path: Path, finished: Path
) -> None:
    """Bytes flipped, cut out, or zeroed at 300 places; a prediction says it in one line.

    The library that reads NetCDF runs for ever on some of them.
    """
    whole = (finished / "fit.nc").read_bytes()
    path = tmp_path / "fit.nc"
    rng = np.random.default_rng(18)
    for trial in range(300):
        content = bytearray(whole)
        # every other time within the first 8 kB, where the structure is
        at = int(rng.integers(8_192 if trial % 2 else len(whole) - 200))
        if trial % 3 == 0:
            del content[at : at + int(rng.integers(1, 64))]
        else:
            content[at] ^= int(rng.integers(1, 256))
        path.write_bytes(content)
        with pytest.raises(InputError, match="damaged"):
            read_fit(path)
    arguments = ["predict", "--fit", str(path), "--bias", "rwa1: 0 -> 500"]
    where = ["--events", str(FLIGHT), "--priors", str(B_BRANCH)]
    assert "damaged" in one_line(capsys, *arguments, *where)


RECORDS = [b"", b"{", b"[1]", b'{"sha256": 3}', b"\xff\xfe", b"[" * 99_999]


@pytest.mark.parametrize("content", RECORDS, ids=range(6))
def test_a_damaged_record_is_one_line(
    capsys: Captured, tmp_path: Path, finished: Path, content: bytes
) -> None:
    """provenance.json beside the fit that a prediction starts from."""
    folder = tmp_path / "small"
    shutil.copytree(finished, folder)
    (folder / "provenance.json").write_bytes(content)
    fit = str(folder / "fit.nc")
    assert "provenance.json" in one_line(capsys, "predict", "--fit", fit, "--bias", "rwa1: 0 -> 5")


def test_a_bomb_as_checkpoint_counts_as_none(tmp_path: Path) -> None:
    """A small archive that unpacks to 64 MB: its block is done again."""
    with zipfile.ZipFile(tmp_path / "block.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("header.npy", bytes(1 << 26))
    assert (tmp_path / "block.npz").stat().st_size < 1 << 17
    assert CheckpointStore(tmp_path, "own").load("block") is None


@pytest.mark.parametrize("at", ["resolved.toml", "fit.nc"])
def test_an_interrupt_while_a_file_is_saved(
    capsys: Captured, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, at: str
) -> None:
    """Ctrl-C between writing and moving into place: 130, one line, no half file."""
    path = run_cases.write_run(tmp_path)
    sync = storage._sync
    hit = []

    def interrupted(place: Path) -> None:
        if at in place.name and not hit:
            hit.append(place)
            raise KeyboardInterrupt
        sync(place)

    monkeypatch.setattr(storage, "_sync", interrupted)
    assert run_cases.command(["run", str(path), "--quiet"]) == 130
    assert hit
    error = capsys.readouterr().err
    assert error.startswith("stopped")
    assert error.count("\n") == 1
    assert not [p for p in tmp_path.rglob("*") if p.name.startswith(".")]


def test_strange_names_and_times_go_through_a_run(capsys: Captured, tmp_path: Path) -> None:
    """Ids that are broken mathematics or a formula, the first and the last epoch there are.

    Tables hold the formula as text. (A figure's names: tests/report/test_plots.py.)
    """
    header, *rows = FLIGHT.read_text().splitlines()
    at = header.split(",").index("epoch")
    chosen = [row.split(",") for row in rows if row.startswith(EVENTS) and row.endswith("flight")]
    names = (("=cmd|'/C calc'!A0", "0001-01-01T00:00:00Z"), ("$x_$", "9999-12-31T23:59:59Z"))
    for row, (name, epoch) in zip(chosen, names, strict=True):
        row[0], row[at] = name, epoch
    (tmp_path / "t.csv").write_text("\n".join([header, *map(",".join, chosen)]) + "\n")
    table = run_cases.small_table() | {"events": [str(tmp_path / "t.csv")]}
    assert run_cases.command(["run", str(run_cases.write_run(tmp_path, table)), "--quiet"]) in (
        0,
        1,
    )
    assert "Traceback" not in capsys.readouterr().err
    tables = [path.read_text() for path in (tmp_path / "small").rglob("*.csv")]
    cells = [cell for table in tables for cell in re.split("[,\n]", table)]
    assert any(cell.startswith("'=cmd") for cell in cells)
    assert not any(cell.startswith("=") for cell in cells)
