"""The catalogue of causes: names, priors of their sizes, prior probabilities.

``effects.toml`` beside this module is the default; another file of the same form may stand in. An
:class:`Effect` is one entry with its target filled in; what it does to the physics is in
:mod:`cassini_bayes.effects.modifiers`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

from cassini_bayes.errors import InputError
from cassini_bayes.files.checks import nearest
from cassini_bayes.files.toml_file import read_toml
from cassini_bayes.priors.distributions import Distribution
from cassini_bayes.priors.reader import Priors

DEFAULT: Final = Path(__file__).with_name("effects.toml")
AXES: Final = ("x", "y", "z")
ELEMENTS: Final = ("xx", "yy", "zz", "xy", "xz", "yz")
ROLES: Final = ("value", "departure")
OSCILLATION_SIZES: Final = ("amplitude_rad_s", "frequency_hz", "damping", "inertia_fraction")
_OWN_KEYS: Final = ("role", "dist", "times_prior", "low", "high", "unit")


@dataclass(frozen=True)
class EffectParameter:
    """One parameter of an effect, walked under ``name``.

    ``key`` is its name in a diagnosis; a departure is added to the baseline's parameter of that
    name, whose prior mean is ``centre``.
    """

    name: str
    key: str
    unit: str
    distribution: Distribution
    is_departure: bool


@dataclass(frozen=True)
class Effect:
    """A cause: an entry of the catalogue with its target and its share of prior probability.

    ``form_error`` is the standard deviation, by the name of a size and as a share of it, of what
    the term's form leaves out.
    """

    name: str
    kind: str
    target: str
    parameters: tuple[EffectParameter, ...]
    prior_probability: float
    inputs: tuple[str, ...]
    form_error: tuple[tuple[str, float], ...] = ()

    def scaled(self, width: float) -> Effect:
        """The same effect with all priors of its size wider by a factor."""
        return replace(
            self,
            parameters=tuple(
                replace(p, distribution=_wider(p.distribution, width)) for p in self.parameters
            ),
        )


@dataclass(frozen=True)
class UnknownPrior:
    """What ``unknown`` believes of the discrepancy."""

    torque_noise: Distribution
    hold_rate_factor: float
    on_time_noise_s: Distribution | None = None  # of every printed on-time; None: not given


@dataclass(frozen=True)
class Catalogue:
    """All causes for some events, with the probabilities of ``none`` and ``unknown``."""

    effects: tuple[Effect, ...]
    none_probability: float
    unknown_probability: float
    unknown: UnknownPrior

    def effect(self, name: str) -> Effect:
        """The effect of a name.

        Raises
        ------
        InputError
            There is none.
        """
        for effect in self.effects:
            if effect.name == name:
                return effect
        raise InputError(
            f"cause {name}", "a cause of the catalogue", repr(name), nearest(name, self.names)
        )

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all effects."""
        return tuple(effect.name for effect in self.effects)


def _wider(distribution: Distribution, width: float) -> Distribution:
    """The distribution with its scale times ``width``; a log-normal time constant stays."""
    if distribution.name == "lognorm":
        return distribution
    keywords = dict(distribution.keywords)
    return replace(distribution, keywords={**keywords, "scale": keywords["scale"] * width})


def read_catalogue(
    priors: Priors,
    wheels: Sequence[int],
    inputs: Sequence[str],
    path: Path = DEFAULT,
) -> Catalogue:
    """Read the catalogue and fill in the targets that these events have.

    Parameters
    ----------
    priors
        Their spacecraft and branch give the targets, their widths the scale of departures.
    wheels
        Numbers of the wheels that the events use.
    inputs
        ``telemetry``, ``totals`` or both, or ``on_times``: effects that only other inputs show are
        left out.

    Raises
    ------
    InputError
        The file is no catalogue: file and dotted key are named.
    """
    document = _parse(path)
    weights = document["causes"]
    kinds = document["effects"]
    if path != DEFAULT:
        _check_known(path, kinds, _parse(DEFAULT)["effects"])
    effects = []
    kept = {}
    for kind, entry in kinds.items():
        where = f"{path}: effects.{kind}"
        if not set(entry["inputs"]) & set(inputs):
            continue
        found = [
            _effect(where, kind, target, entry, priors)
            for target in _targets(entry["targets"], priors, wheels)
        ]
        kept[kind] = [effect for effect in found if effect is not None]
    shown = [kind for kind, found in kept.items() if found]
    for kind in shown:
        share = float(weights["catalogued"]) / len(shown) / len(kept[kind])
        effects += [replace(effect, prior_probability=share) for effect in kept[kind]]
    unknown = document["unknown"]
    return Catalogue(
        tuple(effects),
        float(weights["none"]),
        float(weights["unknown"]),
        UnknownPrior(
            Distribution(
                "lognorm",
                {
                    "s": float(unknown["torque_noise_log_sd"]),
                    "scale": float(unknown["torque_noise_median_n_m_s05"]),
                },
            ),
            float(unknown["hold_rate_factor"]),
            _on_time_noise(unknown),
        ),
    )


