"""Every reader of the package refuses in one line, at once, whatever its file holds."""

from __future__ import annotations

import os
import shutil
import signal
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import h5py
import numpy as np
import pytest
import scipy.io
from event_folder_cases import CASSINI, bias_rows, write_event

from cassini_bayes.diagnosis.estimates import read_estimates
from cassini_bayes.effects.registry import read_kinds
from cassini_bayes.errors import InputError
from cassini_bayes.events.telemetry import load_event, read_channel_map, read_event
from cassini_bayes.events.totals import read_totals
from cassini_bayes.files import cells, json_file, toml_file
from cassini_bayes.files.foreign import read_foreign
from cassini_bayes.model.mission.mission_file import read_mission_file
from cassini_bayes.pipeline.run_file import read_run_file
from cassini_bayes.prediction.beliefs import read_beliefs
from cassini_bayes.prediction.requests import read_requests
from cassini_bayes.prediction.sources import read_sources
from cassini_bayes.priors.reader import read_priors
from cassini_bayes.results.record import read_fit
from cassini_bayes.simulation import read_scenario
from cassini_bayes.spacecraft import load_spacecraft
from cassini_bayes.sweep.specification import read_sweep_file

ROOT: Final = Path(__file__).parents[1]
PACKAGE: Final = ROOT / "cassini_bayes"
PRIORS: Final = ROOT / "priors" / "cassini_b_branch_2010.toml"
ESTIMATES: Final = ROOT / "priors" / "cassini_a_branch_2004_estimates.csv"
MOST_SECONDS: Final = 10  # a reader that hangs does so for ever; a busy machine is slow


@dataclass(frozen=True)
class Door:
    """A reader: the name its file has to have, a good one to start from, and the call."""

    name: str
    good: Path | None
    read: Callable[[Path], object]

    @property
    def suffix(self) -> str:
        """Its kind of file."""
        return Path(self.name).suffix


def _sources(path: Path) -> object:
    """Read a record beside a fit; what is not under test stands there as it should."""
    fit = path.parent / "fit.nc"
    if not fit.exists():
        fit.write_bytes(b"")
    if path.name == "provenance.json":
        (path.parent / "resolved.toml").write_text('priors = "p.toml"\nevents = ["e.csv"]\n')
    return read_sources(fit)


def _event(path: Path) -> object:
    """Read the event folder of a file."""
    other = write_event(path.parent / "whole", bias_rows())
    for name in ("event.toml", "telemetry.csv"):
        if not (path.parent / name).exists() and path.name != name:
            shutil.copy(other / name, path.parent / name)
    shutil.rmtree(other)
    return load_event(read_event(path.parent, CASSINI), CASSINI)


DOORS: Final = {
    "spacecraft": Door("my.toml", PACKAGE / "spacecraft" / "cassini.toml", load_spacecraft),
    "priors": Door("my.toml", PRIORS, read_priors),
    "run": Door("my.toml", ROOT / "runs" / "flight_2009_2010.toml", read_run_file),
    "sweep": Door("my.toml", ROOT / "runs" / "sweeps" / "flight_2009_2010.toml", read_sweep_file),
    "scenario": Door("my.toml", ROOT / "runs" / "scenarios" / "burn_2004.toml", read_scenario),
    "effects": Door(
        "my.toml",
        PACKAGE / "effects" / "causes.toml",
        lambda path: read_kinds([path]),
    ),
    "channels": Door(
        "my.toml", ROOT / "docs" / "examples" / "own_csv" / "channels.toml", read_channel_map
    ),
    "mission": Door("my.toml", ROOT / "runs" / "cassini_mission.toml", read_mission_file),
    "beliefs": Door("my.toml", PACKAGE / "prediction" / "prediction.toml", read_beliefs),
    "event": Door("event.toml", None, _event),
    "resolved": Door("resolved.toml", None, _sources),
    "provenance": Door("provenance.json", None, _sources),
    "totals": Door(
        "my.csv",
        PACKAGE / "published" / "flight_2009_2010.csv",
        lambda path: read_totals(path, CASSINI),
    ),
    "requests": Door("my.csv", None, lambda path: read_requests(path, CASSINI)),
    "estimates": Door(
        "my.csv",
        ESTIMATES,
        lambda path: read_estimates(path, CASSINI.thruster_names("A")),
    ),
    "telemetry": Door("telemetry.csv", None, _event),
    "fit": Door("my.nc", None, read_fit),
    "HDF5": Door("my.h5", None, read_foreign),
    "MATLAB": Door("my.mat", None, read_foreign),
}
# These say themselves that nothing is there: no run needs a record beside its fit.
MAY_BE_ABSENT: Final = ("resolved", "provenance")


