"""A property worked out once per object, by threads that do not wait for each other.

Python 3.11's own holds one lock for all objects of a class while it works: likelihoods of parts of
a batch, on two threads, took as long as on one. From Python 3.12 on it has none.
"""

from __future__ import annotations

import functools
from typing import Any, TypeVar, overload

Value = TypeVar("Value")


class cached_property(functools.cached_property[Value]):  # noqa: N801, TID251 (Python's own)
    """Like :class:`functools.cached_property`; threads that ask at once may each work it out."""

    @overload
    def __get__(self, instance: None, owner: type[Any] | None = None) -> cached_property[Value]: ...

    @overload
    def __get__(self, instance: object, owner: type[Any] | None = None) -> Value: ...

    def __get__(
        self, instance: object | None, owner: type[Any] | None = None
    ) -> cached_property[Value] | Value:
        """The value, kept among the object's attributes; the property itself of a class."""
        if instance is None:
            return self
        assert self.attrname is not None  # given with the class
        known = vars(instance)
        if self.attrname not in known:
            known[self.attrname] = self.func(instance)
        value: Value = known[self.attrname]
        return value
