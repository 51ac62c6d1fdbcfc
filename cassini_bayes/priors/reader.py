"""A priors file as one frozen object, and the parameter space a model walks in.

The file (TOML, docs/reference/priors-format.md) states everything believed before the data: one
table per parameter, with distribution or fixed value, unit and source. :func:`read_priors` checks
all of it at the door. A model names the parameters it needs (:meth:`Priors.require`) and gets an
ordered :class:`ParameterSpace`, in which every parameter occurs once, so a prior shared by many
events counts once.
"""

from __future__ import annotations

import hashlib
import math
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Final

from scipy.special import ndtr

from cassini_bayes.errors import InputError
from cassini_bayes.files.checks import check_known, closest, finite_number, nearest
from cassini_bayes.files.reading import exists
from cassini_bayes.files.toml_file import read_toml, toml_bytes, toml_of
from cassini_bayes.priors.chaining import EarlierFit, read_earlier
from cassini_bayes.priors.distributions import Distribution, check_bounds, check_keywords
from cassini_bayes.priors.parameter_space import ParameterSpace
from cassini_bayes.spacecraft import Spacecraft, load_spacecraft
from cassini_bayes.spacecraft.parameters import (
    CLOSE_SHARE,
    LATE_FACTOR,
    OPEN_FACTOR,
    PAIR_FACTOR,
    ParameterSpec,
    generic_parameters,
)
from cassini_bayes.spacecraft.reader import check_either

ZERO_CENTRED: Final = (
    "thrust_individual_n",
    "thrust_event_n",
    "thrust_jitter_n",
    "thrust_drift_n_per_year",
    "thrust_ageing_n_per_year",
)
_OF_ALL_BRANCHES: Final = (
    "thrust_intercept_share",
    "thrust_loss_share",
    "failing_probability",
    "hydrazine_used_factor",
)
_TABLES: Final = ("spacecraft", "parameters", "from_fit", "branch")
_LEVELS: Final = ("thrust_common_n", "thrust_individual_n")  # what an earlier fit's levels replace
_PRIOR_KEYS: Final = ("dist", "low", "high", "fixed", "unit", "source")
_NEVER_NEGATIVE_BLOCKS: Final = ("tail-off", "wheel inertia", "mass", "noise")
_BUT_SIGNED: Final = (
    *(f"rate_bias_{axis}_rad_s" for axis in "xyz"),
    *("accelerometer_bias_m_s2", "tail_pressure_exponent", "tail_ageing_per_year"),
)
_NEVER_NEGATIVE: Final = ("inertia_xx_kg_m2", "inertia_yy_kg_m2", "inertia_zz_kg_m2")
# More prior probability of a negative value than this means that a bound was forgotten.
_NEGATIVE_MASS: Final = 1e-3
_PUSHING: Final = ("thrust_common_n",)
"""Above zero, but with a wide normal prior that is summed over exactly as it is: half will do."""


TELEMETRY_NOISE: Final = "torque_noise_n_m_s05"
"""What priors of telemetry have and those of totals have not."""
# Whether controllers fire before readings, or after them, is not known (the second is 1.0 to 1.3 in
# simulations whose readings are at control cycles), nor how much their widths scatter (the third).
OF_CONTROLLERS: Final = {
    CLOSE_SHARE: Distribution("uniform", {"loc": 0.0, "scale": 1.0}, low=0.0, high=1.0),
    PAIR_FACTOR: Distribution("lognorm", {"s": 0.8, "scale": 0.5}),
    LATE_FACTOR: Distribution("lognorm", {"s": 0.5, "scale": 1.1}),
    OPEN_FACTOR: Distribution("lognorm", {"s": 0.5, "scale": 1.0}),
}
"""What controllers do and counters show: built in where a priors file lacks it; no truth has it."""