@pytest.fixture(autouse=True)
def at_once() -> Iterator[None]:
    """End a reader that waits for ever or takes quadratic time."""

    def ring(*_: object) -> None:
        raise TimeoutError(f"not refused within {MOST_SECONDS} s")

    earlier = signal.signal(signal.SIGALRM, ring)
    signal.alarm(MOST_SECONDS)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, earlier)


def refused(door: Door, path: Path) -> str:
    """The one line with which a reader refuses a file."""
    with pytest.raises(InputError) as caught:
        door.read(path)
    message = str(caught.value)
    assert message.isprintable()
    assert len(message) < 2_000
    assert message.startswith(str(path.parent)[:50])
    return message


def make_folder(path: Path) -> None:
    """A folder of the name."""
    path.mkdir()


def make_pipe(path: Path) -> None:
    """A named pipe that nobody writes to."""
    os.mkfifo(path)


def make_device(path: Path) -> None:
    """A device that never ends."""
    path.symlink_to("/dev/zero")


def make_loop(path: Path) -> None:
    """A link to itself."""
    path.symlink_to(path)


SPECIAL: Final = {
    "folder": (make_folder, "a folder"),
    "pipe": (make_pipe, "a named pipe"),
    "device": (make_device, "a device"),
    "loop": (make_loop, "symbolic links"),
}


# A link to itself leads nowhere: where a file may be absent, it is.
NOT_FILES: Final = [
    (door, special)
    for door in DOORS
    for special in SPECIAL
    if special != "loop" or DOORS[door].name.startswith("my")
]


@pytest.mark.parametrize(("door", "special"), NOT_FILES)
def test_what_is_no_file_is_refused_unread(tmp_path: Path, door: str, special: str) -> None:
    """A folder, a pipe, a device, a link to itself: none is read, all are named."""
    make, said = SPECIAL[special]
    path = tmp_path / DOORS[door].name
    make(path)
    assert said in refused(DOORS[door], path)


@pytest.mark.parametrize("door", [name for name in DOORS if name not in MAY_BE_ABSENT])
def test_a_missing_file_is_named(tmp_path: Path, door: str) -> None:
    """No such file, and a neighbour of nearly the same name."""
    path = tmp_path / DOORS[door].name
    assert "expected" in refused(DOORS[door], path)
    if DOORS[door].name.startswith("my"):
        path.with_stem("mine").write_bytes(b"")
        assert f"did you mean 'mine{path.suffix}'" in refused(DOORS[door], path)


@pytest.mark.parametrize("door", [name for name in DOORS if DOORS[name].name.startswith("my")])
@pytest.mark.parametrize("name", ["n\0.x", "n" * 300], ids=["null", "long"])
def test_a_name_that_no_file_has_is_refused(tmp_path: Path, door: str, name: str) -> None:
    """A null character, a name too long for the system, a path that goes on below a file."""
    suffix = DOORS[door].suffix
    refused(DOORS[door], tmp_path / f"{name}{suffix}")
    (tmp_path / "file").write_bytes(b"")
    refused(DOORS[door], tmp_path / "file" / f"below{suffix}")