def _on_time_noise(unknown: Mapping[str, Any]) -> Distribution | None:
    if "on_time_noise_median_s" not in unknown:
        return None
    return Distribution(
        "lognorm",
        {
            "s": float(unknown["on_time_noise_log_sd"]),
            "scale": float(unknown["on_time_noise_median_s"]),
        },
    )


def _parse(path: Path) -> dict[str, Any]:
    document = read_toml(path, "a catalogue of effects")
    for table in ("causes", "unknown", "effects"):
        if not isinstance(document.get(table), dict):
            raise InputError(f"{path}: {table}", f"a table [{table}]", "nothing", "add it")
    for kind, entry in document["effects"].items():
        for key in ("targets", "inputs", "source", "parameters"):
            if key not in entry:
                raise InputError(f"{path}: effects.{kind}.{key}", "a value", "nothing", "add it")
    return document


def _check_known(path: Path, kinds: Mapping[str, Any], known: Mapping[str, Any]) -> None:
    """Every effect has the parameters that its change of the physics reads."""
    for kind, entry in kinds.items():
        where = f"{path}: effects.{kind}"
        if kind not in known:
            raise InputError(where, "an effect that there is", repr(kind), nearest(kind, known))
        needed, given = set(known[kind]["parameters"]), set(entry["parameters"])
        if needed != given:
            raise InputError(
                f"{where}.parameters",
                ", ".join(sorted(needed)),
                ", ".join(sorted(given)) or "nothing",
                "add what is missing, drop what is not known",
            )


def _targets(what: str, priors: Priors, wheels: Sequence[int]) -> tuple[str, ...]:
    spacecraft = priors.spacecraft
    if what == "thruster":
        return spacecraft.thruster_names(priors.branch)
    if what == "wheel":
        return tuple(str(number) for number in wheels)
    if what == "tilting wheel":
        return tuple(str(n) for n in wheels if spacecraft.wheel(n).tilt_parameters is not None)
    return {"axis": AXES, "element": ELEMENTS}.get(what, ("",))


def _effect(
    where: str, kind: str, target: str, entry: Mapping[str, Any], priors: Priors
) -> Effect | None:
    """The effect on one target; None where its parameter is fixed and gives no scale."""
    parameters = []
    for template, table in entry["parameters"].items():
        key = template.format(target=target)
        own = f"{where}.parameters.{template}"
        if table.get("role") not in ROLES:
            raise InputError(
                f"{own}.role", " or ".join(ROLES), repr(table.get("role")), "say which it is"
            )
        keywords = {k: v for k, v in table.items() if k not in _OWN_KEYS}
        if "times_prior" in table:
            sd = _prior_sd(priors, key)
            if sd is None:
                return None
            keywords |= {"loc": 0.0, "scale": float(table["times_prior"]) * sd}
        distribution = Distribution(
            table["dist"], keywords, table.get("low"), table.get("high"), where=own
        )
        departure = table["role"] == "departure"
        parameters.append(
            EffectParameter(
                f"{'departure' if departure else 'effect'}:{kind}:{target}:{key}",
                key,
                str(table["unit"]),
                distribution,
                departure,
            )
        )
    name = f"{kind}:{target}" if target else kind
    sizes = OSCILLATION_SIZES if kind == "flexible_mode" else tuple(p.key for p in parameters)
    form_error = _form_error(where, entry, target, sizes)
    return Effect(name, kind, target, tuple(parameters), 0.0, tuple(entry["inputs"]), form_error)


def _form_error(
    where: str, entry: Mapping[str, Any], target: str, sizes: Sequence[str]
) -> tuple[tuple[str, float], ...]:
    table = entry.get("form_error", {})
    if not isinstance(table, dict):
        raise InputError(
            f"{where}.form_error", "a table of shares by size", repr(table), "write one, or none"
        )
    shares = {key.replace("{target}", target): share for key, share in table.items()}
    for key, share in shares.items():
        if key not in sizes:
            raise InputError(
                f"{where}.form_error.{key}", "a size of the effect", repr(key), nearest(key, sizes)
            )
        if isinstance(share, bool) or not isinstance(share, int | float) or not 0 <= share < 1:
            raise InputError(
                f"{where}.form_error.{key}",
                "a share of the size, 0 to 1",
                repr(share),
                "give the standard deviation of what the form leaves out, over the size",
            )
    return tuple((key, float(share)) for key, share in shares.items())


def _prior_sd(priors: Priors, name: str) -> float | None:
    prior = priors.parameters.get(name)
    if prior is None or prior.distribution is None:
        return None
    return prior.distribution.sd()
