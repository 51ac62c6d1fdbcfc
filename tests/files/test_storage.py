"""Files are replaced whole or not at all, whatever goes wrong while they are written."""

from __future__ import annotations

import errno
import hashlib
import os
import subprocess
import sys
from pathlib import Path
from subprocess import PIPE

import pytest

from cassini_bayes.errors import InputError
from cassini_bayes.files import storage
from cassini_bayes.files.storage import (
    atomic_write,
    digest,
    is_leftover,
    remove_leftovers,
    write_bytes,
    write_text,
)


def full_disk(*_: object) -> None:
    """What a system call says when no space is left."""
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def names(folder: Path) -> list[str]:
    """Everything in a folder, hidden files too."""
    return sorted(path.name for path in folder.iterdir())


def test_text_and_bytes_come_back(tmp_path: Path) -> None:
    """What is written is read back exactly, missing folders are made, the old file is replaced."""
    path = tmp_path / "new" / "folder" / "file.csv"
    write_text(path, "a,ΔV\n1,2\n")
    assert path.read_bytes() == "a,ΔV\n1,2\n".encode()
    write_bytes(path, b"\x00\xff")
    assert path.read_bytes() == b"\x00\xff"
    assert names(path.parent) == ["file.csv"]
    assert path.stat().st_mode & 0o777 == 0o644


def test_digest_is_sha256(tmp_path: Path) -> None:
    """The digest is hashlib's; a file that is not there is one line."""
    write_bytes(tmp_path / "x", b"abc")
    assert digest(tmp_path / "x") == hashlib.sha256(b"abc").hexdigest()
    with pytest.raises(InputError, match="no such file"):
        digest(tmp_path / "y")


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt, InputError("a", "b", "c", "d")])
def test_an_interrupted_write_leaves_the_old_file(
    tmp_path: Path, error: type[BaseException] | BaseException
) -> None:
    """Whatever ends a write half-way, the old content stays and no temporary file does."""
    path = tmp_path / "file.txt"
    write_text(path, "old")

    def write_half() -> None:
        with atomic_write(path) as temporary:
            temporary.write_text("half of the n")
            assert len(names(tmp_path)) == 2  # negative control: there is something to remove
            raise error

    with pytest.raises(error if isinstance(error, type) else type(error)):
        write_half()
    assert path.read_text() == "old"
    assert names(tmp_path) == ["file.txt"]


@pytest.mark.parametrize("call", ["fsync", "replace"])
def test_a_full_disk_is_said_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, call: str
) -> None:
    """ENOSPC when syncing or moving into place: file, reason and fix; the old file stays."""
    path = tmp_path / "file.txt"
    write_text(path, "old")
    if call == "fsync":
        monkeypatch.setattr(storage.os, "fsync", full_disk)
    else:
        monkeypatch.setattr(Path, "replace", full_disk)
    with pytest.raises(InputError) as caught:
        write_text(path, "new")
    monkeypatch.undo()
    message = str(caught.value)
    assert str(path) in message
    assert os.strerror(errno.ENOSPC) in message
    assert "free some space" in message
    assert "\n" not in message
    assert path.read_text() == "old"
    assert names(tmp_path) == ["file.txt"]


def test_a_full_disk_while_writing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The bytes themselves do not fit: the same."""
    path = tmp_path / "file.bin"
    write_bytes(path, b"old")
    monkeypatch.setattr(Path, "write_bytes", full_disk)
    with pytest.raises(InputError, match=r"file\.bin"):
        write_bytes(path, b"new")
    monkeypatch.undo()
    assert path.read_bytes() == b"old"
    assert names(tmp_path) == ["file.bin"]


def test_a_file_where_a_folder_is_expected(tmp_path: Path) -> None:
    """A place that cannot be written is named."""
    (tmp_path / "occupied").write_text("a file")
    with pytest.raises(InputError, match="occupied"):
        write_text(tmp_path / "occupied" / "file.txt", "text")
    assert (tmp_path / "occupied").read_text() == "a file"


def test_a_folder_where_the_file_should_be(tmp_path: Path) -> None:
    """A folder of that name is not replaced."""
    (tmp_path / "taken" / "inside").mkdir(parents=True)
    with pytest.raises(InputError, match="taken"):
        write_text(tmp_path / "taken", "text")
    assert names(tmp_path) == ["taken"]


def test_leftovers_of_a_killed_write_are_known_and_removed(tmp_path: Path) -> None:
    """Only what atomic_write leaves is a leftover; hidden files of others stay."""
    write_text(tmp_path / "fit.nc", "complete")
    own = [".gitignore", ".partial", "notes.partial.txt", ".fit.nc.swp"]
    for name in own:
        (tmp_path / name).write_text("the user's")
    with atomic_write(tmp_path / "sub" / "fit.nc") as temporary:
        # as SIGKILL leaves it: nothing is cleaned up
        killed = temporary.with_name(temporary.name.replace("fit", "fat"))
        killed.write_text("half")
        assert is_leftover(temporary)
    assert is_leftover(killed)
    remove_leftovers(tmp_path)
    assert names(tmp_path) == sorted([*own, "fit.nc", "sub"])
    assert names(tmp_path / "sub") == ["fit.nc"]


@pytest.mark.parametrize("name", ["fit.nc", "plain"])
def test_what_another_process_is_writing_stays(tmp_path: Path, name: str) -> None:
    """Two sweeps may share a folder; once the other process has ended, its files are leftovers."""
    write = (
        "import sys, pathlib; from cassini_bayes.files.storage import atomic_write\n"
        "with atomic_write(pathlib.Path(sys.argv[1])) as temporary:\n"
        "    print(temporary.name, flush=True)\n"
        "    sys.stdin.read()\n"
    )
    arguments = [sys.executable, "-c", write, str(tmp_path / name)]
    with subprocess.Popen(arguments, stdin=PIPE, stdout=PIPE, text=True) as other:
        assert other.stdout is not None
        written = other.stdout.readline().strip()
        remove_leftovers(tmp_path)
        assert names(tmp_path) == [written]
        other.kill()
    assert names(tmp_path) == [written]
    remove_leftovers(tmp_path)
    assert names(tmp_path) == []


def test_leftovers_of_any_user_or_number_can_be_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A process of another user runs; a number that no process can have is of none."""
    ours = [".a.1-x.partial", f".b.{10**30}-x.partial", ".c.x8.partial.toml"]
    for name in ours:
        (tmp_path / name).write_text("half")

    def denied(number: int, _: int) -> None:
        if number == 1:
            raise PermissionError
        raise OverflowError

    monkeypatch.setattr(storage.os, "kill", denied)
    remove_leftovers(tmp_path)
    assert names(tmp_path) == [".a.1-x.partial"]


def test_a_temporary_file_without_suffix_is_a_leftover_too(tmp_path: Path) -> None:
    """Files without an extension leave leftovers that are found."""
    with atomic_write(tmp_path / "plain") as temporary:
        assert is_leftover(temporary)
        temporary.write_text("x")