@pytest.mark.parametrize("door", DOORS)
def test_a_file_without_permission_is_refused(
    tmp_path: Path, door: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What the system refuses is said in its words (its answer is made up: root may read all)."""
    path = tmp_path / DOORS[door].name
    path.write_bytes(b"")

    opened = Path.open

    def refuse(self: Path, *args: object, **kwargs: object) -> object:
        if self == path:
            raise PermissionError(13, "Permission denied")
        return opened(self, *args, **kwargs)  # type: ignore[call-overload]

    monkeypatch.setattr(Path, "open", refuse)
    assert "Permission denied" in refused(DOORS[door], path)


SIZED: Final = {".toml": toml_file, ".csv": cells, ".json": json_file}


@pytest.mark.parametrize(
    "door", [d for d in DOORS if DOORS[d].suffix in SIZED and d != "telemetry"]
)
def test_a_file_beyond_all_size_is_not_read(tmp_path: Path, door: str) -> None:
    """A terabyte of nothing, as a sparse file: refused by its size, not by the end of memory."""
    path = tmp_path / DOORS[door].name
    path.touch()
    os.truncate(path, 1 << 40)
    most = SIZED[DOORS[door].suffix].MOST_BYTES
    assert f"at most {most:,} bytes" in refused(DOORS[door], path)


DEEP: Final = 3_000
TEXTS: Final = {
    "latin": (b'x = "5 \xb5N m"\n', "UTF-8"),
    "second line latin": (b'x = 1\ny = "\xb5"\n', "line 2"),
    "UTF-16": ('x = "5"\n'.encode("utf-16"), "UTF-8"),
    "null": (b"x = 1\0\n", "expected"),
    "null in a text": (b'x = [1, "a\\u0000"]\n', "x[2]"),
    "5,000 digits": (b"x = " + b"9" * 5_000 + b"\n", "400 characters"),
    "5,000 hexadecimal digits": (b"x = 0x" + b"f" * 5_000 + b"\n", "400 characters"),
    "200,000 decimals": (b"x = 0." + b"3" * 200_000 + b"\n", "400 characters"),
    "more than 64 bits": (b"x = [1, " + b"9" * 30 + b"]\n", "x[2]"),
    "deep arrays": (b"x = " + b"[" * DEEP + b"]" * DEEP, "32 levels"),
    "deep tables": (b"x = " + b"{a = " * DEEP + b"1" + b"}" * DEEP, "32 levels"),
    "open brackets": (b"x = " + b"[" * 500_000, "32 levels"),
    "a long dotted key": (b"a" + b".a" * 400_000 + b" = 1\n", "32 levels"),
    "a long dotted header": (b"[a" + b" . 'a'" * 100_000 + b"]\n", "32 levels"),
    "no end of a text": (b'x = """' + b"\\" * 500_001, "TOML"),
    "no end of a quote": (b"x = '" * 200_000, "TOML"),
    "a table twice": (b"[x]\n[x]\n", "TOML"),
    "twice a key": (b"x = 1\nx = 2\n", "TOML"),
    "no such date": (b"x = 2010-02-31\n", "TOML"),
}


@pytest.mark.parametrize("text", TEXTS)
@pytest.mark.parametrize("door", [name for name in DOORS if DOORS[name].suffix == ".toml"])
def test_bad_toml_is_refused(tmp_path: Path, door: str, text: str) -> None:
    """Bytes that are no text, numbers, brackets and keys beyond all bounds, syntax: at once."""
    content, said = TEXTS[text]
    path = tmp_path / DOORS[door].name
    path.write_bytes(content)
    assert said in refused(DOORS[door], path)


JSONS: Final = {
    "nothing": (b"", "JSON"),
    "cut": (b'{"sha256": {"a": ', "JSON"),
    "no object": (b"[1, 2]", "no object"),
    "other keys": (b'{"sha256": 3}', "digests"),
    "latin": (b'{"x": "\xb5"}', "UTF-8"),
    "deep arrays": (b"[" * 100_000, "32 levels"),
    "deep objects": (b'{"a":' * 100_000, "32 levels"),
    "5,000 digits": (b'{"x": ' + b"9" * 5_000 + b"}", "400 characters"),
}


