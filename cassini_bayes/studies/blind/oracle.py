"""An exact linear-Gaussian classifier that knows what a diagnosis has to find out.

At the baseline's mode the data are y = X β + M_j s + noise, whitened, with β ~ N(0, P⁻¹): so
y ~ N(M_j s, V) under cause j of size s (in prior scales), V = 1 + X P⁻¹ Xᵀ. Everything that y says
of all causes is b = Mᵀ V⁻¹ y, and b ~ N(G s, G) with the Gram matrix G = Mᵀ V⁻¹ M. Under cause j,

    log Z_j = ½ b_jᵀ (1 + G_jj)⁻¹ b_j − ½ log det(1 + G_jj)    for s ~ N(0, 1),

and for one s between bounds that times the posterior's share of the bounds over the prior's. The
attitude channel's information on rate bias and scale adds to G and b. docs/topics/criticism.md §6.

Over conditions G and b are those of the whole likelihood
(:mod:`cassini_bayes.studies.blind.likelihood_oracle`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.special import log_ndtr, logsumexp

from cassini_bayes.balance.linearised import fitted_away
from cassini_bayes.computing.arrays import Array, Places
from cassini_bayes.diagnosis.events import Events
from cassini_bayes.diagnosis.hypotheses import Hypothesis, extend, none_hypothesis
from cassini_bayes.diagnosis.innovations import linearise
from cassini_bayes.diagnosis.modes import Mode
from cassini_bayes.diagnosis.verdict import CONFOUNDED_NATS
from cassini_bayes.effects.changes import AXES
from cassini_bayes.effects.effect import Effect
from cassini_bayes.effects.oscillation import Oscillation
from cassini_bayes.priors.distributions import Distribution
from cassini_bayes.studies.blind.oscillations import hidden_oscillation
from cassini_bayes.studies.blind.rate_information import RATE_KINDS, combined, rate_information
from cassini_bayes.studies.blind.sizes import NULL_VALUES, path_to

KINKED: Final = ("pulse_shape", "time_offset")
"""Kinds whose change of the data has another direction on each side of zero."""
KINK: Final = 5e-3  # prior scales off zero, where a kinked effect's slopes are taken
BEST: Final = 3
MOST_ALIKE: Final = 4  # names of a group: more say next to nothing
DRAWS: Final = 500


@dataclass(frozen=True)
class Side:
    """A cause, or one side of it: its columns among all, bounds of its size, log prior."""

    name: str
    places: tuple[int, ...]
    low: float
    high: float
    log_prior: float


@dataclass(frozen=True)
class Classifier:
    """All causes of one flight: G (q, q), b (q,) of the flight's own data, and the causes."""

    gram: Array
    score: Array
    sides: tuple[Side, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the causes."""
        return tuple(dict.fromkeys(side.name for side in self.sides))

    def log_scores(self, scores: Array) -> Array:
        """Log of evidence times prior (n, causes) for statistics b (n, q)."""
        each = [side.log_prior + log_evidence(self.gram, scores, side) for side in self.sides]
        return self._by_name(each)

    def _by_name(self, of_sides: Sequence[Array | float]) -> Array:
        """Log of the sum over sides of every cause, (…, causes)."""
        sides = list(zip(of_sides, self.sides, strict=True))
        return np.stack(
            [logsumexp([v for v, s in sides if s.name == n], axis=0) for n in self.names], axis=-1
        )

    def ranks(self, scores: Array, name: str) -> Places:
        """Place (n,) of a cause among all of them, from 0."""
        scores = self.log_scores(scores)
        true = scores[:, [self.names.index(name)]]
        return np.asarray((scores > true).sum(1), dtype=np.int64)

    def rank_by_data(self, name: str) -> int:
        """Place of a cause by the flight's own data."""
        return int(self.ranks(self.score[None], name)[0])

    def expected(self, name: str, size: Array, rng: np.random.Generator) -> float:
        """How often a cause of this size (its parameters in prior scales) is among the best."""
        side = self._side_of(name, size)
        mean = self.gram[:, side.places] @ size
        values, vectors = np.linalg.eigh(self.gram)
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        draws = mean + rng.standard_normal((DRAWS, len(mean))) @ root.T
        return float((self.ranks(draws, name) < BEST).mean())

    def group(self, name: str, size: Array) -> tuple[str, ...]:
        """The cause and up to three more that are as likely on the data that it has on average.

        As likely or likelier: log evidence at most three nats below, as the diagnosis counts them.
        One that explains the same data better is no easier to tell from it.
        """
        mean = self.gram[:, self._side_of(name, size).places] @ size
        prior = self._by_name([side.log_prior for side in self.sides])
        evidence = dict(zip(self.names, self.log_scores(mean[None])[0] - prior, strict=True))
        own = evidence.pop(name)
        alike = [n for n, value in evidence.items() if value > own - CONFOUNDED_NATS]
        return (name, *sorted(alike, key=lambda n: -evidence[n])[: MOST_ALIKE - 1])

    def _side_of(self, name: str, size: Array) -> Side:
        named = [side for side in self.sides if side.name == name]
        return next((s for s in named if s.low <= size[0] <= s.high), named[0])


def log_evidence(gram: Array, scores: Array, side: Side) -> Array:
    """log Z (n,) of a cause against none, at statistics (n, q)."""
    places = list(side.places)
    precision = np.eye(len(places)) + gram[np.ix_(places, places)]
    b = scores[:, places]
    mean = np.linalg.solve(precision, b.T).T
    value = 0.5 * (b * mean).sum(1) - 0.5 * np.linalg.slogdet(precision)[1]
    if len(places) > 1:
        return np.asarray(value)
    width = precision[0, 0] ** -0.5
    inside = _log_between((side.low - mean[:, 0]) / width, (side.high - mean[:, 0]) / width)
    return np.asarray(value + inside - _log_between(np.array(side.low), np.array(side.high)))


def _log_between(low: Array, high: Array) -> Array:
    """log(Φ(high) − Φ(low)), on the side where it keeps its digits."""
    turned = low > 0.0
    a, b = np.where(turned, -high, low), np.where(turned, -low, high)
    with np.errstate(divide="ignore"):
        return np.asarray(log_ndtr(b) + np.log1p(-np.exp(log_ndtr(a) - log_ndtr(b))))


def classifier(
    events: Events, base: Mode, hidden: Mapping[str, float], line: Oscillation | None = None
) -> Classifier:
    """Build the classifier on a flight, linear about the baseline's mode.

    Parameters
    ----------
    events, base
        The flight with its causes, and the baseline's mode on it.
    hidden
        Parameters of what is hidden, by key: a time constant is known, not searched for.
    line
        Known line of an oscillation; without it no oscillation is among the causes.
    """
    none = none_hypothesis(events)
    linear, _ = linearise(none, base.point)
    # departures count from the centre of the prior, not from the mode
    target = linear.about_prior_mean(base.point)
    sides: list[Side] = []
    columns: list[Array] = []
    for effect in events.catalogue.effects:
        settled, baseline = effect, none
        if effect.needs_search:
            if line is None:
                continue
            settled = replace(effect, search_result=line)
            baseline = none_hypothesis(events.with_columns_of([settled]))
        for sign in (1.0, -1.0) if effect.kind.name in KINKED else (0.0,):
            columns.append(_columns(baseline, base, settled, sign, hidden))
            first = sum(part.shape[1] for part in columns[:-1])
            sides.append(side_of(effect, sign, first))
    every = np.concatenate(columns, axis=1)
    weighed = np.asarray(fitted_away(linear, every))
    gram, score = every.T @ weighed, weighed.T @ target
    _add_attitude(gram, score, events, sides)
    return Classifier(gram, score, tuple(sides))


def sizes_of(effect: Effect, values: Mapping[str, float], truth: Mapping[str, float]) -> Array:
    """A hidden effect's parameters in prior scales, as the classifier's columns count them."""
    if effect.kind.search is not None:
        values = hidden_oscillation(values)[1]
    sizes = path_to(effect, values, truth).direction
    return np.array(
        [sizes[p.key] / p.distribution.scale for p in effect.parameters if p.key in sizes]
    )


def _null(key: str) -> float:
    return NULL_VALUES.get(key, 0.0)


def side_of(effect: Effect, sign: float, first: int) -> Side:
    """An effect, or its side of a sign, with its columns from ``first`` on."""
    sized = [p for p in effect.parameters if p.distribution.name != "lognorm"]
    scale = sized[0].distribution.scale
    low, high = ((end - _null(sized[0].key)) / scale for end in sized[0].distribution.support)
    low, high = (
        (max(low, 0.0), high) if sign > 0 else (low, min(high, 0.0)) if sign else (low, high)
    )
    share = 0.5 if sign else 1.0
    places = tuple(range(first, first + len(sized)))
    return Side(effect.name, places, low, high, float(np.log(share * effect.prior_probability)))


def about_null(
    effect: Effect, sign: float, hidden: Mapping[str, float]
) -> tuple[Effect, list[float]]:
    """The effect with normal sizes about none, and standard values of all its parameters there.

    ``sign``: on which side of none a kinked one stands. Time constants are those that are hidden.
    """
    plain, rest = [], []
    for p in effect.parameters:
        if p.distribution.name == "lognorm":
            known = hidden.get(p.key)
            rest.append(0.0 if known is None else float(p.distribution.standard_of(known)))
            plain.append(p)
            continue
        scale = p.distribution.scale
        middle = _null(p.key) + sign * KINK * scale
        plain.append(replace(p, distribution=Distribution("norm", {"loc": middle, "scale": scale})))
        rest.append(0.0)
    return replace(effect, parameters=tuple(plain)), rest


def _columns(
    none: Hypothesis,
    base: Mode,
    effect: Effect,
    sign: float,
    hidden: Mapping[str, float],
) -> Array:
    """Whitened change of the data (m, q) per prior scale of every parameter of an effect."""
    changed, rest = about_null(effect, sign, hidden)
    extended = extend(none, [changed])
    linear, _ = linearise(extended, np.concatenate([base.point, rest]))
    d = len(base.point)
    sized = [i for i, p in enumerate(effect.parameters) if p.distribution.name != "lognorm"]
    return linear.columns.chosen(np.array([d + i for i in sized], dtype=np.intp)).written_out()


def _add_attitude(gram: Array, score: Array, events: Events, sides: Sequence[Side]) -> None:
    """Add what attitude against integrated rates says of rate bias and scale."""
    rates = combined([rate_information(event.samples) for event in events.telemetry])
    for side in sides:
        kind, _, axis = side.name.partition(":")
        if kind not in RATE_KINDS:
            continue
        i, a = side.places[0], AXES.index(axis)
        mine = RATE_KINDS.index(kind)
        score[i] += _scale(events, side.name) * rates.linear[a, mine]
        for other in sides:
            theirs, _, same = other.name.partition(":")
            if theirs in RATE_KINDS and same == axis:
                both = _scale(events, side.name) * _scale(events, other.name)
                j, other_kind = other.places[0], RATE_KINDS.index(theirs)
                gram[i, j] += both * rates.precision[a, mine, other_kind]


def _scale(events: Events, name: str) -> float:
    return events.catalogue.effect(name).parameters[0].distribution.scale
