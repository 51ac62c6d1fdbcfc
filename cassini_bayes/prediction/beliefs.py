"""The priors of prediction (``prediction.toml``): one table per parameter, with unit and source."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from cassini_bayes.errors import InputError
from cassini_bayes.files.checks import finite_number, nearest
from cassini_bayes.files.toml_file import read_toml
from cassini_bayes.priors.distributions import Distribution
from cassini_bayes.spacecraft.description import CONTROL_CYCLE_S

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
OF_CYCLES: Final[Mapping[str, int]] = {
    "minor_constant_s": 1,
    "minor_per_duration": 1,
    "minor_quantum_s": 1,
    "pulses_per_second": -1,
}
"""What the package believes of whole pulses: by which power of the control cycle it goes."""
_WORDS: Final = ("dist", "low", "high", "unit", "source")


@dataclass(frozen=True)
class Beliefs:
    """Prior of every parameter of :data:`UNITS`; those of :data:`NORMAL_ONLY` are normal."""

    distributions: Mapping[str, Distribution]

    def moments(self, name: str) -> tuple[float, float]:
        """Mean and standard deviation."""
        distribution = self.distributions[name]
        return distribution.mean(), distribution.sd()


def read_beliefs(path: Path | None = None, cycle_s: float = CONTROL_CYCLE_S) -> Beliefs:
    """Read the priors of prediction: those of the package, but for the tables that a file has.

    Parameters
    ----------
    path
        Tables that take the place of the package's.
    cycle_s
        The spacecraft's control cycle. What the package believes of whole pulses goes with it
        (:data:`OF_CYCLES`); what a file has is taken as it is.

    Raises
    ------
    InputError
        Names file, key, what was expected and the fix.
    """
    shipped = Path(__file__).with_name("prediction.toml")
    result = {
        name: _distribution(f"{shipped}: {name}", name, _at_cycle(name, table, cycle_s))
        for name, table in read_toml(shipped, "the priors of prediction").items()
    }
    given = {} if path is None else read_toml(path, "the priors of prediction")
    for name, table in given.items():
        if name not in UNITS:
            raise InputError(str(path), "a parameter of prediction", name, nearest(name, UNITS))
        result[name] = _distribution(f"{path}: {name}", name, table)
    return Beliefs(result)


def _at_cycle(name: str, table: Mapping[str, Any], cycle_s: float) -> dict[str, Any]:
    """A table of the package with its location and scale at another control cycle."""
    factor = (cycle_s / CONTROL_CYCLE_S) ** OF_CYCLES.get(name, 0)
    return {k: factor * v if k in ("loc", "scale") else v for k, v in table.items()}


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
