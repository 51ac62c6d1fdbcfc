"""Writing files so that a crash, a kill or a full disk never leaves half of one behind."""

from __future__ import annotations

import hashlib
import os
import re
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from cassini_bayes.errors import InputError
from cassini_bayes.files.reading import open_file

PARTIAL: Final = ".partial"
"""Marks the temporary files of :func:`atomic_write`; only a kill leaves one behind."""
_MADE_BY: Final = re.compile(rf"\.(\d+)-[^.]*{re.escape(PARTIAL)}")  # number of the process


@contextmanager
def atomic_write(path: Path) -> Iterator[Path]:
    """Yield a temporary path beside ``path``; move it into place once it is complete and synced.

    On any failure the temporary file is removed and an existing ``path`` is left as it was.

    Raises
    ------
    InputError
        The folder cannot be written (permissions, disk full, not a folder).
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(
            dir=path.parent,
            prefix=f".{path.name}.{os.getpid()}-",
            suffix=f"{PARTIAL}{path.suffix}",
        )
        os.close(handle)
    except OSError as error:
        raise _unwritable(path, error) from error
    temporary = Path(name)
    try:
        yield temporary
        _sync(temporary)
        temporary.chmod(0o644)
        temporary.replace(path)
        _sync(path.parent)
    except OSError as error:
        raise _unwritable(path, error) from error
    finally:
        temporary.unlink(missing_ok=True)


def is_leftover(path: Path) -> bool:
    """Whether a file is what a killed :func:`atomic_write` left behind."""
    return path.name.startswith(".") and PARTIAL in path.suffixes


def remove_leftovers(folder: Path) -> None:
    """Remove, in a folder and those below it, what killed writes left behind.

    What another process of this host is writing stays.
    """
    for path in folder.rglob(f".*{PARTIAL}*"):
        if is_leftover(path) and not _is_being_written(path):
            path.unlink(missing_ok=True)


def _is_being_written(path: Path) -> bool:
    """Whether another process that runs on this host has made a temporary file."""
    made_by = _MADE_BY.search(path.name)
    if made_by is None or int(made_by[1]) == os.getpid():  # a killed one may have had our number
        return False
    try:
        os.kill(int(made_by[1]), 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:
        pass  # of another user
    return True


def _sync(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _unwritable(path: Path, error: OSError) -> InputError:
    if isinstance(error, FileExistsError | NotADirectoryError):
        return InputError(
            str(path), "a folder that can be written", "a file", "choose another output folder"
        )
    return InputError(
        str(path),
        "a place that can be written",
        error.strerror or str(error),
        "free some space, or choose another output folder; nothing was half-written",
    )


def write_text(path: Path, text: str) -> None:
    """Write UTF-8 text atomically."""
    with atomic_write(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def write_bytes(path: Path, content: bytes) -> None:
    """Write bytes atomically."""
    with atomic_write(path) as temporary:
        temporary.write_bytes(content)


def digest(path: Path, what: str = "a file") -> str:
    """SHA-256 of a file's content, hexadecimal.

    Raises
    ------
    InputError
        The file cannot be read.
    """
    with open_file(path, what) as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
