"""Figures that the papers print outside their tables (``constants.toml``)."""

from __future__ import annotations

import datetime
from collections.abc import Mapping
from dataclasses import dataclass
from decimal import Decimal
from types import MappingProxyType
from typing import TypeVar

from cassini_bayes.errors import InputError
from cassini_bayes.files.toml_file import toml_of
from cassini_bayes.published.printed import Printed, package_text, parse_printed

Entry = Printed | tuple[Printed, ...] | datetime.date
Kind = TypeVar("Kind", Printed, tuple[Printed, ...], datetime.date)


@dataclass(frozen=True)
class Constants:
    """Printed constants by section and key; the unit is the end of the key."""

    entries: Mapping[tuple[str, str], Entry]

    def _entry(self, section: str, key: str, kind: type[Kind], what: str) -> Kind:
        """An entry of a kind; InputError when it is missing or something else."""
        result = self.entries.get((section, key))
        if result is None:
            names = ", ".join(k for s, k in self.entries if s == section) or "no such section"
            raise InputError(f"constants.toml: {section}", names, key, "use one of these names")
        if not isinstance(result, kind):
            where = f"constants.toml: {section}.{key}"
            raise InputError(where, what, repr(result), "use the right getter")
        return result

    def number(self, section: str, key: str) -> Printed:
        """Return one printed figure; InputError when the entry is missing or something else."""
        return self._entry(section, key, Printed, "a number")

    def value(self, section: str, key: str) -> float:
        """Return one printed figure as a float."""
        return self.number(section, key).value

    def vector(self, section: str, key: str) -> tuple[Printed, ...]:
        """Return printed figures by body axis; InputError when the entry is missing or no list."""
        return self._entry(section, key, tuple, "a list")

    def date(self, section: str, key: str) -> datetime.date:
        """Return one printed date; InputError when the entry is missing or no date."""
        return self._entry(section, key, datetime.date, "a date")


def _entry(value: object, where: str) -> Entry:
    if isinstance(value, int | Decimal) and not isinstance(value, bool):
        return parse_printed(str(value), where=where)
    if isinstance(value, list):
        return tuple(parse_printed(str(item), where=where) for item in value)
    if isinstance(value, datetime.date) and not isinstance(value, datetime.datetime):
        return value
    raise InputError(where, "a number, a list of numbers or a date", repr(value), "mend it")


def parse_constants(text: str) -> Constants:
    """Read the TOML text; decimals keep their printed digits."""
    entries: dict[tuple[str, str], Entry] = {}
    for section, table in toml_of(text.encode(), "constants.toml", Decimal).items():
        for key, value in table.items():
            entries[section, key] = _entry(value, f"constants.toml: {section}.{key}")
    return Constants(MappingProxyType(entries))


def published_constants() -> Constants:
    """Return the constants of papers 000, 001, 003 and 004."""
    return parse_constants(package_text("constants.toml"))
