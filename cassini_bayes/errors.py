"""Errors that a user can act on: where, what was expected, what was found, how to mend it."""

from __future__ import annotations

from typing import Final

LONGEST_PART: Final = 400  # characters: what a terminal still shows at a glance


class CassiniBayesError(Exception):
    """Base of every error the package raises on purpose; the command line prints it as one line."""

    exit_code: int = 1


class InputError(CassiniBayesError):
    """Something the user gave cannot be used.

    The message reads ``<where>: expected <expected>, got <got>; <fix>`` and is one line whatever a
    file holds: each part is cut to :data:`LONGEST_PART` characters, control characters are escaped.
    The command line prints it without a traceback and exits with 2.

    Parameters
    ----------
    where
        File, row, column or dotted key, e.g. ``priors/x.toml: parameters.cm_x_m.unit``.
    expected, got
        What would have been accepted, and what was found.
    fix
        What the user can change.
    """

    exit_code = 2

    def __init__(self, where: str, expected: str, got: str, fix: str) -> None:
        self.where = where
        self.expected = expected
        self.got = got
        self.fix = fix
        where, expected, got, fix = map(_one_line, (where, expected, got, fix))
        super().__init__(f"{where}: expected {expected}, got {got}; {fix}")

    def __reduce__(self) -> tuple[type[InputError], tuple[str, str, str, str]]:
        # An exception is rebuilt from its message alone: one raised in a worker process would
        # break the pool instead of reaching the user.
        return type(self), (self.where, self.expected, self.got, self.fix)


def _one_line(part: str) -> str:
    short = part if len(part) <= LONGEST_PART else f"{part[:LONGEST_PART]}…"
    return short if short.isprintable() else "".join(map(_printable, short))


def _printable(character: str) -> str:
    return character if character.isprintable() else ascii(character)[1:-1]
