"""The priors of prediction (``prediction.toml``): one table per parameter, with unit and source."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from cassini_bayes.errors import InputError
from cassini_bayes.files.checks import finite_number, nearest
from cassini_bayes.files.toml_file import read_toml
from cassini_bayes.priors.distributions import Distribution

FIRING: Final[Mapping[str, str]] = {
    "minor_constant_s": "s",
    "minor_per_duration": "1",
    "minor_per_demand": "1",
    "minor_quantum_s": "s",
    "event_spread": "1",
    "shared_per_demand": "1/s",
    "shared_shape": "1",
}
"""Units of the parameters of the firing model, which are walked."""
NORMAL_ONLY: Final[Mapping[str, str]] = {
    "pulses_per_second": "1/s",
    "specific_impulse_s": "s",
    "specific_impulse_group_s": "s",
    "hydrazine_offset_g": "g",
    "wheel_loop_s": "s",
    "wheel_ramp_s_per_rpm": "s/rpm",
}
"""Units of the parameters that are integrated out."""
UNITS: Final[Mapping[str, str]] = {**FIRING, **NORMAL_ONLY}
_WORDS: Final = ("dist", "low", "high", "unit", "source")


@dataclass(frozen=True)
class Beliefs:
    """Prior of every parameter of :data:`UNITS`; those of :data:`NORMAL_ONLY` are normal."""

    distributions: Mapping[str, Distribution]

    def moments(self, name: str) -> tuple[float, float]:
        """Mean and standard deviation."""
        distribution = self.distributions[name]
        return distribution.mean(), distribution.sd()


def read_beliefs(path: Path | None = None) -> Beliefs:
    """Read the priors of prediction; without a path, those that come with the package.

    Raises
    ------
    InputError
        Names file, key, what was expected and the fix.
    """
    path = path or Path(__file__).with_name("prediction.toml")
    tables = read_toml(path, "the priors of prediction")
    for name in tables:
        if name not in UNITS:
            raise InputError(str(path), "a parameter of prediction", name, nearest(name, UNITS))
    missing = [name for name in UNITS if name not in tables]
    if missing:
        raise InputError(str(path), "a table for every parameter", f"no {missing[0]}", "add it")
    return Beliefs({name: _distribution(f"{path}: {name}", name, tables[name]) for name in UNITS})


def _distribution(where: str, name: str, table: object) -> Distribution:
    if not isinstance(table, dict) or not {"dist", "unit", "source"} <= set(table):
        raise InputError(where, "a table with dist, unit and source", repr(table), "complete it")
    if table["unit"] != UNITS[name]:
        raise InputError(where, f"unit {UNITS[name]!r}", repr(table["unit"]), "convert the values")
    keywords = {key: value for key, value in table.items() if key not in _WORDS}
    low, high = (
        finite_number(f"{where}.{key}", table[key]) if key in table else None
        for key in ("low", "high")
    )
    result = Distribution(str(table["dist"]), keywords, low, high, where=where)
    if name in NORMAL_ONLY and not result.is_normal:
        raise InputError(where, "norm without bounds", result.name, "it is integrated out exactly")
    if name not in NORMAL_ONLY and result.support[0] < 0:
        raise InputError(where, "a distribution of positive values", repr(result), "add low = 0.0")
    return result