@dataclass(frozen=True)
class ParameterPrior:
    """What is believed of one parameter: a distribution or a fixed value, and why."""

    spec: ParameterSpec
    distribution: Distribution | None
    fixed: float | None
    source: str

    def __post_init__(self) -> None:
        if (self.distribution is None) == (self.fixed is None):
            raise ValueError(f"{self.spec.name}: give a distribution or a fixed value, not both")

    @property
    def mean(self) -> float:
        """The distribution's mean, or the fixed value."""
        if self.distribution is None:
            assert self.fixed is not None  # one of the two, as checked
            return self.fixed
        return float(self.distribution.mean())

    @property
    def median(self) -> float:
        """The distribution's median, or the fixed value."""
        own = self.distribution
        return self.mean if own is None else float(own.quantile_of_standard(0.0))

    @property
    def sd(self) -> float:
        """The distribution's standard deviation; 0 of a fixed value."""
        return 0.0 if self.distribution is None else float(self.distribution.sd())


@dataclass(frozen=True)
class Priors:
    """The content of a priors file.

    ``path`` is the file as the user named it, ``digest`` the SHA-256 of its bytes; both stay those
    of the file when :meth:`with_distribution` makes a variant of it. ``earlier`` are the moments of
    an earlier fit that stand in for the priors of what it walked (``from_fit``). ``parameters`` are
    those of the thruster branch ``branch``; ``of_branches`` are what differs between branches
    (``[branch.A.parameters.…]``), for every branch all that it has of them.
    """

    spacecraft: Spacecraft
    branch: str
    wheels: tuple[int, ...]
    parameters: Mapping[str, ParameterPrior]
    path: str
    digest: str
    earlier: EarlierFit | None = None
    of_branches: Mapping[str, Mapping[str, ParameterPrior]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "parameters", MappingProxyType(dict(self.parameters)))

    def __reduce__(self) -> tuple[object, ...]:
        # A read-only mapping cannot be sent to a worker process; the arguments can.
        arguments = (self.spacecraft, self.branch, self.wheels, dict(self.parameters))
        return Priors, (*arguments, self.path, self.digest, self.earlier, self.of_branches)

    def for_branch(self, branch: str) -> Priors:
        """The priors of one thruster branch: its own ones, and those that hold for all."""
        if branch == self.branch:
            return self
        before, after = (self.of_branches.get(name, {}) for name in (self.branch, branch))
        kept = {n: p for n, p in self.parameters.items() if n in after or n not in before}
        return replace(self, branch=branch, parameters={**kept, **after})

    def require(self, names: Iterable[str], why: str) -> None:
        """Check that the file has every parameter in ``names``.

        Raises
        ------
        InputError
            Names the file, the dotted key, who needs it (``why``) and what to add: the first in
            full, and all others that are missing with their units.
        """
        specs = known_parameters(self.spacecraft)
        missing = [name for name in names if name not in self.parameters]
        for name in missing:
            where = f"{self.path}: parameters.{name}"
            expected = f"a parameter of {self.spacecraft.name}, asked for by {why}"
            check_known(where, name, specs, expected, f"the unknown name {name!r}")
        if missing:
            name, *others = missing
            spec = specs[name]
            more = ", ".join(f"{other} ({specs[other].unit})" for other in others)
            raise InputError(
                f"{self.path}: parameters.{name}",
                f"a prior in {spec.unit} ({spec.meaning}), needed by {why}",
                "no such table",
                f"add [parameters.{name}] with dist or fixed, unit and source"
                f" (nearest in the file: {closest(name, self.parameters, 0.0)})"
                + (f"; missing as well: {more}" if more else ""),
            )

    def means(self) -> dict[str, float]:
        """Prior mean of every parameter, or its fixed value."""
        return {name: prior.mean for name, prior in self.parameters.items()}

    def medians(self, names: Iterable[str]) -> dict[str, float]:
        """Prior medians of these parameters, or their fixed values."""
        return {name: self.parameters[name].median for name in names}

    def normal(self, names: Iterable[str]) -> tuple[list[float], list[float]]:
        """Means and standard deviations of parameters that are integrated out.

        Raises
        ------
        InputError
            One is missing, or neither normal nor fixed.
        """
        chosen = tuple(names)
        self.require(chosen, "the model")
        for name in chosen:
            distribution = self.parameters[name].distribution
            if distribution is not None and not distribution.is_normal:
                raise InputError(
                    f"{self.path}: parameters.{name}.dist",
                    "norm without bounds, or fixed (the parameter is integrated out exactly)",
                    f"{distribution.name} (or bounds)",
                    "use a normal prior; its width can be as large as you believe",
                )
        priors = [self.parameters[name] for name in chosen]
        return [prior.mean for prior in priors], [prior.sd for prior in priors]

    def space(self, names: Iterable[str]) -> ParameterSpace:
        """The ordered parameter space of ``names``: free ones are walked, fixed ones carried.

        Raises
        ------
        InputError
            When the file lacks one of them.
        """
        ordered = tuple(dict.fromkeys(names))
        self.require(ordered, "the parameter space")
        chosen = [self.parameters[name] for name in ordered]
        free = [(p.spec, p.distribution) for p in chosen if p.distribution is not None]
        walked = [spec.name for spec, _ in free]
        return ParameterSpace(
            names=tuple(walked),
            fixed={p.spec.name: p.fixed for p in chosen if p.fixed is not None},
            distributions=tuple(distribution for _, distribution in free),
            blocks=tuple(spec.block for spec, _ in free),
            joint=None if self.earlier is None else self.earlier.joint(walked),
        )

    def with_distribution(self, name: str, distribution: Distribution) -> Priors:
        """New priors in which ``name`` has this distribution; everything else stays."""
        return self._with(name, distribution, None)

    def with_fixed(self, name: str, value: float) -> Priors:
        """New priors in which ``name`` is fixed at ``value``; everything else stays."""
        return self._with(name, None, finite_number(f"{self.path}: parameters.{name}", value))

    def scaled(self, names: Iterable[str], width: float = 1.0, shift: float = 0.0) -> Priors:
        """New priors with the free ones of ``names`` widened and shifted.

        See :meth:`Distribution.scaled`; fixed parameters stay as they are. A prior that allows no
        negative values of a parameter that has none allows none afterwards.
        """
        changed = self
        for name in names:
            self.require([name], "a scaled prior")
            prior = self.parameters[name]
            if prior.distribution is not None:
                scaled = prior.distribution.scaled(width, shift)
                if _never_negative(prior.spec) and prior.distribution.support[0] >= 0.0:
                    scaled = _without_negative(scaled)
                changed = changed.with_distribution(name, scaled)
        return changed

    def _with(self, name: str, distribution: Distribution | None, fixed: float | None) -> Priors:
        self.require([name], "a changed prior")
        if self.earlier is not None and name in (*self.earlier.names, *_LEVELS):
            raise InputError(
                f"{self.path}: parameters.{name}",
                "a prior of its own",
                f"the posterior of {self.earlier.path}",
                "change it there, or leave from_fit out",
            )
        changed = replace(self.parameters[name], distribution=distribution, fixed=fixed)
        return replace(self, parameters={**self.parameters, name: changed})


