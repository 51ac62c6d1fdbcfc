"""The catalogue of causes for some events: kinds on all their targets, with prior probabilities."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from cassini_bayes.balance.inertia import ELEMENTS
from cassini_bayes.effects.changes import AXES
from cassini_bayes.effects.effect import Effect, EffectParameter, Kind, Onset, onsets
from cassini_bayes.effects.registry import Kinds, Odds, Unknown, standard
from cassini_bayes.effects.tables import ParameterTable, Place, Table
from cassini_bayes.errors import InputError
from cassini_bayes.files.checks import check_known, nearest
from cassini_bayes.priors.distributions import Distribution
from cassini_bayes.priors.reader import Priors, known_parameters
from cassini_bayes.spacecraft import WHEEL_KEYS


@dataclass(frozen=True)
class Catalogue:
    """All causes for some events, and the kinds that they are of."""

    effects: tuple[Effect, ...]
    kinds: Kinds

    @property
    def odds(self) -> Odds:
        """Prior probabilities of ``none``, of all causes together, and of ``unknown``."""
        return self.kinds.odds

    @property
    def unknown(self) -> Unknown:
        """What ``unknown`` believes of the discrepancy."""
        return self.kinds.unknown

    def of_these(self, effects: Sequence[Effect]) -> Catalogue:
        """The catalogue of some effects alone, which have all that causes have of the odds."""
        shares = self.odds.of_causes([effect.kind.name for effect in effects])
        each = zip(effects, shares, strict=True)
        return replace(self, effects=tuple(replace(e, prior_probability=p) for e, p in each))

    def effect(self, name: str) -> Effect:
        """The effect of a name.

        Raises
        ------
        InputError
            There is none.
        """
        check_known(f"effect {name}", name, self.names, "an effect of these events")
        return self.effects[self.names.index(name)]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all effects."""
        return tuple(effect.name for effect in self.effects)


def read_catalogue(
    priors: Priors, wheels: Sequence[int], inputs: Sequence[str], kinds: Kinds | None = None
) -> Catalogue:
    """Fill in the targets that these events have.

    Parameters
    ----------
    priors
        Their spacecraft and branch give the targets, their widths the scale of departures.
    wheels
        Numbers of the wheels that the events use.
    inputs
        ``telemetry``, ``totals`` or both, or ``on_times``: effects that only other inputs show are
        left out.
    kinds
        What effects there are; those of the package by default.

    Raises
    ------
    InputError
        A table that does not fit its effect: file and dotted key are named.
    """
    known = standard() if kinds is None else kinds
    effects = [
        _effect(kind, table, target, priors)
        for kind, table in known.kinds
        if set(table.inputs) & set(inputs)
        for target in _targets(table, priors, wheels)
    ]
    return Catalogue((), known).of_these([effect for effect in effects if effect is not None])


def named_effects(
    names: Sequence[str],
    priors: Priors,
    wheels: Sequence[int],
    inputs: Sequence[str],
    kinds: Kinds | None = None,
    where: str = "effects",
    order: Sequence[str] = (),
) -> tuple[Effect, ...]:
    """Effects by name, to be fitted: their parameters have the names that they have in a fit.

    Parameters
    ----------
    names
        Kind, and the target behind a colon where it has one: ``thruster_leak:z3``. With
        ``@EVENT`` behind it acts from that event on.
    priors, wheels, inputs, kinds
        As for :func:`read_catalogue`.
    where
        What gave the names, for messages.
    order
        Ids of the events in order of time.

    Raises
    ------
    InputError
        A name twice; one that there is not, with the nearest; an effect that such events cannot
        show, that departs from a parameter without prior, or that has to be searched for first; an
        event that is none of these, or the first.
    """
    if not names:
        return ()
    catalogue = read_catalogue(priors, wheels, inputs, kinds)
    chosen: list[Effect] = []
    for given in names:
        name, _, event = given.partition("@")
        if name in (effect.name for effect in chosen):
            raise InputError(where, "every effect once", f"{name!r} twice", "leave one out")
        if name not in catalogue.names:
            raise _not_there(name, catalogue, priors, inputs, where)
        effect = catalogue.effect(name)
        if effect.needs_search:
            raise InputError(
                where,
                "effects that can be fitted at once",
                f"{name!r}, for which a search comes first",
                "use cassini-bayes diagnose --then-fit",
            )
        onset = _onset(given, event, order, where) if "@" in given else None
        chosen.append(replace(effect.as_fitted(), onset=onset))
    taken = list(known_parameters(priors.spacecraft))
    for spec in (spec for effect in chosen for spec in effect.specs):
        if spec.name in taken:
            expected = "parameters of names of their own"
            raise InputError(where, expected, f"{spec.name!r} twice", "rename the effect")
        taken.append(spec.name)
    return tuple(chosen)


def _onset(given: str, event: str, order: Sequence[str], where: str) -> Onset:
    """The onset that a name gives behind its ``@``."""
    result = {onset.event: onset for onset in onsets(order)}
    if event in result:
        return result[event]
    raise InputError(
        where,
        "behind @ an event of this fit, but not the first in time",
        repr(given),
        "leave @ and what follows out: it acts in all events"
        if event in order[:1]
        else nearest(event, list(result)),
    )


