"""Naming: evidence and probability of every cause, second causes, what cannot be told apart."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from cassini_bayes.computing.arviz_import import arviz
from cassini_bayes.computing.processes import in_processes
from cassini_bayes.diagnosis.evidence import (
    FEW_DRAWS,
    MARGIN_NATS,
    Say,
    Weighed,
    by_laplace,
    drawn,
    sampled,
    score,
    weigh_beside,
)
from cassini_bayes.diagnosis.extended import (
    Case,
    Hypothesis,
    Oscillation,
    compact,
    extend,
    none_hypothesis,
    unknown_hypothesis,
)
from cassini_bayes.diagnosis.innovations import EventRows, Linear, innovations
from cassini_bayes.diagnosis.modes import Mode, baseline_mode
from cassini_bayes.diagnosis.oscillation import (
    case_of,
    find_oscillation,
    flexible_case,
    motions_of,
)
from cassini_bayes.diagnosis.search import Sought, near_mode, renewed
from cassini_bayes.effects.catalogue import Catalogue, Effect

Array = NDArray[np.float64]
NEAR_NATS: Final = 10.0
MOST_DRAWN: Final = 3
DRAWS: Final = 2_000
SECOND_CAUSE_NATS: Final = 4.0
CONFOUNDED_NATS: Final = 3.0
ALIKE_NATS: Final = 5.0
BENT: Final = 5.0  # prior standard deviations of the baseline's parameters
TOGETHER: Final = 4
GAINED_ALIKE: Final = 0.1  # of what the best has gained
HOPED_NATS: Final = 10.0  # by which an oscillation's score may be short of its evidence
UNKNOWN_STARTS: Final = (-3.0, -1.5, 0.0, 1.5, 3.0)


@dataclass(frozen=True)
class Verdict:
    """Everything weighed, most probable first, with probabilities that add up to one.

    ``innovations`` and ``linear`` are the baseline's at its mode (None without telemetry);
    ``pair`` is the best two causes together where the second one earned its place, ``pair_alike``
    names the seconds that gain as much beside the same first.
    """

    case: Case
    catalogue: Catalogue
    weighed: tuple[Weighed, ...]
    log_probabilities: Array
    none: Weighed
    unknown: Weighed
    oscillation: Oscillation | None
    linear: Linear | None
    rows: tuple[EventRows, ...]
    pair: Weighed | None
    pair_alike: tuple[str, ...] = ()

    @property
    def probabilities(self) -> dict[str, float]:
        """Posterior probability of every cause by name."""
        values = np.exp(self.log_probabilities)
        return {w.name: float(p) for w, p in zip(self.weighed, values, strict=True)}

    @property
    def best(self) -> Weighed:
        """The most probable hypothesis."""
        return self.weighed[0]

    @property
    def best_cause(self) -> Weighed:
        """The most probable real cause: what a second one is looked for beside."""
        return next(w for w in self.weighed if w.hypothesis.effects)

    def confounded_with(self, name: str) -> tuple[str, ...]:
        """Real causes that these data cannot tell from a named one (:func:`is_alike`)."""
        own = next(w for w in self.weighed if w.name == name)
        if not own.hypothesis.effects:
            return ()
        return tuple(
            w.name
            for w in self.weighed
            if w.name != name and w.hypothesis.effects and is_alike(w, own)
        )


def is_alike(one: Weighed, other: Weighed) -> bool:
    """Whether the data cannot tell two causes apart.

    Evidence within three nats; or within five where the best fits are within three, so that most
    of the difference is what more parameters cost: a steady torque of three sizes fits whatever a
    leak does.
    """
    apart = abs(one.net_evidence - other.net_evidence)
    return apart < CONFOUNDED_NATS or (
        apart < ALIKE_NATS and abs(one.mode.fit - other.mode.fit) < CONFOUNDED_NATS
    )


def name_causes(
    case: Case,
    catalogue: Catalogue,
    rng: np.random.Generator,
    *,
    pairs: bool = True,
    say: Say | None = None,
    workers: int = 1,
) -> Verdict:
    """Weigh ``none``, ``unknown`` and every cause of the catalogue.

    Parameters
    ----------
    case
        The events, reduced.
    catalogue
        Causes with the priors of their sizes.
    rng
        For the importance draws.
    pairs
        Whether to look for a second cause.
    say
        Told how far it got.
    workers
        Processes among which causes are shared out; the verdict does not depend on it.
    """
    tell = say if say is not None else _silent
    full = none_hypothesis(case, catalogue)
    none = compact(full)
    base = baseline_mode(none.log_density, none.dimension)
    tell(f"none: log evidence {base.log_evidence:.1f}")
    unknown = compact(unknown_hypothesis(case, catalogue))
    start = _unknown_start(none, unknown, base)
    linear, rows = (None, []) if not case.sources else innovations(case, full, base.point)
    effects = [effect for effect in catalogue.effects if effect.kind != "flexible_mode"]
    hypotheses = [compact(extend(full, [effect], case)) for effect in effects]
    left = None if linear is None else (linear, rows)
    first: list[Callable[[], Any]] = [
        partial(baseline_mode, unknown.log_density, unknown.dimension, start),
        partial(_look_for_oscillation, case, catalogue, (full, base.point), left),
    ]
    (unknown_mode, oscillation), near = _beside(first, hypotheses, base, tell, workers)
    tell(f"unknown: {unknown_mode.log_evidence - base.log_evidence:+.1f} nats")
    weighed = [by_laplace(none, base), by_laplace(unknown, unknown_mode)]
    floor = unknown_mode.log_evidence - MARGIN_NATS
    causes = weigh_beside(hypotheses, near, base, tell, workers, floor)
    if causes and _is_bent(base) and not _is_mended(causes, unknown_mode):
        tell(
            "no cause mends a baseline that bent: searched from the centre of the prior, best first"
        )
        causes = _all_from_centre(causes, base, unknown_mode, workers)
    weighed += causes
    if oscillation is not None:
        best = max(own.log_evidence for own in weighed)
        weighed.append(_flexible(case, catalogue, oscillation, (), base, best))
    weighed = _sample_near(weighed, rng, workers)
    weighed, log_probabilities = _ranked(weighed)
    verdict = Verdict(
        case,
        catalogue,
        tuple(weighed),
        log_probabilities,
        next(w for w in weighed if w.name == "none"),
        next(w for w in weighed if w.name == "unknown"),
        oscillation,
        linear,
        tuple(rows),
        None,
    )
    if pairs and verdict.best is not verdict.none:
        tell(f"looking for a second cause beside {verdict.best_cause.name}")
        pair, alike = second_cause(verdict, rng, workers)
        verdict = replace(verdict, pair=pair, pair_alike=alike)
    return verdict


def _silent(text: str) -> None:
    del text


def _beside(
    first: Sequence[Callable[[], Any]],
    hypotheses: Sequence[Hypothesis],
    base: Mode,
    say: Say,
    workers: int,
    worth: float = -np.inf,
) -> tuple[list[Any], list[Sought]]:
    """Results of some work, and of the causes' searches beside the baseline, shared out together.

    The work comes first, as it takes as long as many searches. Causes that do not gain ``worth``
    (nats) do not matter.
    """

    def told(count: int) -> None:
        if count > len(first) and (count - len(first)) % 10 == 0:
            say(f"{count - len(first)} of {len(hypotheses)} causes weighed")

    near = [partial(near_mode, own, base, worth) for own in hypotheses]
    parts: list[Callable[[], Any]] = [*first, *near]
    # importance draws need ArviZ, whose import takes most of a second
    found: list[Any] = in_processes(lambda part: part(), parts, workers, told, arviz)
    return found[: len(first)], found[len(first) :]


def _is_bent(mode: Mode) -> bool:
    return bool(np.abs(mode.point).max() > BENT)


def _is_mended(causes: Sequence[Weighed], unknown: Mode) -> bool:
    """Whether the best cause beats ``unknown`` with parameters that are not far out themselves."""
    best = max(causes, key=lambda own: own.log_evidence)
    return best.log_evidence > unknown.log_evidence and not _is_bent(best.mode)


def _all_from_centre(
    causes: Sequence[Weighed], base: Mode, unknown: Mode, workers: int
) -> list[Weighed]:
    """Causes searched from the centre of the prior, the best first, until one mends the baseline.

    They go in parts of at most :data:`TOGETHER` that have gained nearly alike, so that what the
    data cannot tell apart is searched alike.
    """
    found = list(causes)
    order = sorted(range(len(found)), key=lambda i: -found[i].log_evidence)
    while order:
        best = causes[order[0]].log_evidence
        least = best - GAINED_ALIKE * max(best - base.log_evidence, 0.0)
        part = [i for i in order[:TOGETHER] if causes[i].log_evidence >= least]
        order = order[len(part) :]
        modes = in_processes(lambda i: _higher_from_centre(causes[i]), part, workers)
        for i, mode in zip(part, modes, strict=True):
            if mode is not None:
                found[i] = by_laplace(causes[i].hypothesis, mode)
        if _is_mended(found, unknown):
            break
    return found


def _higher_from_centre(weighed: Weighed) -> Mode | None:
    """The mode of a search that does not begin where the baseline was bent to, if it is higher."""
    hypothesis = weighed.hypothesis
    found = baseline_mode(hypothesis.log_density, hypothesis.dimension)
    return found if found.log_evidence > weighed.log_evidence else None


def _unknown_start(none: Hypothesis, unknown: Hypothesis, base: Mode) -> Array:
    """The baseline's mode in the coordinates of ``unknown``, its own new ones where best."""
    at = dict(zip(none.model.space.names, base.point, strict=True))
    own = np.array([name not in at for name in unknown.model.space.names])
    point = np.array([at.get(name, 0.0) for name in unknown.model.space.names])
    tried = np.where(own, np.array(UNKNOWN_STARTS)[:, None], point)
    return np.asarray(tried[int(np.nanargmax(unknown.log_density(tried)))])