def known_parameters(spacecraft: Spacecraft) -> dict[str, ParameterSpec]:
    """Every parameter a priors file of this spacecraft may name: generic ones and its own."""
    return {spec.name: spec for spec in (*generic_parameters(), *spacecraft.parameters)}


def read_priors(path: str | Path) -> Priors:
    """Read and check a priors file.

    Parameters
    ----------
    path
        The TOML file; a relative ``spacecraft.file`` in it is looked up beside it.

    Raises
    ------
    InputError
        Names the file, the dotted key, what was expected, what was found and the nearest valid
        name: see docs/reference/priors-format.md for everything that is refused.
    """
    content = toml_bytes(Path(path), "a priors file")
    document = toml_of(content, str(path))
    expected = "the tables spacecraft, parameters and branch, or from_fit"
    for key in document:
        check_known(f"{path}: {key}", key, _TABLES, expected, f"the unknown key {key!r}")
    table_of_file = _table(f"{path}: spacecraft", document.get("spacecraft"))
    spacecraft = _read_spacecraft(Path(path), table_of_file)
    parameters = _read_parameters(f"{path}: parameters", document.get("parameters"), spacecraft)
    if TELEMETRY_NOISE in parameters:
        for name in sorted({*OF_CONTROLLERS} - {*parameters}):
            spec, prior = known_parameters(spacecraft)[name], OF_CONTROLLERS[name]
            source = "not in the file: any that controllers were seen to have"
            parameters[name] = ParameterPrior(spec, prior, None, source)
    branch = _read_branch(f"{path}: spacecraft.branch", table_of_file.get("branch"), spacecraft)
    tables = _read_branches(str(path), document.get("branch", {}), spacecraft)
    differing = dict.fromkeys(name for table in tables.values() for name in table)
    shared = {name: parameters[name] for name in differing if name in parameters}
    of_branches = {name: {**shared, **tables.get(name, {})} for name in spacecraft.branches}
    parameters |= of_branches[branch]
    wheels = _read_wheels(f"{path}: spacecraft.wheels", table_of_file.get("wheels"), spacecraft)
    turned = spacecraft.with_platforms(parameters)
    turned.check_platforms(wheels, f"{path}: parameters")
    priors = Priors(
        spacecraft=turned,
        branch=branch,
        wheels=wheels,
        parameters=parameters,
        path=str(path),
        digest=hashlib.sha256(content).hexdigest(),
        of_branches=of_branches,
    )
    return _chained(priors, document["from_fit"]) if "from_fit" in document else priors


