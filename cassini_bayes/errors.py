"""Errors that a user can act on: where, what was expected, what was found, how to mend it."""

from __future__ import annotations


class CassiniBayesError(Exception):
    """Base of every error the package raises on purpose; the command line prints it as one line."""

    exit_code: int = 1


class InputError(CassiniBayesError):
    """Something the user gave cannot be used.

    The message reads ``<where>: expected <expected>, got <got>; <fix>``. The command line prints
    it without a traceback and exits with 2.

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
        super().__init__(f"{where}: expected {expected}, got {got}; {fix}")

    def __reduce__(self) -> tuple[type[InputError], tuple[str, str, str, str]]:
        # An exception is rebuilt from its message alone: one raised in a worker process would
        # break the pool instead of reaching the user.
        return type(self), (self.where, self.expected, self.got, self.fix)