@pytest.mark.parametrize("text", JSONS)
def test_a_bad_record_is_refused(tmp_path: Path, text: str) -> None:
    """JSON that was cut, is something else, or has no bounds."""
    content, said = JSONS[text]
    path = tmp_path / "provenance.json"
    path.write_bytes(content)
    assert said in refused(DOORS["provenance"], path)


NUMBER_OF: Final = {
    "totals": "duration_s", "requests": "rwa1_rpm_end", "estimates": "thrust_n", "telemetry": "q1"
}  # fmt: skip
ROWS: Final[dict[str, Callable[[bytes], bytes]]] = {
    "nothing": lambda _: b"",
    "a header alone": lambda content: content.partition(b"\n")[0] + b"\n",
    "no header": lambda _: b"1,2,3\n" * 3,
    "latin": lambda content: content + b"\xb5\n",
    "null": lambda content: content + b"\0" * 99 + b"\n",
    "binary": lambda _: bytes(range(256)) * 100,
    "an open quote": lambda content: content + b'"' + b"x" * 300_000,
    "digits": lambda content: content + b"9" * 100_000 + b"x,\n",
    "a long cell": lambda content: content + b"x" * 2_000_000 + b"\n",
    "many columns": lambda content: content + b"x," * 900_000 + b"\n",
    "a column twice": lambda content: content.replace(b"\n", b",id\n", 1),
}


def good_csv(door: Door, folder: Path) -> bytes:
    """A file that the reader takes."""
    if door.name == "telemetry.csv":
        return (write_event(folder / "good", bias_rows()) / "telemetry.csv").read_bytes()
    if door.good is None:
        return b"id,rwa1_rpm_start,rwa1_rpm_end\na,1,2\n"
    lines = door.good.read_bytes().splitlines(keepends=True)
    return b"".join(line for line in lines if not line.startswith(b"#"))


@pytest.mark.parametrize("rows", ROWS)
@pytest.mark.parametrize("door", [name for name in DOORS if DOORS[name].suffix == ".csv"])
def test_a_bad_table_is_refused(tmp_path: Path, door: str, rows: str) -> None:
    """Tables that end, break off, or hold what is no number."""
    path = tmp_path / DOORS[door].name
    path.write_bytes(ROWS[rows](good_csv(DOORS[door], tmp_path)))
    refused(DOORS[door], path)


NUMBERS: Final = {
    "digits": "9" * 100_000,
    "digits and a letter": "9" * 100_000 + "x",
    "digits of an exponent": "1e" + "9" * 5_000,
    "hexadecimal": "0x1f",
    "grouped": "1_000",
    "infinite": "1e999",
}


@pytest.mark.parametrize("number", NUMBERS)
@pytest.mark.parametrize("door", [name for name in DOORS if DOORS[name].suffix == ".csv"])
def test_a_bad_number_is_refused(tmp_path: Path, door: str, number: str) -> None:
    """A number of the first row as digits without end, or in another notation."""
    path = tmp_path / DOORS[door].name
    header, first, *rest = good_csv(DOORS[door], tmp_path).decode().splitlines()
    cells = first.split(",")
    cells[header.split(",").index(NUMBER_OF[door])] = NUMBERS[number]
    path.write_text("\n".join((header, ",".join(cells), *rest)) + "\n")
    refused(DOORS[door], path)


@pytest.mark.parametrize("door", [name for name in DOORS if DOORS[name].good is not None])
@pytest.mark.parametrize("mark", [b"", b"\xef\xbb\xbf"])
def test_a_good_file_is_taken(tmp_path: Path, door: str, mark: bytes) -> None:
    """Negative control: the shipped file is read, with and without a byte-order mark."""
    good = DOORS[door].good
    assert good is not None
    path = tmp_path / DOORS[door].name
    text = good.read_text().replace("../../priors", str(ROOT / "priors"))
    path.write_bytes(mark + text.encode())
    assert DOORS[door].read(path)


