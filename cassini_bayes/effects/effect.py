"""What an effect is: a kind of departure from the standard physics, and that kind on one target.

Every kind is one file of this package with its table beside it, ``<name>.py`` and ``<name>.toml``.
The file ends with ``KIND = Kind(...)``, which holds all that other modules know of it. The table
says which targets the kind has, which inputs show it, and what is believed of its size
(:mod:`cassini_bayes.effects.catalogue`). docs/how-to/own-effect.md writes one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from cassini_bayes.balance.linearised import InnovationRows, Linear
from cassini_bayes.balance.physics import Modifier, Parameters, Physics
from cassini_bayes.balance.statistics import ExtraColumn, Samples
from cassini_bayes.computing.arrays import Array
from cassini_bayes.effects.controller import Controller, Fired
from cassini_bayes.effects.firings import FiredIntervals
from cassini_bayes.effects.printed import Printed
from cassini_bayes.effects.wording import Sizes
from cassini_bayes.errors import InputError
from cassini_bayes.priors.distributions import Distribution
from cassini_bayes.spacecraft import Spacecraft
from cassini_bayes.spacecraft.parameters import EFFECT_BLOCK, ParameterSpec

Values = Mapping[str, Array]
"""An effect's own parameters by key, each (n,): one value for every point."""


class SearchResult(Protocol):
    """What a search before the fit has settled, such as a frequency.

    A class that inherits from it has to have ``log_gain``, ``log_looks`` and ``columns``; the
    others say nothing by default.
    """

    @property
    def log_gain(self) -> float:
        """What the search found, nats."""

    @property
    def log_looks(self) -> float:
        """What the search cost, nats: the log of the number of places searched."""

    @property
    def prior_scales(self) -> Mapping[str, float]:
        """Factors by key on priors of sizes that it has chosen among several; 1 without."""
        return {}

    @property
    def said(self) -> str:
        """What it has settled that no size says, as words that follow theirs."""
        return ""

    @property
    def record(self) -> Mapping[str, object]:
        """The same by key, for a diagnosis file."""
        return {}

    def log_start_of(self, _: Samples) -> float:
        """What it has taken from one event that others do not tell, nats: part of the cost."""
        return 0.0

    def columns(self, samples: Samples) -> tuple[ExtraColumn, ...]:
        """Columns of one event's telemetry that go with it."""


@dataclass(frozen=True)
class Setting:
    """Where an effect acts: spacecraft, branch, its target, and what a search has settled."""

    spacecraft: Spacecraft
    branch: str
    target: str
    search_result: SearchResult | None = None

    @property
    def thrusters(self) -> tuple[str, ...]:
        """Names of the branch's thrusters in order."""
        return self.spacecraft.thruster_names(self.branch)

    @property
    def thruster(self) -> int:
        """Place of the target among the thrusters."""
        return self.thrusters.index(self.target)


@dataclass(frozen=True)
class Remainder:
    """What a fitted model leaves of the telemetry: where a search before the next fit looks.

    ``samples`` and ``rows`` are those of every event, ``linear`` is the model about its mode, and
    ``target`` (m,) what it is fitted to, about the prior mean: taken about the mode, which has been
    fitted to it, it would be fitted twice. ``parameters`` are the model's at its mode.
    ``with_turns`` makes rows and turns of quiet pieces, and the linear model that left them: first
    the rows of every event, then its turns.
    """

    samples: tuple[Samples, ...]
    rows: tuple[InnovationRows, ...]
    linear: Linear
    target: Array
    parameters: Mapping[str, float]
    with_turns: Callable[[], tuple[Linear, tuple[InnovationRows, ...]]]


@dataclass(frozen=True)
class FittedRows:
    """The rows (n,) of one event that enter the balance, with the physics of one point (B = 1)."""

    time_s: Array
    samples: Samples
    physics: Physics


Change = Callable[[Physics, Parameters, Values, Setting], Physics]
"""The physics at n points with the effect in it; what it gets is not written to."""


def unchanged(physics: Physics, _: Parameters, __: Values, ___: Setting) -> Physics:
    """The change of an effect that leaves the momentum balance as it is."""
    return physics


