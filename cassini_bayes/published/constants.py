"""Figures that the papers print outside their tables (``constants.toml``)."""

from __future__ import annotations

import datetime
from collections.abc import Mapping
from dataclasses import dataclass
from decimal import Decimal
from types import MappingProxyType

from cassini_bayes.errors import InputError
from cassini_bayes.files.toml_file import toml_of
from cassini_bayes.published.printed import Printed, package_text, parse_printed

Entry = Printed | tuple[Printed, ...] | datetime.date


@dataclass(frozen=True)
class Constants:
    """Printed constants by section and key; the unit is the end of the key."""

    entries: Mapping[tuple[str, str], Entry]

    def _entry(self, section: str, key: str) -> Entry:
        result = self.entries.get((section, key))
        if result is None:
            names = ", ".join(k for s, k in self.entries if s == section) or "no such section"
            raise InputError(f"constants.toml: {section}", names, key, "use one of these names")
        return result

    def number(self, section: str, key: str) -> Printed:
        """Return one printed figure; InputError when the entry is missing or something else."""
        result = self._entry(section, key)
        if not isinstance(result, Printed):
            raise InputError(
                f"constants.toml: {section}.{key}", "a number", repr(result), "use the right getter"
            )
        return result

    def value(self, section: str, key: str) -> float:
        """Return one printed figure as a float."""
        return self.number(section, key).value

    def vector(self, section: str, key: str) -> tuple[Printed, ...]:
        """Return printed figures by body axis; InputError when the entry is missing or no list."""
        result = self._entry(section, key)
        if not isinstance(result, tuple):
            raise InputError(
                f"constants.toml: {section}.{key}", "a list", repr(result), "use the right getter"
            )
        return result

    def date(self, section: str, key: str) -> datetime.date:
        """Return one printed date; InputError when the entry is missing or no date."""
        result = self._entry(section, key)
        if not isinstance(result, datetime.date):
            raise InputError(
                f"constants.toml: {section}.{key}", "a date", repr(result), "use the right getter"
            )
        return result


def _entry(value: object, where: str) -> Entry:
    if isinstance(value, bool):
        raise InputError(where, "a number, a list of numbers or a date", repr(value), "mend it")
    if isinstance(value, int | Decimal):
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