def spacecraft_file_of(name: str, path: Path) -> tuple[str, Path] | None:
    """The spacecraft file that the priors at ``path`` name, if they name one that is there.

    Its name, as of one who calls the priors ``name``, and its place.
    """
    table = read_toml(path, "a priors file").get("spacecraft")
    file = table.get("file") if isinstance(table, dict) else None
    if not isinstance(file, str) or not exists(place := path.parent / file):
        return None
    return os.path.normpath(Path(name).parent / file), place


def _read_parameters(
    where: str, value: object, spacecraft: Spacecraft
) -> dict[str, ParameterPrior]:
    """The priors of one table, by name."""
    specs = known_parameters(spacecraft)
    parameters = {}
    for name, entry in _table(where, value).items():
        key = f"{where}.{name}"
        expected = f"a parameter of {spacecraft.name}"
        check_known(key, name, specs, expected, f"the name {name!r}")
        parameters[name] = _read_parameter(key, specs[name], _table(key, entry))
    return parameters


def _read_branches(
    path: str, value: object, spacecraft: Spacecraft
) -> dict[str, dict[str, ParameterPrior]]:
    """Priors of single branches: the tables ``branch.<name>.parameters``."""
    result = {}
    for name, table in _table(f"{path}: branch", value).items():
        where = f"{path}: branch.{name}"
        spacecraft.check_branch(where, name)
        entries = _table(where, table)
        for key in entries:
            check_known(f"{where}.{key}", key, ["parameters"], "the table parameters")
        place = f"{where}.parameters"
        result[name] = _read_parameters(place, entries.get("parameters"), spacecraft)
        for shared in _OF_ALL_BRANCHES:
            if shared in result[name]:
                raise InputError(
                    f"{place}.{shared}",
                    "a parameter that a branch may have for itself",
                    f"{shared}, one of all branches of a mission",
                    f"write it as [parameters.{shared}]",
                )
    return result