@pytest.mark.parametrize("door", [name for name in DOORS if DOORS[name].suffix == ".csv"])
@pytest.mark.parametrize("mark", [b"", b"\xef\xbb\xbf"])
def test_a_good_table_is_taken(tmp_path: Path, door: str, mark: bytes) -> None:
    """Negative control: what the bad tables were made from is read, with and without the mark."""
    path = tmp_path / DOORS[door].name
    path.write_bytes(mark + good_csv(DOORS[door], tmp_path))
    assert DOORS[door].read(path)


@pytest.mark.parametrize("content", [b"", b"text", b"\x89HDF\r\n\x1a\n", b"CDF\x01" + bytes(99)])
def test_a_bad_fit_is_refused(tmp_path: Path, content: bytes) -> None:
    """Nothing, text, and the first bytes of HDF5 and of classic NetCDF."""
    path = tmp_path / "my.nc"
    path.write_bytes(content)
    refused(DOORS["fit"], path)


@pytest.mark.parametrize("door", ["HDF5", "MATLAB"])
@pytest.mark.parametrize(
    "content",
    [b"", b"text", b"\x89HDF\r\n\x1a\n" + bytes(99), b"MATLAB 5.0"],
    ids=["nothing", "text", "HDF5 cut", "MATLAB cut"],
)
def test_bytes_of_another_kind_are_refused(tmp_path: Path, door: str, content: bytes) -> None:
    """Nothing, text, and the first bytes of a foreign file."""
    path = tmp_path / DOORS[door].name
    path.write_bytes(content)
    refused(DOORS[door], path)


@pytest.mark.parametrize("door", ["HDF5", "MATLAB"])
def test_a_damaged_foreign_file_is_read_or_refused(tmp_path: Path, door: str) -> None:
    """Bytes changed anywhere: columns or one line, never a crash or a wait (seeded)."""
    path = tmp_path / DOORS[door].name
    values = np.arange(500.0)
    if door == "HDF5":
        with h5py.File(path, "w") as file:
            file.create_dataset("group/x", data=values, compression="gzip")
    else:
        scipy.io.savemat(path, {"group": {"x": values}}, do_compression=True)
    good = path.read_bytes()
    name = "group/x" if door == "HDF5" else "group.x"
    assert read_foreign(path, [name]).columns[name].tolist() == values.tolist()
    rng = np.random.default_rng(1)
    for count in (3, 30):
        signal.alarm(MOST_SECONDS)
        content = bytearray(good)
        for place in rng.integers(0, len(good), count).tolist():
            content[place] = int(rng.integers(256))
        path.write_bytes(content)
        with suppress(InputError):  # any other error fails
            DOORS[door].read(path)


def test_objects_of_foreign_files_are_not_unpacked(tmp_path: Path) -> None:
    """Cells, references and pickles are named as what they are, and stay shut."""
    path = tmp_path / "my.mat"
    scipy.io.savemat(path, {"t": [1.0, 2.0], "c": np.array([1, "x"], dtype=object)})
    found = read_foreign(path)
    assert (found.names, list(found.refused)) == (("t",), ["c"])
    with h5py.File(tmp_path / "my.h5", "w") as file:
        file["t"] = [1.0, 2.0]
        file["r"] = np.array([file["t"].ref], dtype=h5py.ref_dtype)
        file["elsewhere"] = h5py.ExternalLink("other.h5", "/t")
        file["o"] = np.void(b"\x80\x04N.")
    found = read_foreign(tmp_path / "my.h5")
    assert (found.names, sorted(found.refused)) == (("t",), ["o", "r"])


def test_a_small_file_of_a_large_array_is_refused(tmp_path: Path) -> None:
    """A terabyte that is declared and compressed to nothing is not made."""
    path = tmp_path / "my.h5"
    with h5py.File(path, "w") as file:
        file.create_dataset(
            "x", shape=(1 << 37,), dtype="f8", chunks=(1 << 16,), compression="gzip"
        )
    assert "at most" in read_foreign(path).refused["x"]


def test_a_newline_in_a_path_does_not_break_the_line(tmp_path: Path) -> None:
    """What stands in a file or a path cannot break the line."""
    message = refused(DOORS["run"], tmp_path / "a\nb.toml")
    assert "a\\nb.toml" in message
