"""Independent pieces of work, each kept in a file of its own as soon as it is done.

A killed process loses the pieces that were under way and no other; the same call goes on with what
is missing.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Protocol, TypeVar

from cassini_bayes.computing.workers import Arguments, Work, Workers
from cassini_bayes.errors import CassiniBayesError

Result = TypeVar("Result")


class Store(Protocol[Result]):
    """A folder that keeps results by name."""

    @property
    def folder(self) -> Path:
        """Where it is."""

    def load(self, name: str) -> Result | None:
        """What was kept under a name; None where nothing, or nothing whole, is there."""

    def save(self, name: str, result: Result) -> None:
        """Keep a result."""


def run_pieces(
    work: Work[Result],
    shared: object,
    pieces: Mapping[str, Arguments],
    store: Store[Result],
    workers: Workers,
) -> Iterator[tuple[int, int]]:
    """Work out the pieces that ``store`` lacks as ``work(shared, *arguments)``, in any order.

    Yields (done, all) at the start and whenever a piece has been stored.
    """
    missing = [name for name in pieces if store.load(name) is None]
    done = len(pieces) - len(missing)
    yield done, len(pieces)
    for place, result in workers.results(work, shared, [pieces[name] for name in missing]):
        store.save(missing[place], result)
        done += 1
        yield done, len(pieces)


def finished(store: Store[Result], name: str) -> Result:
    """A finished piece.

    Raises
    ------
    CassiniBayesError
        It is missing.
    """
    result = store.load(name)
    if result is None:
        raise CassiniBayesError(f"{store.folder}: {name} is missing: start the command again")
    return result