def _not_there(
    name: str, catalogue: Catalogue, priors: Priors, inputs: Sequence[str], where: str
) -> InputError:
    """Why a name is none of a catalogue's."""
    tables = {kind.name: table for kind, table in catalogue.kinds.kinds}
    kind, _, target = name.partition(":")
    if kind in tables and not set(tables[kind].inputs) & set(inputs):
        return InputError(
            where,
            f"effects that {' or '.join(inputs)} can show",
            f"{name!r}, which only {' and '.join(tables[kind].inputs) or 'nothing'} can",
            "leave it out",
        )
    if kind in tables and target in _targets(tables[kind], priors, priors.wheels):
        return InputError(
            where,
            "effects of these events and priors",
            f"{name!r}, whose wheel they lack or whose parameter is fixed in {priors.path}",
            "leave it out, or give the parameter a distribution",
        )
    alike = [known for known in catalogue.names if known.partition(":")[0] == kind]
    hint = f"known: {', '.join(alike)}" if alike else nearest(name, catalogue.names)
    return InputError(where, "effects that there are", repr(name), hint)


def _targets(table: Table, priors: Priors, wheels: Sequence[int]) -> tuple[str, ...]:
    spacecraft = priors.spacecraft
    every: Mapping[str, tuple[str, ...]] = {
        "none": ("",),
        "thruster": spacecraft.thruster_names(priors.branch),
        "wheel": tuple(str(number) for number in wheels),
        "tilting wheel": tuple(
            str(n) for n in wheels if spacecraft.wheel(n).tilt_parameters is not None
        ),
        "articulated wheel": tuple(str(n) for n in wheels if spacecraft.wheel(n).is_turned),
        "axis": AXES,
        "element": ELEMENTS,
    }
    return every[table.targets]


def _effect(kind: Kind, table: Table, target: str, priors: Priors) -> Effect | None:
    """The effect on one target; None where its parameter is missing, or fixed and no scale."""
    parameters = []
    for row in table.parameters:
        parameter = _parameter(row, kind, target, priors)
        if parameter is None:
            return None
        parameters.append(parameter)
    keys = tuple(p.key for p in parameters)
    for key in kind.reported if kind.report is None else ():
        _size(f"{table.where / 'parameters'} (reported of {kind.name})", key, keys)
    sizes = kind.reported or keys
    for key in kind.known_to:
        _size(f"{table.where / 'parameters'} (known_to of {kind.name})", key, sizes)
    late = table.where / "late_form_error"
    return Effect(
        kind,
        target,
        tuple(parameters),
        0.0,
        _form_errors(table.where / "form_error", table.form_error, target, sizes),
        _form_errors(late, table.late_form_error, target, sizes),
        source=table.source,
    )


def _form_errors(
    where: Place, shares: Mapping[str, float], target: str, sizes: Sequence[str]
) -> tuple[tuple[str, float], ...]:
    """Sizes with the share of each that a form leaves out, as the table at ``where`` has them."""
    return tuple(
        (
            _size(str(where / key), key.replace("{target}", target), sizes),
            _share(where / key, share),
        )
        for key, share in shares.items()
    )


def _parameter(
    row: ParameterTable, kind: Kind, target: str, priors: Priors
) -> EffectParameter | None:
    key = row.key.replace("{target}", target)
    baseline = _baseline(row, target, priors) if row.is_departure else ""
    if baseline is None:
        return None
    prior = priors.parameters.get(baseline or key)
    distribution = row.prior
    if not isinstance(distribution, Distribution):
        if prior is None or prior.distribution is None:
            return None
        keywords = {"loc": 0.0, "scale": distribution * prior.distribution.sd()}
        distribution = Distribution("norm", keywords, row.low, row.high, where=str(row.where))
    if row.is_departure and prior is not None and row.unit != prior.spec.unit:
        raise InputError(
            str(row.where / "unit"), f"{prior.spec.unit}, that of {baseline}", repr(row.unit),
            "convert the values, then write that unit",
        )  # fmt: skip
    role = "departure" if baseline else "effect"
    return EffectParameter(
        f"{role}:{kind.name}:{target}:{key}",
        key,
        row.unit,
        distribution,
        baseline,
    )


def _baseline(row: ParameterTable, target: str, priors: Priors) -> str | None:
    """Name of the parameter that a departure counts from; None where a wheel has no such thing."""
    key, known = row.key.replace("{target}", target), known_parameters(priors.spacecraft)
    if row.key in WHEEL_KEYS and target.isdigit():
        return priors.spacecraft.wheel(int(target)).by_key.get(key)
    if key not in known:
        expected = f"a departure from a parameter of {priors.spacecraft.name}"
        check_known(str(row.where), key, known, expected)
    return key


def _size(where: str, key: str, sizes: Sequence[str]) -> str:
    check_known(where, key, sizes, "a size of the effect")
    return key


def _share(where: Place, share: object) -> float:
    if isinstance(share, bool) or not isinstance(share, int | float) or not 0 <= share < 1:
        raise InputError(
            str(where),
            "a share of the size, 0 to 1",
            repr(share),
            "give the standard deviation of what the form leaves out, over the size",
        )
    return float(share)