@dataclass(frozen=True)
class Kind:
    """One kind of effect: its name and the functions that define it.

    Attributes
    ----------
    name
        As a diagnosis spells it, without target; also the name of the table's file.
    change
        What it does to the physics, the same of totals rows and of telemetry.
    columns
        From the names of an event's thrusters to the columns of telemetry that its physics weighs
        by name (``Physics.extra``). Column ``what@thruster`` is an on-time of that thruster.
    search
        Settles before the fit what is no parameter of it, in what a model leaves; None where these
        events are too short. Its priors are those of the effect.
    reported, report
        Keys of the sizes that it is reported with, and the function from its parameters to them;
        those of the parameters themselves by default.
    drawn
        Draws (n,) of sizes, keys as ``report`` has them, that stand for those of the fit: of what a
        search has found and the fit, near one value of it, does not range over.
    known_to
        How finely the data tell a size, by key: it is spread evenly over such a step more, half
        of it to either side. None stands for two of the spacecraft's control cycles.
    left_open
        What counters leave open about it: columns (n, 3, s), N m s, one for every firing of some
        thrusters that only fire together, and the variances (s,) of their unknowns.
    fire
        What it makes of a controller's firings, where on-times are predicted.
    doubt
        Printed thrusts with this doubted: beliefs by name of the cause, at a width of its priors.
    says
        What its sizes (reported keys, those of the table) on a target mean, as a clause with no
        full stop: "Z3 delivers 74 ± 4 % of its thrust". Keys and units by default.
    separation
        Which measurement tells it from another kind, by the other's name.
    needs_quiet_rows
        Whether rows with late pulses cannot tell it: it is not weighed where events have them.
    needs_turns
        Whether slews tell it only by turns about an axis of its target, which is made of axes
        (``"xy"``: X or Y). Slews alone that turn about none of these do not weigh it: there noise
        draws it.
    throughout
        Whether it acts in all events if in any: what a rotor weighs does not change between two.
    """

    name: str
    change: Change
    columns: Callable[[Sequence[str]], tuple[ExtraColumn, ...]] | None = None
    search: Callable[[Remainder, Mapping[str, Distribution]], SearchResult | None] | None = None
    reported: tuple[str, ...] = ()
    report: Callable[[Values, Setting], Values] | None = None
    drawn: Callable[[Setting, np.random.Generator, int], Values] | None = None
    known_to: Mapping[str, float | None] = field(default_factory=dict)
    left_open: (
        Callable[[FiredIntervals, FittedRows, Values, Setting], tuple[Array, Array]] | None
    ) = None
    fire: Callable[[Controller, Values], Fired] | None = None
    doubt: Callable[[Printed, float], Mapping[str, Printed]] | None = None
    says: Callable[[Sizes, str], str] | None = None
    separation: Mapping[str, str] = field(default_factory=dict)
    needs_quiet_rows: bool = False
    needs_turns: bool = False
    throughout: bool = False


@dataclass(frozen=True)
class EffectParameter:
    """One parameter of an effect, walked under ``name``.

    ``key`` is its name in a diagnosis; a departure is added to the parameter ``baseline`` of the
    spacecraft or the model, anything else has none.
    """

    name: str
    key: str
    unit: str
    distribution: Distribution
    baseline: str = ""

    @property
    def is_departure(self) -> bool:
        """Whether it is added to a parameter that is there without the effect."""
        return bool(self.baseline)


@dataclass(frozen=True)
class Onset:
    """From which event on an effect acts: the id of the first one, and of all in which it does."""

    event: str
    events: frozenset[str]


def onsets(order: Sequence[str]) -> tuple[Onset, ...]:
    """Every onset after the first event, for ids in order of time."""
    return tuple(Onset(order[i], frozenset(order[i:])) for i in range(1, len(order)))