def _chained(priors: Priors, value: object) -> Priors:
    """The priors with the moments of the earlier fit that ``from_fit`` names."""
    where = f"{priors.path}: from_fit"
    file = _text(where, value, "the path of a fit.nc", 'write e.g. from_fit = "../runs/x/fit.nc"')
    craft = priors.spacecraft
    earlier = read_earlier(
        Path(priors.path).parent / file,
        where,
        {n: p.distribution for n, p in priors.parameters.items() if p.distribution is not None},
        craft,
        [thruster.name for thruster in craft.thrusters_of(priors.branch)],
    )
    return replace(priors, earlier=earlier)


def _table(where: str, value: object) -> Mapping[str, object]:
    if not isinstance(value, dict):
        got = "nothing" if value is None else repr(value)
        key = where.rpartition(": ")[2]
        raise InputError(where, f"a table [{key}]", got, f"write it as a table headed [{key}]")
    return value


def _text(where: str, value: object, wanted: str, fix: str) -> str:
    if not isinstance(value, str) or not value.strip():
        raise InputError(where, wanted, "nothing" if value is None else repr(value), fix)
    return value


def _read_spacecraft(path: Path, table: Mapping[str, object]) -> Spacecraft:
    where = f"{path}: spacecraft"
    known = ("name", "file", "branch", "wheels")
    for key in table:
        check_known(f"{where}.{key}", key, known)
    check_either(where, "name" in table, "file" in table)
    if "name" in table:
        name = _text(f"{where}.name", table["name"], "the name of a built-in", 'e.g. "cassini"')
        if Path(name).suffix or Path(name).name != name:
            fix = "use file = … for a file"
            raise InputError(f"{where}.name", "the name of a built-in", repr(name), fix)
        return load_spacecraft(name, f"{where}.name")
    file = _text(f"{where}.file", table["file"], "a path", "name the spacecraft's TOML file")
    return load_spacecraft(path.parent / file)


def _read_branch(where: str, value: object, spacecraft: Spacecraft) -> str:
    branch = _text(where, value, f"one of {', '.join(spacecraft.branches)}", "name the branch")
    spacecraft.check_branch(where, branch)
    return branch


def _read_wheels(where: str, value: object, spacecraft: Spacecraft) -> tuple[int, ...]:
    known = spacecraft.wheel_numbers
    wanted = f"a list of different wheels out of {known}"
    fix = f"write e.g. wheels = {known[:3]}"
    if not isinstance(value, list) or not value:
        raise InputError(where, wanted, "nothing" if value is None else repr(value), fix)
    for i, number in enumerate(value):
        if isinstance(number, bool) or not isinstance(number, int) or number not in known:
            raise InputError(f"{where}[{i + 1}]", wanted, repr(number), fix)
        if number in value[:i]:
            raise InputError(f"{where}[{i + 1}]", wanted, f"{number} twice", "list each wheel once")
    return tuple(value)


def _read_parameter(where: str, spec: ParameterSpec, table: Mapping[str, object]) -> ParameterPrior:
    if ("dist" in table) == ("fixed" in table):
        raise InputError(
            where,
            "either dist (a distribution) or fixed (a value)",
            "both" if "dist" in table else "neither",
            "keep one of them" if "dist" in table else "add one of them",
        )
    _check_unit(f"{where}.unit", spec, table.get("unit"))
    wanted = "where the belief comes from"
    source = _text(f"{where}.source", table.get("source"), wanted, "add source = …")
    if "fixed" in table:
        return ParameterPrior(spec, None, _read_fixed(where, spec, table), source)
    distribution = _read_distribution(where, spec, table)
    _check_centre(f"{where}.loc", spec, distribution.loc)
    return ParameterPrior(spec, distribution, None, source)


def _check_centre(where: str, spec: ParameterSpec, value: float) -> None:
    if spec.name in ZERO_CENTRED and value != 0.0:
        expected = "0: departures are counted from the common thrust"
        raise InputError(where, expected, repr(value), "move the mean into thrust_common_n")