def _look_for_oscillation(
    case: Case,
    catalogue: Catalogue,
    weighed: tuple[Hypothesis, Array],
    left: tuple[Linear, Sequence[EventRows]] | None,
) -> Oscillation | None:
    """The oscillation in the innovations that a hypothesis leaves at a point."""
    if left is None or "flexible_mode" not in catalogue.names:
        return None
    (hypothesis, point), (linear, rows) = weighed, left
    parameters = hypothesis.model.space.to_parameters(point)
    inertia = [float(parameters[f"inertia_{axis}{axis}_kg_m2"]) for axis in "xyz"]
    scale = {
        p.key: float(p.distribution.keywords["scale"])
        for p in catalogue.effect("flexible_mode").parameters
    }
    scales = scale["cosine_rad_s"], scale["inertia_fraction"]
    return find_oscillation(rows, motions_of(case), linear, np.array(inertia), scales)


def _flexible(
    case: Case,
    catalogue: Catalogue,
    oscillation: Oscillation,
    beside: Sequence[Effect],
    base: Mode,
    best: float,
) -> Weighed:
    """``flexible_mode`` at the line found, beside other effects or alone."""
    own, shown = catalogue.effect("flexible_mode"), flexible_case(case, oscillation)
    hypothesis = compact(extend(none_hypothesis(shown, catalogue), [*beside, own], shown))
    near = [near_mode(hypothesis, base)]
    (weighed,) = weigh_beside([hypothesis], near, base, _silent, floor=best - MARGIN_NATS)
    return weighed


