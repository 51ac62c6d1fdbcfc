"""Changed priors: what a cell of a sweep changes, and the priors that result."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from cassini_bayes.errors import CassiniBayesError, InputError
from cassini_bayes.files.checks import check_known
from cassini_bayes.priors.distributions import Distribution
from cassini_bayes.priors.reader import ZERO_CENTRED, Priors
from cassini_bayes.spacecraft.parameters import THRUST_COMMON
from cassini_bayes.sweep.models import SweepModel
from cassini_bayes.sweep.specification import GridTable

Kind = Literal["width", "shift", "family", "without"]
STUDENT_DOF: Final = 5.0
_FAMILY_NAMES: Final = {"normal": "norm", "student-t": "t", "uniform": "uniform"}
_FRACTIONS: Final = {0.25: "¼", 0.5: "½", 0.75: "¾"}


@dataclass(frozen=True)
class Group:
    """Parameters whose priors are changed together: a prior block, or what a user named."""

    name: str
    parameters: tuple[str, ...]


@dataclass(frozen=True)
class Variation:
    """One cell: a group of priors widened (``amount`` is the factor), one prior shifted (``amount``
    in prior standard deviations), a group in another family, or an event left out.
    """

    group: str
    kind: Kind
    parameters: tuple[str, ...] = ()
    amount: float = 1.0
    family: str = ""
    event: str = ""

    @property
    def name(self) -> str:
        """Name of the cell in letters, digits, dots, dashes and underscores."""
        what = {
            "width": f"{self.amount:.17g}",
            "shift": f"{'_'.join(self.parameters)}_{self.amount:+.17g}",
            "family": self.family,
            "without": self.event,
        }[self.kind]
        text = f"{self.group}_{self.kind}_{what}".replace("+", "plus")
        return "".join(c if c.isalnum() or c in "._-" else "-" for c in text)

    @property
    def key(self) -> str:
        """Name of the cell's file: with a digest of all that the cell changes."""
        return f"{self.name}_{hashlib.sha256(repr(self).encode()).hexdigest()[:12]}"

    @property
    def label(self) -> str:
        """What the cell changes, for people."""
        if self.kind == "width":
            return f"width × {_FRACTIONS.get(self.amount, f'{self.amount:g}')}"
        if self.kind == "shift":
            sign = "+" if self.amount > 0 else "−"
            return f"{', '.join(self.parameters)} {sign} {abs(self.amount):g} σ"
        return self.family if self.kind == "family" else f"without {self.event}"

    def applied(self, priors: Priors) -> Priors:
        """The priors of the cell.

        Raises
        ------
        InputError
            No prior can be changed so; the message names group and change.
        """
        with self.named_in_errors():
            if self.kind == "width":
                return priors.scaled(self.parameters, width=self.amount)
            if self.kind == "shift":
                return priors.scaled(self.parameters, shift=self.amount)
            if self.kind == "family":
                for name in self.parameters:
                    distribution = priors.parameters[name].distribution
                    if distribution is not None:
                        changed = with_family(distribution, self.family)
                        priors = priors.with_distribution(name, changed)
            return priors

    @contextmanager
    def named_in_errors(self) -> Iterator[None]:
        """What a change is too extreme for is an input error that names group and change."""
        where, fix = f"sweep: {self.group}, {self.label}", "leave this change out of the grid"
        try:
            yield
        except InputError as error:
            raise InputError(
                f"{where}: {error.where}", error.expected, error.got, f"{error.fix}, or {fix}"
            ) from error
        except (CassiniBayesError, np.linalg.LinAlgError) as error:
            raise InputError(
                where,
                "priors under which the model can be computed",
                str(error),
                f"{fix}, or make it milder",
            ) from error


def with_family(distribution: Distribution, family: str) -> Distribution:
    """The same centre, spread and bounds in another family; unchanged if it is of that family.

    The standard deviation before any truncation stays. Bounds are the finite ends of the support,
    whether written as bounds or the family's own (those of a uniform, the edge of a half-normal).
    ``student-t`` has five degrees of freedom. A log-normal changes in the logarithm: its normal is
    itself, its Student-t the log-logistic (a logistic is close to a Student-t of nine degrees of
    freedom), its uniform the log-uniform.
    """
    if distribution.name == _FAMILY_NAMES[family]:
        return distribution
    low, high = distribution.low, distribution.high
    if distribution.name == "lognorm" and distribution.loc == 0.0:
        s, median = distribution.keywords["s"], distribution.scale
        if family == "normal":
            return distribution
        if family == "student-t":
            shape = {"c": math.pi / (math.sqrt(3.0) * s), "scale": median}
            return Distribution("fisk", shape, low, high)
        reach = math.exp(math.sqrt(3.0) * s)
        return Distribution("loguniform", {"a": median / reach, "b": median * reach}, low, high)
    low, high = (end if math.isfinite(end) else None for end in distribution.support)
    whole = Distribution(distribution.name, distribution.keywords)
    mean, sd = whole.mean(), whole.sd()
    if family == "normal":
        return Distribution("norm", {"loc": mean, "scale": sd}, low, high)
    if family == "student-t":
        scale = sd * math.sqrt((STUDENT_DOF - 2.0) / STUDENT_DOF)
        return Distribution("t", {"df": STUDENT_DOF, "loc": mean, "scale": scale}, low, high)
    half = math.sqrt(3.0) * sd
    return Distribution("uniform", {"loc": mean - half, "scale": 2.0 * half}, low, high)


def blocks_of(model: SweepModel, priors: Priors) -> tuple[Group, ...]:
    """The prior blocks that act in a model, each with its free parameters."""
    members: dict[str, list[str]] = {}
    for name in (*model.space.names, *model.collapsed):
        prior = priors.parameters[name]
        if prior.distribution is not None:
            members.setdefault(prior.spec.block, []).append(name)
    return tuple(Group(block, tuple(names)) for block, names in members.items())


def grid_of(
    groups: Iterable[Group], model: SweepModel, priors: Priors, grid: GridTable, where: str
) -> tuple[Variation, ...]:
    """Every cell of a sweep that changes something.

    Widths and families act on a whole group, shifts on one parameter at a time (a block has no one
    direction to be shifted in). Departures of thrust are centred on zero and are not shifted. What
    is integrated out stays normal, unless it can be walked instead (the common thrust).

    Raises
    ------
    InputError
        A group with a parameter that does not act in the model, or with none that is free.
    """
    acting = (*model.space.names, *model.collapsed)
    cells: list[Variation] = []
    for group in groups:
        _check_group(group, acting, priors, where)
        free = tuple(n for n in group.parameters if priors.parameters[n].distribution is not None)
        changeable = tuple(n for n in free if n in (*model.space.names, THRUST_COMMON))
        cells += [Variation(group.name, "width", free, amount=w) for w in grid.widths if w != 1.0]
        cells += [
            Variation(group.name, "shift", (name,), amount=shift)
            for name in free
            if name not in ZERO_CENTRED
            for shift in grid.shifts
            if shift != 0.0
        ]
        cells += [Variation(group.name, "family", changeable, family=f) for f in grid.families]
    return tuple(cell for cell in cells if cell.applied(priors).parameters != priors.parameters)


def _check_group(group: Group, acting: Sequence[str], priors: Priors, where: str) -> None:
    for name in group.parameters:
        check_known(
            f"{where}: group {group.name}", name, acting, "parameters that act in the model"
        )
    if all(priors.parameters[name].distribution is None for name in group.parameters):
        raise InputError(
            f"{where}: group {group.name}",
            "at least one parameter with a distribution",
            "none, or only fixed ones",
            "leave the group out",
        )
