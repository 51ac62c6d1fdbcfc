"""The one way to read a file: its bytes or text, after a check of its kind and size."""

from __future__ import annotations

import errno
import itertools
import stat
from collections.abc import Callable
from io import BufferedReader
from pathlib import Path
from typing import Final

from cassini_bayes.errors import InputError
from cassini_bayes.files.checks import closest

MOST_NEIGHBOURS: Final = 1000
_SPECIAL: Final[tuple[tuple[Callable[[int], bool], str], ...]] = (
    (stat.S_ISDIR, "a folder"),
    (stat.S_ISFIFO, "a named pipe"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
    (stat.S_ISSOCK, "a socket"),
)


def exists(path: Path) -> bool:
    """Whether there is something at a path, also at one that no file can have."""
    try:
        return path.exists()
    except OSError:
        return False


def open_file(path: Path, what: str) -> BufferedReader:
    """Open a regular file for reading; a pipe or device, which might never end, is refused unread.

    Parameters
    ----------
    path
        The file.
    what
        What it should be, for messages: ``a priors file``.

    Raises
    ------
    InputError
        No such file (with the nearest name in its folder), a folder, a pipe or device, no
        permission, or a path that no file can have.
    """
    try:
        mode = path.stat().st_mode
        for test, result in _SPECIAL:
            if test(mode):
                raise InputError(str(path), what, result, "name the file itself")
        return path.open("rb")
    except OSError as error:
        raise _unreadable(path, what, error) from None
    except ValueError:
        got = "a path with a null character"
        raise InputError(str(path), what, got, "check the path") from None


def read_bytes(path: Path, what: str, most: int) -> bytes:
    """Content of a regular file of at most ``most`` bytes.

    Raises
    ------
    InputError
        As :func:`open_file`, or a larger file.
    """
    with open_file(path, what) as stream:
        try:
            content = stream.read(most + 1)
        except OSError as error:
            raise _unreadable(path, what, error) from None
    if len(content) > most:
        expected = f"{what} of at most {most:,} bytes"
        raise InputError(str(path), expected, "a larger one", "check that it is one")
    return content


def text_of(content: bytes, where: str) -> str:
    """UTF-8 text, with or without a byte-order mark.

    Raises
    ------
    InputError
        Other bytes; the message names their line.
    """
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content[: error.start].count(b"\n") + 1
        raise InputError(
            f"{where}: line {line}", "UTF-8 text", "other bytes", "save the file as UTF-8"
        ) from None


def _unreadable(path: Path, what: str, error: OSError) -> InputError:
    if error.errno != errno.ENOENT:
        got = error.strerror or str(error)
        return InputError(str(path), what, got, "name a file that can be read")
    close = closest(path.name, _neighbours(path))
    hint = f"did you mean {close!r}?" if close else "check the path"
    return InputError(str(path), what, "no such file", hint)


def _neighbours(path: Path) -> list[str]:
    """Names of the same suffix beside a path."""
    try:
        names = [entry.name for entry in itertools.islice(path.parent.iterdir(), MOST_NEIGHBOURS)]
    except OSError:
        return []
    return [name for name in names if name.endswith(path.suffix)]
