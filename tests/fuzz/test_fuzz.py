"""No input ends in anything but a result or one line of the package, whatever a file holds."""

from __future__ import annotations

import ast
import sys
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from types import FrameType

import fuzzing
import pytest
from fuzzing import SHORT, Tally, feed, fuzz, page_of
from hypothesis import given
from hypothesis import strategies as st
from readers import Good, good_files
from test_doors import Door

import cassini_bayes
from cassini_bayes.errors import InputError
from cassini_bayes.files.cells import rows_of
from cassini_bayes.files.checks import in_utc, parse_number
from cassini_bayes.files.json_file import json_of
from cassini_bayes.files.toml_file import toml_of

SEED = 20_261_122
PACKAGE = Path(cassini_bayes.__file__).parent
OPENING = {"read_toml", "toml_of", "read_rows", "rows_of", "read_json", "read_groups"} | {
    "read_arrays", "open_file", "read_bytes", "first_line", "read_foreign"
}  # fmt: skip
# What the package reads of its own making, and remakes where it cannot: damage there costs time.
OWN = {"balance/statistics/archive.py", "model/event_reduction.py", "priors/chaining.py"} | {
    "prediction/physics.py", "pipeline/provenance.py", "pipeline/starting.py"
}  # fmt: skip


def test_damaged_files_are_taken_or_refused() -> None:
    """A thousand of them, over all readers, each within two seconds."""
    tallies = fuzz(SEED, SHORT)
    assert [fault for tally in tallies.values() for fault in tally.faults] == []
    assert sum(tally.refused for tally in tallies.values()) > SHORT // 2
    # negative control: mutations leave some files good, so that more than headers is tried
    assert {name for name, tally in tallies.items() if tally.taken} >= {"run", "checked telemetry"}


def test_a_fault_is_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Negative control: a foreign exception, a warning, an endless loop, a message of two lines."""

    def two_lines(path: Path) -> object:
        error = InputError("x", "y", "z", "w")
        error.args = ("a\nb",)
        raise error

    def warns(path: Path) -> object:
        import warnings

        warnings.warn("numbers overflow", RuntimeWarning, stacklevel=1)
        return None

    def for_ever(path: Path) -> object:
        while True:
            pass

    def divides(path: Path) -> object:
        return 1 / 0

    monkeypatch.setattr(fuzzing, "MOST_SECONDS", 0.1)
    for read in (divides, warns, for_ever, two_lines):
        tally = Tally()
        feed(Good("made up", Door("my.toml", None, read), b""), b"", tally, "made up 0")
        assert len(tally.faults) == 1
        assert tally.faults[0] in page_of({"made up": tally}, 1, "python tests/fuzz")


def test_every_reader_is_fuzzed() -> None:
    """Whatever opens a user's file by the doors of `files` runs when the good files are read.

    A new reader has to join `DOORS` in test_doors.py, or `MORE` in readers.py.
    """
    called: set[str] = set()

    def note(frame: FrameType, event: str, argument: object) -> None:
        called.add(frame.f_code.co_filename)

    goods = good_files()
    with TemporaryDirectory() as folder:
        for number, good in enumerate(goods.values()):
            path = Path(folder) / str(number) / good.door.name
            path.parent.mkdir()
            path.write_bytes(good.content)
            sys.setprofile(note)
            try:
                good.door.read(path)
            except InputError:
                # no telemetry beside the one, draws of another model in the other
                assert good.reader in ("event", "stored run"), good.reader
            finally:
                sys.setprofile(None)
    for path in PACKAGE.rglob("*.py"):
        name = path.relative_to(PACKAGE).as_posix()
        if name.startswith(("files/", "studies/", "published/")) or name in OWN:
            continue  # doors themselves, campaigns' own records, data of the package
        imported = {
            alias.name
            for node in ast.walk(ast.parse(path.read_text()))
            if isinstance(node, ast.ImportFrom)
            and str(node.module).startswith("cassini_bayes.files")
            for alias in node.names
        }
        assert not imported & OPENING or str(path) in called, f"{name}: not in the fuzzer"


TEXT = st.text(st.characters(codec="utf-8"), max_size=80) | st.text('0123456789.eE+-,\n"[]{}=# \0')


@given(TEXT)
def test_any_text_is_a_table_or_refused(text: str) -> None:
    """CSV, TOML and JSON of any characters; numbers and epochs of any text."""
    assert parse_number(text) is None or text.strip()
    in_utc(text)
    for read in (
        lambda: rows_of("x", text, ("a", "b"), ("a",)),
        lambda: toml_of(text.encode(), "x"),
        lambda: json_of(text.encode(), "x", "an object"),
    ):
        with suppress(InputError):
            read()
