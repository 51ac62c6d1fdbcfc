"""Properties worked out once: kept with the object, and by several threads at the same time."""

from __future__ import annotations

import functools
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from threading import Barrier, BrokenBarrierError

import pytest

from cassini_bayes.computing.cached import cached_property

WAIT_S = 20.0  # for one that comes
NOBODY_S = 0.3  # for one that is held up


@dataclass(frozen=True)
class Squared:
    """A number whose square is worked out once, while another thread works out one, too."""

    number: int
    together: Barrier

    @cached_property
    def square(self) -> int:
        """What threads work out together."""
        self.together.wait(WAIT_S)
        return self.number**2


class Locked(Squared):
    """The same with the standard library's."""

    @functools.cached_property  # noqa: TID251 (what is warned of)
    def square(self) -> int:  # type: ignore[override]
        """What only one thread works out at a time, in Python 3.11."""
        self.together.wait(NOBODY_S)
        return self.number**2


def test_a_value_is_worked_out_once_and_kept_with_its_object() -> None:
    """Asked again it is what it was; a copy with another number has its own; a class has itself."""
    three = Squared(3, Barrier(1))
    assert three.square == 9
    three.together.abort()  # whoever worked it out again would fail
    assert three.square == 9
    assert replace(three, number=4, together=Barrier(1)).square == 16
    assert Squared.square is vars(Squared)["square"]


def test_threads_do_not_wait_for_each_other() -> None:
    """Two that each wait for the other while they work both come to an end."""
    both = Barrier(2)
    with ThreadPoolExecutor(2) as threads:
        values = threads.map(lambda own: own.square, [Squared(3, both), Squared(4, both)])
        assert list(values) == [9, 16]


@pytest.mark.skipif(sys.version_info >= (3, 12), reason="it has no lock any more")
def test_the_standard_librarys_makes_them_wait() -> None:
    """Control: behind the lock of Python 3.11 only one of the two begins."""
    both = Barrier(2)
    with ThreadPoolExecutor(2) as threads:
        values = threads.map(lambda own: own.square, [Locked(3, both), Locked(4, both)])
        with pytest.raises(BrokenBarrierError):
            list(values)