def _sample_near(
    weighed: Sequence[Weighed], rng: np.random.Generator, workers: int
) -> list[Weighed]:
    """Importance-sampled evidence for the hypotheses nearest the best, more draws for the best."""
    found = list(weighed)
    scores = [score(w) for w in found]
    least = max(scores) - NEAR_NATS
    near = [i for i, score in enumerate(scores) if score + found[i].unsure > least]
    found = drawn(found, near, FEW_DRAWS, rng, workers)
    best = sorted(near, key=lambda i: -score(found[i]))[:MOST_DRAWN]
    return drawn(found, best, DRAWS, rng, workers)


def _ranked(weighed: Sequence[Weighed]) -> tuple[list[Weighed], Array]:
    scores = np.array([score(w) for w in weighed])
    order = np.argsort(-scores, kind="stable")
    return [weighed[i] for i in order], scores[order] - float(logsumexp(scores))


def second_cause(
    verdict: Verdict, rng: np.random.Generator, workers: int = 1
) -> tuple[Weighed | None, tuple[str, ...]]:
    """The best pair with the best cause, if the second one earns its place, and seconds like it.

    It has to gain four nats over the first cause alone; where ``unknown`` is more probable than any
    cause, the pair has to be more probable than ``unknown`` as well.
    """
    best, catalogue = verdict.best_cause, verdict.catalogue
    (first,) = best.hypothesis.effects
    line = best.hypothesis.oscillation
    case = case_of(verdict.case, best.hypothesis)
    full = extend(none_hypothesis(case, catalogue), [first], case)
    base = best.mode if best.mode.is_whole else renewed(best.hypothesis, best.mode)
    pairs = [compact(extend(full, [effect], case)) for effect in _others(catalogue, first)]
    least = best.net_evidence + SECOND_CAUSE_NATS
    looks = []
    if line is None and case.sources:
        at = best.hypothesis, base.point
        looks = [partial(_look_for_oscillation, case, catalogue, at, innovations(case, *at))]
    further, near = _beside(looks, pairs, base, _silent, workers, SECOND_CAUSE_NATS)
    tried = weigh_beside(pairs, near, base, _silent, workers, least)
    tried += [
        _flexible(case, catalogue, own, [first], base, base.log_evidence)
        for own in further
        if own is not None and own.log_gain + HOPED_NATS > own.log_looks + SECOND_CAUSE_NATS
    ]
    tried = _sample_pairs(tried, least, rng, workers)
    found = max(tried, key=lambda own: own.net_evidence, default=None)
    if found is None or found.net_evidence < least:
        return None, ()
    pair = sampled(found, rng, DRAWS)
    if not verdict.best.hypothesis.effects and score(pair) < score(verdict.best):
        return None, ()
    alike = [
        weighed.hypothesis.effects[-1].name
        for weighed in tried
        if weighed is not found and is_alike(weighed, found)
    ]
    return pair, tuple(alike)


def _sample_pairs(
    tried: Sequence[Weighed], least: float, rng: np.random.Generator, workers: int
) -> list[Weighed]:
    """Importance draws for pairs that could be the best, or as good, and reach ``least``."""
    found = list(tried)
    reach = [own.net_evidence + own.unsure + CONFOUNDED_NATS for own in found]
    bar = max([least, *(own.net_evidence for own in found)])
    return drawn(found, [i for i, own in enumerate(reach) if own > bar], FEW_DRAWS, rng, workers)


def _others(catalogue: Catalogue, first: Effect) -> list[Effect]:
    return [
        effect
        for effect in catalogue.effects
        if effect.name != first.name and effect.kind != "flexible_mode"
    ]