def _check_unit(where: str, spec: ParameterSpec, unit: object) -> None:
    if not isinstance(unit, str) or _plain_unit(unit) != _plain_unit(spec.unit):
        raise InputError(
            where,
            repr(spec.unit),
            "nothing" if unit is None else repr(unit),
            f"{spec.name} is in {spec.unit}: convert the values, then write that unit",
        )


def _plain_unit(unit: str) -> str:
    """One spelling of a unit: kg m², kg·m^2 and kg m2 are the same."""
    for written, plain in (("²", "2"), ("^", ""), ("·", " "), ("*", " "), ("rev/min", "rpm")):
        unit = unit.replace(written, plain)
    return " ".join(unit.split())


def _read_fixed(where: str, spec: ParameterSpec, table: Mapping[str, object]) -> float:
    allowed = ("fixed", "unit", "source")
    for key in table:
        if key not in allowed:
            of_distribution = key in ("low", "high", "loc", "scale")
            hint = "leave it out" if of_distribution else nearest(key, allowed)
            expected = f"one of {', '.join(allowed)} beside fixed"
            raise InputError(f"{where}.{key}", expected, repr(key), hint)
    value = finite_number(f"{where}.fixed", table["fixed"], spec.unit)
    _check_centre(f"{where}.fixed", spec, value)
    least = "a value above 0" if spec.name in _PUSHING else "a value of 0 or more"
    if (_never_negative(spec) and value < 0) or (spec.name in _PUSHING and value <= 0):
        fix = f"{spec.meaning}: check the sign"
        raise InputError(f"{where}.fixed", least, repr(value), fix)
    return value


def _read_distribution(
    where: str, spec: ParameterSpec, table: Mapping[str, object]
) -> Distribution:
    name = _text(f"{where}.dist", table["dist"], "a scipy.stats name", 'write e.g. dist = "norm"')
    own = {key: value for key, value in table.items() if key not in _PRIOR_KEYS}
    keywords = check_keywords(where, name, own, _PRIOR_KEYS)
    low, high = (
        finite_number(f"{where}.{key}", table[key], spec.unit) if key in table else None
        for key in ("low", "high")
    )
    distribution = Distribution(name, keywords, low, high, where=where)
    check_bounds(where, distribution)
    if not (math.isfinite(distribution.mean()) and math.isfinite(distribution.sd())):
        raise InputError(
            f"{where}.dist",
            "a distribution with a mean and a standard deviation",
            f"{name}, whose tails are too heavy for that",
            "bound it by low and high",
        )
    if _never_negative(spec):
        _check_never_negative(where, spec, distribution)
    if spec.name in _PUSHING and (median := float(distribution.quantile_of_standard(0.0))) <= 0.0:
        expected = f"a prior of {spec.name} about a value above 0"
        fix = "give the force of a thruster as a positive number"
        raise InputError(where, expected, f"a median of {median:g} {spec.unit}", fix)
    return distribution


def _never_negative(spec: ParameterSpec) -> bool:
    in_block = spec.block in _NEVER_NEGATIVE_BLOCKS and spec.name not in _BUT_SIGNED
    return in_block or spec.name in _NEVER_NEGATIVE


def _without_negative(distribution: Distribution) -> Distribution:
    return distribution if distribution.support[0] >= 0.0 else replace(distribution, low=0.0)


def _check_never_negative(where: str, spec: ParameterSpec, distribution: Distribution) -> None:
    if distribution.support[0] >= 0:
        return
    negative = float(ndtr(distribution.standard_of(0.0)))
    if negative > _NEGATIVE_MASS:
        raise InputError(
            f"{where}.low",
            f"a prior that keeps {spec.name} from going negative",
            f"{100 * negative:.2g} % of the probability below 0",
            "add low = 0.0",
        )
