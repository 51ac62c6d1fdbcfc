"""Damaged versions of a good file: bytes, lines, cells, keys, values, as users and disks do it."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Final

import numpy as np

Mutation = Callable[[bytes, np.random.Generator], bytes]

TOKENS: Final = (
    b"", b"0", b"-1", b"1e999", b"-1e308", b"1e-320", b"nan", b"inf", b"NaN", b"1,5", b"0x1f",
    b"9" * 40, b"9" * 5_000, b"0." + b"3" * 300, b"true", b"[]", b"{}", b"[1, 2]", b'""', b'"x"',
    b"'", b'"', b'"""', b"\0", b"\xff\xfe", b"\xc2\xb5", "−5".encode(), b"\r", b"\n\n", b";", b"\t",
    b"#", b"=cmd|' /C calc'!A0", b"$x_$", b"../../x", b"/dev/zero", b"[" * 3_000, b"{a=" * 200,
    b"2010-02-31", b"9999-12-31T23:59:59-05:00", b"0001-01-01", b"1_000", b"+", b"1e", b"()",
    b"__class__", b"%s%n", b"\\u0000", b"\x1b[31m", b"None", b"1" + b"0" * 19,
)  # fmt: skip
"""What gets into files: other notations, other types, things without bounds, things that act."""

_KEY: Final = re.compile(rb"^(\s*)([A-Za-z0-9_.\"\-]+)(\s*=\s*)(.*)$")
_NUMBER: Final = re.compile(rb"[-+]?\d+\.?\d*(?:e[-+]?\d+)?")
_LETTERS: Final = np.frombuffer(b"abcdefghijklmnopqrstuvwxyz_", np.uint8)


def _place(content: bytes, rng: np.random.Generator) -> int:
    return int(rng.integers(len(content) + 1))


def _token(rng: np.random.Generator) -> bytes:
    return TOKENS[int(rng.integers(len(TOKENS)))]


def flip(content: bytes, rng: np.random.Generator) -> bytes:
    """A few bytes changed."""
    changed = bytearray(content)
    for _ in range(int(rng.integers(1, 5)) if content else 0):
        changed[int(rng.integers(len(changed)))] ^= int(rng.integers(1, 256))
    return bytes(changed)


def cut(content: bytes, rng: np.random.Generator) -> bytes:
    """A piece cut out, often the end."""
    first = _place(content, rng)
    last = len(content) if rng.random() < 0.5 else first + int(rng.integers(64))
    return content[:first] + content[last:]


def insert(content: bytes, rng: np.random.Generator) -> bytes:
    """A token put somewhere."""
    at = _place(content, rng)
    return content[:at] + _token(rng) + content[at:]


def repeat(content: bytes, rng: np.random.Generator) -> bytes:
    """A piece copied to another place."""
    first, at = _place(content, rng), _place(content, rng)
    return content[:at] + content[first : first + int(rng.integers(200))] + content[at:]


def lines_moved(content: bytes, rng: np.random.Generator) -> bytes:
    """A line dropped, doubled, or moved elsewhere."""
    lines = content.split(b"\n")
    line = lines.pop(int(rng.integers(len(lines))))
    for _ in range(int(rng.integers(3))):
        lines.insert(int(rng.integers(len(lines) + 1)), line)
    return b"\n".join(lines)


def cell(content: bytes, rng: np.random.Generator) -> bytes:
    """One cell of a table replaced by a token, or by another cell of the file."""
    lines = content.split(b"\n")
    row = int(rng.integers(len(lines)))
    cells = lines[row].split(b",")
    other = lines[int(rng.integers(len(lines)))].split(b",")
    donor = other[int(rng.integers(len(other)))]
    cells[int(rng.integers(len(cells)))] = _token(rng) if rng.random() < 0.7 else donor
    lines[row] = b",".join(cells)
    return b"\n".join(lines)


def column(content: bytes, rng: np.random.Generator) -> bytes:
    """A column dropped, doubled, exchanged with another, of other sign or size, or constant."""
    rows = [line.split(b",") for line in content.split(b"\n")]
    width = len(max(rows, key=len))
    a, b, how = int(rng.integers(width)), int(rng.integers(width)), int(rng.integers(6))
    token = _token(rng)
    for row in rows:
        if max(a, b) >= len(row):
            continue
        if how == 0:
            del row[a]
        elif how == 1:
            row.insert(b, row[a])
        elif how == 2:
            row[a], row[b] = row[b], row[a]
        elif row is not rows[0]:
            row[a] = (token, row[a].lstrip(b"-") + b"e1", b"-" + row[a].lstrip(b"-"))[how - 3]
    return b"\n".join(b",".join(row) for row in rows)


def value(content: bytes, rng: np.random.Generator) -> bytes:
    """The value of a key replaced by a token, or by another key's value."""
    lines = content.split(b"\n")
    keyed = [i for i, line in enumerate(lines) if _KEY.match(line)]
    if not keyed:
        return insert(content, rng)
    row, donor = (_KEY.match(lines[int(rng.choice(keyed))]) for _ in range(2))
    assert row is not None
    assert donor is not None
    new = _token(rng) if rng.random() < 0.7 else donor[4]
    return content.replace(row[0], row[1] + row[2] + row[3] + new, 1)


def key(content: bytes, rng: np.random.Generator) -> bytes:
    """A word of the file misspelt: keys, names of tables, names of parameters."""
    words = list(re.finditer(rb"[A-Za-z_][A-Za-z0-9_]{2,}", content))
    if not words:
        return insert(content, rng)
    word = words[int(rng.integers(len(words)))]
    at = int(rng.integers(word.start(), word.end()))
    letter = bytes([int(rng.choice(_LETTERS))])
    return content[:at] + letter + content[at + int(rng.integers(2)) :]


def number(content: bytes, rng: np.random.Generator) -> bytes:
    """One number of the file made zero, negative, huge, tiny, or not a number."""
    numbers = list(_NUMBER.finditer(content))
    if not numbers:
        return insert(content, rng)
    at = numbers[int(rng.integers(len(numbers)))]
    digit, new = int(rng.integers(len(at[0]))), b"%d" % rng.integers(10)
    other = at[0][:digit] + new + at[0][digit + 1 :]
    choices = (b"0", b"-" + at[0], at[0] + b"e300", at[0] + b"e-300", b"nan", b"1e15", other, other)
    return content[: at.start()] + choices[int(rng.integers(len(choices)))] + content[at.end() :]


BYTES: Final[tuple[Mutation, ...]] = (flip, cut, insert, repeat)
OF: Final[dict[str, tuple[Mutation, ...]]] = {
    ".csv": (*BYTES, lines_moved, cell, cell, column, number),
    ".toml": (*BYTES, lines_moved, value, value, key, number),
    ".json": (*BYTES, key, number),
    ".nc": BYTES,
    ".npz": BYTES,
    ".parquet": BYTES,
    ".h5": BYTES,
    ".mat": BYTES,
}
"""What is done to a file of each kind."""
NUMBERS: Final[tuple[Mutation, ...]] = (number, number, number, column, lines_moved)
"""What leaves a table readable, so that what looks at its numbers has something to look at."""


def mutated(content: bytes, choices: tuple[Mutation, ...], rng: np.random.Generator) -> bytes:
    """One to three mutations, most often one."""
    for _ in range(int(rng.choice([1, 1, 1, 2, 3]))):
        content = choices[int(rng.integers(len(choices)))](content, rng)
    return content