@dataclass(frozen=True)
class Effect:
    """A cause: a kind of effect on one target, with the priors of its size.

    ``form_error`` is the standard deviation, by the name of a size and as a share of it, of what
    the term's form leaves out, ``late_form_error`` of what it leaves out more where rows have late
    pulses; ``source`` is where its priors come from. ``search_result`` is what a search before the
    fit settled, where the kind has one and it was made. With an ``onset`` it acts from one event
    on, without throughout.
    """

    kind: Kind
    target: str
    parameters: tuple[EffectParameter, ...]
    prior_probability: float
    form_error: tuple[tuple[str, float], ...] = ()
    late_form_error: tuple[tuple[str, float], ...] = ()
    search_result: SearchResult | None = None
    source: str = ""
    onset: Onset | None = None

    @property
    def name(self) -> str:
        """Kind, and the target behind a colon where there is one."""
        return f"{self.kind.name}:{self.target}" if self.target else self.kind.name

    def acts_in(self, event: str) -> bool:
        """Whether it acts in an event of this id."""
        return self.onset is None or event in self.onset.events

    @property
    def needs_search(self) -> bool:
        """Whether a search has to settle something before this can be fitted."""
        return self.kind.search is not None and self.search_result is None

    @property
    def specs(self) -> tuple[ParameterSpec, ...]:
        """Unit and meaning of its parameters."""
        begins = "" if self.onset is None else f", from {self.onset.event} on"
        return tuple(
            ParameterSpec(p.name, p.unit, EFFECT_BLOCK, f"{self.name}: {p.key}{_role(p)}{begins}")
            for p in self.parameters
        )

    def variable(self, parameter: EffectParameter) -> str:
        """Name of a parameter in a fit: ``thruster_leak_z3_leak_n``, ``…_departure`` of such."""
        name = f"{self.name.replace(':', '_')}_{parameter.key}"
        return f"{name}_departure" if parameter.is_departure else name

    def as_fitted(self) -> Effect:
        """The same effect, its parameters under the names that they have in a fit."""
        named = tuple(replace(p, name=self.variable(p)) for p in self.parameters)
        return replace(self, parameters=named)

    def scaled(self, width: float) -> Effect:
        """The same effect with all priors of its size wider by a factor."""
        return self._with_wider({p.key: width for p in self.parameters})

    def settled_by(self, result: SearchResult) -> Effect:
        """The same effect as a search has settled it, its priors those that go with it."""
        return replace(self._with_wider(result.prior_scales), search_result=result)

    def _with_wider(self, widths: Mapping[str, float]) -> Effect:
        """The same effect with some priors of its sizes, by key, wider by a factor each."""
        parameters = tuple(
            replace(p, distribution=_wider(p.distribution, widths[p.key])) if p.key in widths else p
            for p in self.parameters
        )
        return replace(self, parameters=parameters)

    def setting(self, spacecraft: Spacecraft, branch: str) -> Setting:
        """Where it acts."""
        return Setting(spacecraft, branch, self.target, self.search_result)

    def values(self, parameters: Parameters) -> dict[str, Array]:
        """Its own parameters by key, out of all parameters of a model."""
        return {p.key: np.asarray(parameters[p.name], dtype=np.float64) for p in self.parameters}

    def modifier(self, spacecraft: Spacecraft, branch: str) -> Modifier:
        """It as a change of physics that reads its own walked parameters."""
        setting = self.setting(spacecraft, branch)

        def modify(physics: Physics, parameters: Parameters) -> Physics:
            return self.kind.change(physics, parameters, self.values(parameters), setting)

        return modify


def _role(parameter: EffectParameter) -> str:
    return ", departure from the baseline's" if parameter.is_departure else ""


def settled_for(effects: Iterable[Effect]) -> tuple[SearchResult, ...]:
    """What searches before the fit have settled for some effects, in their order."""
    results = (effect.search_result for effect in effects)
    return tuple(result for result in results if result is not None)


def columns_of(kinds: Iterable[Kind], thrusters: Sequence[str]) -> tuple[ExtraColumn, ...]:
    """Every column of telemetry that some kinds need and that needs no search.

    Those of a thruster lie side by side, those of none are the last.

    Raises
    ------
    InputError
        Two columns of one name.
    """
    places = {name: place for place, name in enumerate(thrusters)}
    needed = {kind.name: kind.columns for kind in kinds if kind.columns is not None}
    owner: dict[str, str] = {}
    columns: list[ExtraColumn] = []
    for name, make in needed.items():
        for column in make(thrusters):
            if column.name in owner:
                raise InputError(
                    f"effect {name}: column {column.name}",
                    "a name of its own",
                    f"one that {owner[column.name]} has",
                    "rename it",
                )
            owner[column.name] = name
            columns.append(column)
    return tuple(sorted(columns, key=lambda c: places.get(c.name.partition("@")[2], len(places))))


def _wider(distribution: Distribution, width: float) -> Distribution:
    """The distribution with its scale times ``width``; a log-normal time constant stays."""
    if distribution.name == "lognorm":
        return distribution
    wider = {"scale": distribution.scale * width}
    return replace(distribution, keywords={**distribution.keywords, **wider})
