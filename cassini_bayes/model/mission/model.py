"""The mission model: a sum of models of events, whose thrusts share levels, ageing and pressure.

Thrust of thruster k of a branch in event e is ::

    F = u(p_e) [common + individual_k + (drift + ageing_k) t_e − losses so far] + event_e
        + jitter_ek,
    u(p) = λ + (1 − λ) p / p_ref,

linear in everything but the share λ of the thrust that pressure leaves, which is walked; λ = 0 is
the proportional law. ``docs/topics/mission.md`` derives what follows.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np

from cassini_bayes.balance.physics import Parameters
from cassini_bayes.computing.arrays import Array, Places, joined, picked
from cassini_bayes.computing.cached import cached_property
from cassini_bayes.errors import InputError
from cassini_bayes.events.totals import TotalsEvent
from cassini_bayes.model.mission.circumstances import Circumstances
from cassini_bayes.model.mission.mission_file import ChangeTable, MissionTable
from cassini_bayes.model.posterior import Event, Model, build_model
from cassini_bayes.model.thrusts import (
    ThrustInformation,
    level_factor,
    thrust_prior_of,
)
from cassini_bayes.priors.distributions import Distribution
from cassini_bayes.priors.parameter_space import ParameterSpace
from cassini_bayes.priors.reader import ParameterPrior, Priors, known_parameters
from cassini_bayes.spacecraft.parameters import THRUST_COMMON

INTERCEPT: Final = "thrust_intercept_share"
AGEING: Final = ("thrust_drift_n_per_year", "thrust_ageing_n_per_year")
TAIL: Final = "tau_fall_s"
TAIL_PRESSURE: Final = "tail_pressure_exponent"
TAIL_AGEING: Final = "tail_ageing_per_year"
USED_FACTOR: Final = "hydrazine_used_factor"
OF_A_BRANCH: Final = ("thrust", "tail-off")
"""Blocks whose parameters every branch has for itself; any other that a branch table names."""
MAY_CHANGE: Final = ("centre of mass", "inertia", "mass")
"""Blocks that dated facts and propellant may change."""
_SAME_THRUST: Final = 0.1  # events whose expected thrusts differ less share an expansion
_MOST_POINTS, _MOST_ROWS = 100, 5_000  # worked up at a time; rows are events times points


@dataclass(frozen=True)
class Part:
    """Events of the same circumstances, as a model of their own.

    ``names`` maps the model's parameters to the mission's. ``changes`` adds a mission's parameter
    to one of them, ``drifts`` one times the hydrazine used.
    """

    model: Model
    places: Places  # of its events that fire among the branch's
    branch: str
    names: Mapping[str, str]
    changes: tuple[tuple[str, str], ...]
    drifts: tuple[tuple[str, str], ...]
    used_kg: float  # tabulated, since the reference epoch
    tail_pressure: str  # mission's names of what the tail-off follows
    tail_ageing: str
    event: int  # one of its events: all share pressure and age as far as the tail-off asks

    def parameters_at(
        self, parameters: Parameters, relative_pressure: Array, years: float
    ) -> dict[str, Array | float]:
        """The model's parameters at the mission's; relative_pressure (n,) = p / p_ref."""
        own = {name: parameters[mission] for name, mission in self.names.items()}
        used_kg = self.used_kg * parameters.get(USED_FACTOR, 1.0)
        added = [(name, parameters[change]) for name, change in self.changes]
        added += [(name, used_kg * parameters[drift]) for name, drift in self.drifts]
        for name, amount in added:
            if name in own:
                own[name] = own[name] + amount
        if TAIL in own and self.tail_pressure in parameters:
            power, rate = parameters[self.tail_pressure], parameters[self.tail_ageing]
            own[TAIL] = own[TAIL] * relative_pressure**-power * np.exp(rate * years)
        return own


@dataclass(frozen=True)
class BranchThrusts:
    """Thrusts of one branch: the events that fired it, and the coefficients they share.

    Coefficients are standard normal before the data: q0 of the thrusters' levels at the reference
    pressure, then q1 of ageing (a drift common to all, and each thruster's own).
    """

    branch: str
    thrusters: tuple[str, ...]
    events: Places  # (E,) among the mission's
    years: Array  # (E,) since the first of them
    common_n: float  # prior mean of a level
    levels: Array  # (K, q0) factor of the levels' prior covariance
    ageing: Array  # (K, q1) factor of the prior covariance of their change in a year
    departures: Array  # (K, p) factor of an event's departures
    reference_n: Array  # (E,) thrust about which each event's information is given

    def rows(self, years: Array) -> Array:
        """Design rows (T, K, q) of levels at years (T,) since the branch's first event."""
        levels = np.broadcast_to(self.levels, (len(years), *self.levels.shape))
        return np.concatenate([levels, years[:, None, None] * self.ageing], axis=-1)

    def scale_at(self, parameters: Parameters, relative: Array) -> Array:
        """u (n, E), thrust over that at the reference pressure; relative (n, …) as pressures."""
        share = np.broadcast_to(np.asarray(parameters[INTERCEPT]), (len(relative),))[:, None]
        return np.asarray(share + (1.0 - share) * relative[:, self.events])

    def levels_at(self, shared: Array) -> Array:
        """Levels (n, E, K) less the common one, at the reference pressure, of shared (n, q)."""
        first = self.levels.shape[1]
        steady, yearly = shared[:, :first] @ self.levels.T, shared[:, first:] @ self.ageing.T
        return np.asarray(steady[:, None] + self.years[:, None] * yearly[:, None])

    def onto_shared(self, steady: Array, yearly: Array) -> Array:
        """Rᵀ x (…, q) of the shared coefficients, from Σ x and Σ t x (…, K) over events."""
        return np.concatenate([steady @ self.levels, yearly @ self.ageing], axis=-1)

    def first(self, count: int) -> BranchThrusts:
        """Those of its first events."""
        return replace(
            self,
            events=self.events[:count],
            years=self.years[:count],
            reference_n=self.reference_n[:count],
        )


@dataclass(frozen=True)
class CollapsedLevels:
    """Conditional normal of a branch's shared coefficients at n points, all else integrated out."""

    log_likelihood: Array  # (n,) with the coefficients integrated out too
    factor: Array  # (n, q, q) lower Cholesky factor of their precision
    shift: Array  # (n, q) factor⁻¹ of the linear term

    @cached_property
    def inverse(self) -> Array:
        """Inverse (n, q, q) of the factor."""
        return np.asarray(np.linalg.inv(self.factor))

    @property
    def mean(self) -> Array:
        """Conditional mean (n, q)."""
        return np.asarray((self.shift[:, None] @ self.inverse)[:, 0])


@dataclass(frozen=True)
class BranchAt:
    """One branch at n points: its events' information and the collapsed coefficients."""

    thrusts: BranchThrusts
    scale: Array  # (n, E) u, thrust over thrust at the reference pressure
    information: ThrustInformation  # about ``reference_n``
    left: ThrustInformation  # for levels, about their prior mean; own departures integrated out

    @classmethod
    def of(cls, thrusts: BranchThrusts, scale: Array, information: ThrustInformation) -> BranchAt:
        """With the events' own departures eliminated."""
        about = information.about(_offset_n(thrusts, scale))
        return cls(thrusts, scale, information, about.without_departures(thrusts.departures))

    @classmethod
    def joined(cls, lots: Sequence[BranchAt]) -> BranchAt:
        """The same at the points of several lots, in their order."""
        own = [(lot.scale, lot.information, lot.left) for lot in lots]
        return cls(lots[0].thrusts, *joined(own))

    @property
    def offset_n(self) -> Array:
        """Prior mean of the thrusts less the reference (n, E, K)."""
        return _offset_n(self.thrusts, self.scale)

    @cached_property
    def levels(self) -> CollapsedLevels:
        """Thrusts and coefficients integrated out.

        With the design row u [B, t A] of an event, B of levels and A of ageing, the precision is
        1 + [[Bᵀ S₀ B, Bᵀ S₁ A], [Aᵀ S₁ B, Aᵀ S₂ A]], S_i = Σ u² tⁱ G̃: three sums of K × K.
        """
        own, left, scale = self.thrusts, self.left, self.scale
        n, events, size = left.vector.shape
        powers = own.years ** np.arange(3)[:, None]
        flat = left.matrix.reshape(n, events, size * size)
        sums = ((scale**2)[:, None] * powers) @ flat
        steady, mixed, yearly = np.moveaxis(sums.reshape(n, 3, size, size), 1, 0)
        across = own.levels.T @ mixed @ own.ageing
        precision = np.block(
            [
                [own.levels.T @ steady @ own.levels, across],
                [np.swapaxes(across, -1, -2), own.ageing.T @ yearly @ own.ageing],
            ]
        )
        linear = (scale[:, None] * powers[:2]) @ left.vector
        vector = own.onto_shared(linear[:, 0], linear[:, 1])
        factor = np.asarray(np.linalg.cholesky(precision + np.eye(precision.shape[-1])))
        shift = np.asarray(np.linalg.solve(factor, vector[..., None]))[..., 0]
        log_det = np.log(np.diagonal(factor, axis1=-2, axis2=-1)).sum(-1)
        fit = 0.5 * (shift**2).sum(-1)
        return CollapsedLevels(left.constant.sum(-1) + fit - log_det, factor, shift)

    def take(self, places: Places) -> BranchAt:
        """The same at some of the points, in that order."""
        own = self.scale, self.information, self.left
        return BranchAt(self.thrusts, *picked(own, places))

    def first(self, count: int) -> BranchAt:
        """The same of the branch's first events alone."""
        own = self.scale, self.information, self.left
        return BranchAt(self.thrusts.first(count), *picked(own, np.s_[:, :count]))


def _offset_n(thrusts: BranchThrusts, scale: Array) -> Array:
    mean = thrusts.common_n * scale - thrusts.reference_n
    return np.broadcast_to(mean[..., None], (*mean.shape, len(thrusts.thrusters)))


@dataclass(frozen=True)
class MissionModel:
    """Everything that stays constant during the fit of a mission."""

    parts: tuple[Part, ...]
    branches: tuple[BranchThrusts, ...]
    circumstances: Circumstances
    space: ParameterSpace
    units: Mapping[str, str]

    def at(self, z: Array) -> tuple[tuple[BranchAt, ...], Array]:
        """Every branch at coordinates z (n, d), and log likelihoods (n,) without thrusts."""
        parameters, n = self.space.to_parameters(z), len(z)
        relative = self.relative_pressures(parameters, n)
        result: dict[str, list[tuple[Part, ThrustInformation]]] = {}
        rest = np.zeros(n)
        for part in self.parts:
            points = part.model.points_at(self.of_part(part, parameters, relative), n)
            terms = [term.at(points) for term in part.model.terms]
            rest = rest + sum(term.log_likelihood for term in terms)
            if len(part.places):
                of_part = joined([term.information for term in terms], axis=1)
                result.setdefault(part.branch, []).append((part, of_part))
        return tuple(
            self._branch_at(branch, result[branch.branch], parameters, relative)
            for branch in self.branches
        ), rest

    def relative_pressures(self, parameters: Parameters, n: int) -> Array:
        """Tank pressures over the reference one in all events, (n, E)."""
        factor = np.broadcast_to(np.asarray(parameters.get(USED_FACTOR, 1.0)), (n,))
        tank = self.circumstances.tank
        return np.asarray(tank.pressures_kpa(factor) / tank.reference_kpa)

    def of_part(
        self, part: Part, parameters: Parameters, relative: Array
    ) -> dict[str, Array | float]:
        """One part's own parameters at the mission's; relative (n, E) as above."""
        return part.parameters_at(parameters, relative[:, part.event], self._years(part))

    def log_likelihood(self, z: Array) -> Array:
        """Collapsed log likelihood (n,) at walked coordinates z (n, d)."""
        return np.concatenate([self._log_likelihood(z[rows]) for rows in self.batches(len(z))])

    def _log_likelihood(self, z: Array) -> Array:
        branches, rest = self.at(z)
        return np.asarray(rest + sum(branch.levels.log_likelihood for branch in branches))

    def batches(self, n: int) -> Iterator[slice]:
        """Slices that cover n points, fewer at a time the more events there are."""
        size = min(_MOST_POINTS, max(1, _MOST_ROWS // len(self.circumstances.events)))
        return (slice(start, min(start + size, n)) for start in range(0, n, size))

    def _years(self, part: Part) -> float:
        for branch in self.branches:
            if branch.branch == part.branch and len(part.places):
                return float(branch.years[part.places[0]])
        return 0.0

    def _branch_at(
        self,
        branch: BranchThrusts,
        parts: Sequence[tuple[Part, ThrustInformation]],
        parameters: Parameters,
        relative: Array,
    ) -> BranchAt:
        order = np.argsort(np.concatenate([part.places for part, _ in parts]))
        every = joined([information for _, information in parts], axis=1)
        scale = branch.scale_at(parameters, relative)
        return BranchAt.of(branch, scale, picked(every, np.s_[:, order]))


class _Told(NamedTuple):
    """A change that the mission file tells: its key, whose it is, its name, unit added, table."""

    where: str
    of: str
    name: str
    per: str
    table: ChangeTable

    @property
    def distribution(self) -> Distribution:
        """What is believed of it."""
        given = {"loc": self.table.loc, "scale": self.table.scale}
        return Distribution("norm", given, where=self.where)


def mission_name(name: str, block: str, branch: str, own: Sequence[str], several: bool) -> str:
    """A parameter's name in a mission: with its branch where branches have one each."""
    return f"{branch}.{name}" if several and (block in OF_A_BRANCH or name in own) else name


def build_mission(
    mission: MissionTable,
    priors: Priors,
    events: Sequence[Event],
    circumstances: Circumstances,
    where: str,
) -> MissionModel:
    """Assemble the model of a mission.

    Parameters
    ----------
    events
        In the order of ``circumstances``; velocity changes computed on board are left out: they
        inform no thrust.
    where
        The mission file, for messages.

    Raises
    ------
    InputError
        As :func:`build_model`; priors from an earlier fit; a common thrust that is not normal; a
        change of a parameter that no fact changes.
    """
    if priors.earlier is not None:
        raise InputError(
            f"{priors.path}: from_fit",
            "priors of their own",
            "an earlier fit",
            "a mission goes on with its own trend.nc: leave from_fit out",
        )
    told = _told_changes(mission, where)
    _check_changes(told, priors)
    names_of_branches = tuple(
        dict.fromkeys(name for table in priors.of_branches.values() for name in table)
    )
    several = len(circumstances.branches) > 1
    prior_of: dict[str, ParameterPrior] = {}
    branches = tuple(
        _branch_thrusts(branch, priors.for_branch(branch), circumstances)
        for branch in circumstances.branches
        if any(e.fires for e in circumstances.events if e.branch == branch)
    )
    parts = []
    drifts = tuple((name, drift_name(name)) for name in mission.drift)
    for members in _alike(mission, priors, circumstances, branches):
        branch = circumstances.events[members[0]].branch
        of_branch = priors.for_branch(branch)
        chosen = [_without_computed(events[i]) for i in members]
        thrusts = next((b for b in branches if b.branch == branch), None)
        places = _places(thrusts, members)
        if thrusts is not None and len(places):
            of_branch = _about(of_branch, float(thrusts.reference_n[places[0]]))
        model = build_model(chosen, of_branch, pulse_shape=mission.pulse_shape)
        names = {}
        for name in (*model.space.names, *model.space.fixed):
            prior = of_branch.parameters[name]
            label = mission_name(name, prior.spec.block, branch, names_of_branches, several)
            names[name], prior_of[label] = label, prior
        by_pressure, by_age = (
            mission_name(law, "tail-off", branch, names_of_branches, several)
            for law in (TAIL_PRESSURE, TAIL_AGEING)
        )
        if len(places):
            of_branch.require((INTERCEPT, TAIL_PRESSURE, TAIL_AGEING), "a mission")
            prior_of[by_pressure] = of_branch.parameters[TAIL_PRESSURE]
            prior_of[by_age] = of_branch.parameters[TAIL_AGEING]
            prior_of[INTERCEPT] = priors.parameters[INTERCEPT]
        first = members[0]
        changes = tuple(_changes(mission, circumstances.facts_before[first]))
        used_kg = float(circumstances.used_kg[first])
        tail = by_pressure, by_age
        parts.append(Part(model, places, branch, names, changes, drifts, used_kg, *tail, first))
    is_computed = mission.propellant is not None and mission.propellant.computed
    if is_computed and (drifts or circumstances.tank.is_circular):
        priors.require([USED_FACTOR], "hydrazine that was computed")
        prior_of[USED_FACTOR] = priors.parameters[USED_FACTOR]
    moving = {c for part in parts for _, c in (*part.changes, *part.drifts)}
    space, units = _space(prior_of, told, moving)
    return MissionModel(tuple(parts), branches, circumstances, space, units)


def _without_computed(event: Event) -> Event:
    """The event without a velocity change that the flight software computed."""
    if isinstance(event, TotalsEvent) and event.delta_v_source == "computed":
        return replace(event, delta_v_m_s=None, delta_v_source=None)
    return event


def _about(priors: Priors, reference_n: float) -> Priors:
    """Priors whose common thrust has another mean: what an event's information is counted from."""
    common = priors.parameters[THRUST_COMMON]
    if common.distribution is None:
        return priors.with_fixed(THRUST_COMMON, reference_n)
    moved = Distribution("norm", {"loc": reference_n, "scale": common.sd})
    return priors.with_distribution(THRUST_COMMON, moved)


def _branch_thrusts(branch: str, priors: Priors, circumstances: Circumstances) -> BranchThrusts:
    """The coefficients that a branch's events share, and their design rows."""
    thrusters = priors.spacecraft.thruster_names(branch)
    prior = thrust_prior_of(priors, len(thrusters))
    if prior.common_is_walked:
        raise InputError(
            f"{priors.path}: parameters.{THRUST_COMMON}.dist",
            "norm without bounds, or fixed, in a mission",
            "another distribution",
            "use a normal prior",
        )
    _, (drift, departure) = priors.normal(AGEING)
    events = np.array(
        [i for i, e in enumerate(circumstances.events) if e.branch == branch and e.fires]
    )
    share = priors.parameters[INTERCEPT].mean if INTERCEPT in priors.parameters else 0.0
    tank = circumstances.tank
    relative = tank.pressures_kpa(np.ones(1))[0, events] / tank.reference_kpa
    expected = prior.common_mean_n * (share + (1.0 - share) * relative)
    steps = np.round(np.log(expected) / _SAME_THRUST)
    return BranchThrusts(
        branch=branch,
        thrusters=thrusters,
        events=events,
        years=circumstances.years[events] - circumstances.years[events[0]],
        common_n=prior.common_mean_n,
        levels=prior.shared,
        ageing=level_factor(drift, departure, len(thrusters)),
        departures=prior.departures,
        reference_n=np.asarray(np.exp(_SAME_THRUST * steps)),
    )


def _places(thrusts: BranchThrusts | None, members: Sequence[int]) -> Places:
    """Places of events among those that fired their branch, those that did not left out."""
    if thrusts is None:
        return np.zeros(0, dtype=np.int64)
    return np.flatnonzero(np.isin(thrusts.events, members))


def _alike(
    mission: MissionTable,
    priors: Priors,
    circumstances: Circumstances,
    branches: Sequence[BranchThrusts],
) -> list[list[int]]:
    """Events grouped by all that their balances depend on beside the shared parameters."""
    changing = [i for i, fact in enumerate(mission.dated) if fact.change]
    reference = {int(e): float(b.reference_n[i]) for b in branches for i, e in enumerate(b.events)}
    groups: dict[tuple[object, ...], list[int]] = {}
    for i, event in enumerate(circumstances.events):
        of_branch = priors.for_branch(event.branch)
        follows = [
            n in of_branch.parameters and of_branch.parameters[n].fixed != 0.0
            for n in (TAIL_PRESSURE, TAIL_AGEING)
        ]
        known = float(circumstances.tank.known_kpa[i])
        key = (
            event.branch,
            event.fires,
            sum(fact < circumstances.facts_before[i] for fact in changing),
            float(circumstances.used_kg[i]) if mission.drift else 0.0,
            (i if np.isnan(known) else known) if follows[0] else 0.0,
            float(circumstances.years[i]) if follows[1] else 0.0,
            reference.get(i, 0.0),
        )
        groups.setdefault(key, []).append(i)
    return list(groups.values())


def change_name(name: str, since: object) -> str:
    """Name of the change of a parameter at a dated fact."""
    return f"{name}_since_{since}"


def drift_name(name: str) -> str:
    """Name of the change of a parameter with each kilogram of hydrazine used."""
    return f"{name}_per_kg"


def _changes(mission: MissionTable, facts: int) -> list[tuple[str, str]]:
    """What the first facts add to parameters: (parameter, mission's parameter)."""
    return [
        (name, change_name(name, fact.epoch))
        for fact in mission.dated[:facts]
        for name in fact.change
    ]


def _told_changes(mission: MissionTable, where: str) -> list[_Told]:
    """Every change of the mission file, those of dated facts first."""
    return [
        _Told(f"{where}: dated[{i}].change.{name}", name, change_name(name, fact.epoch), "", table)
        for i, fact in enumerate(mission.dated, start=1)
        for name, table in fact.change.items()
    ] + [
        _Told(f"{where}: drift.{name}", name, drift_name(name), "/kg", table)
        for name, table in mission.drift.items()
    ]


def _check_changes(told: Sequence[_Told], priors: Priors) -> None:
    specs = known_parameters(priors.spacecraft)
    allowed = [name for name, spec in specs.items() if spec.block in MAY_CHANGE]
    for change in told:
        if change.of not in allowed:
            raise InputError(
                change.where,
                f"a parameter of {', '.join(MAY_CHANGE)}",
                f"the name {change.of!r}",
                "thrusts, tail-offs and wheels change by the laws of the mission model",
            )
        unit, given = specs[change.of].unit + change.per, change.table.unit
        if given != unit:
            raise InputError(f"{change.where}.unit", repr(unit), repr(given), "convert the values")


def _space(
    prior_of: Mapping[str, ParameterPrior], told: Sequence[_Told], changes: set[str]
) -> tuple[ParameterSpace, dict[str, str]]:
    """All parameters of the mission in order, those of changes last."""
    free = {name: prior for name, prior in prior_of.items() if prior.distribution is not None}
    fixed = {name: prior.fixed for name, prior in prior_of.items() if prior.fixed is not None}
    units = {name: prior.spec.unit for name, prior in prior_of.items()}
    moving = {change.name: change for change in told if change.name in changes}
    fixed |= {n: change.table.loc for n, change in moving.items() if change.table.scale == 0.0}
    units |= {name: change.table.unit for name, change in moving.items()}
    drawn = {name: change for name, change in moving.items() if change.table.scale > 0.0}
    space = ParameterSpace(
        names=(*free, *drawn),
        fixed=fixed,
        distributions=(
            *(prior.distribution for prior in free.values() if prior.distribution is not None),
            *(change.distribution for change in drawn.values()),
        ),
        blocks=(*(prior.spec.block for prior in free.values()), *("change" for _ in drawn)),
    )
    return space, units
