"""The momentum balance of telemetry and totals as a case to diagnose."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Final, get_type_hints

import numpy as np
import pandas as pd

from cassini_bayes.balance.linearised import InnovationRows
from cassini_bayes.computing.arrays import Array
from cassini_bayes.computing.arviz_import import arviz
from cassini_bayes.computing.log import Log, silent
from cassini_bayes.diagnosis.case import (
    UNKNOWN,
    Case,
    Discrepancies,
    Fits,
    Ranking,
    Size,
    Weighed,
    Work,
)
from cassini_bayes.diagnosis.correlations import InnovationTests, innovation_tests, strongest
from cassini_bayes.diagnosis.discrepancy import Curve, curves_of
from cassini_bayes.diagnosis.drafts import Draft, drafted
from cassini_bayes.diagnosis.events import Events
from cassini_bayes.diagnosis.evidence import (
    FEW_DRAWS,
    MARGIN_NATS,
    by_laplace,
    importance_sampled,
    weigh_extensions,
    with_draws,
)
from cassini_bayes.diagnosis.gain import fits_to_hold_out, held_out
from cassini_bayes.diagnosis.hypotheses import (
    EFFECT_FARTHEST,
    Hypothesis,
    compact,
    extend,
    none_hypothesis,
    unknown_hypothesis,
)
from cassini_bayes.diagnosis.innovations import examined, innovations, left_by
from cassini_bayes.diagnosis.modes import Mode, find_mode, highest
from cassini_bayes.diagnosis.nuisances import Trade, nuisance_shifts, traded
from cassini_bayes.diagnosis.onsets import Beginnings, gains_about
from cassini_bayes.diagnosis.other_starts import (
    from_best,
    from_best_beginning,
    from_centre,
    is_far_from_prior,
    is_mended,
)
from cassini_bayes.diagnosis.overlay import Overlay, overlays
from cassini_bayes.diagnosis.p_value import p_value
from cassini_bayes.diagnosis.refit import fit_extended
from cassini_bayes.diagnosis.score import HeldOut
from cassini_bayes.diagnosis.search import ModeSearch, newton_search, with_whole_curvature
from cassini_bayes.diagnosis.second_reckoning import (
    gain_of_unknown,
    leads,
    reckoned_again,
    with_lesser_gain,
)
from cassini_bayes.diagnosis.separation import separating_measurement
from cassini_bayes.diagnosis.shared_torque import torque_again
from cassini_bayes.diagnosis.sizes import mixed, size_draws, summarised
from cassini_bayes.diagnosis.spectrum import Spectrum, spectra
from cassini_bayes.diagnosis.stages import SERIAL, StageRunner
from cassini_bayes.diagnosis.symptoms import find_symptoms
from cassini_bayes.diagnosis.thruster_forms import with_thruster_forms
from cassini_bayes.diagnosis.verdict import CONFOUNDED_NATS, SECOND_CAUSE_NATS
from cassini_bayes.diagnosis.visible import visible_record
from cassini_bayes.diagnosis.widths import by_width, change_of_evidence
from cassini_bayes.effects.effect import Effect, Remainder, SearchResult, settled_for
from cassini_bayes.effects.registry import Kinds
from cassini_bayes.files.checkpoint import CheckpointStore

Candidate = Weighed[Hypothesis]
NEAR_NATS: Final = 6.0
"""Behind the best, up to which importance draws decide: less is a probability below 0.3 %, and
Laplace's evidence agreed with 200 draws to 0.11 nats (root mean square; 0.54 at most) in 90 causes
of two diagnoses with nothing hidden."""
MOST_DRAWN: Final = 3  # of the best: what a reader compares
DRAWS: Final = 2_000  # of these: 0.015 nats at an efficiency of 0.7, and sizes by their draws
HOPED_NATS: Final = 10.0
"""By which what a search found may be short of its evidence: judgement, its score is that of a
linear model about one point, and the fit moves on."""
SHORT_NATS: Final = 5.0
"""By which a second cause may gain more than its linear model beside the first says: 2.2 at most in
97 pairs of two diagnoses, 0.9 in all but four."""
HIGHER_NATS: Final = 0.5
"""By which another mode must be better: judgement, Laplace's evidence is good to 0.1, and all
searches begin again."""
EDGE: Final = 0.5
"""Prior standard deviations from the wall at which a size is said to be there: a posterior that
fills one has a thousandth of its prior's width, and lies at the wall itself."""
UNKNOWN_STARTS: Final = (-3.0, -1.5, 0.0, 1.5, 3.0)
"""Standard normals tried for the noise of ``unknown``: its prior covers a factor of 37 either
way."""


@dataclass(frozen=True)
class BalanceDetail:
    """What the figures of a balance need: innovations and tests of both models, channels, a trade.

    ``extended_rows`` is empty without a cause.
    """

    rows: tuple[InnovationRows, ...]
    extended_rows: tuple[InnovationRows, ...]
    before: InnovationTests
    after: InnovationTests
    overlays: tuple[Overlay, ...]
    trade: Trade | None
    spectra: tuple[Spectrum, ...]


@dataclass(frozen=True)
class BalanceCase(Case[Hypothesis]):
    """Events and the hypotheses on their balance (:mod:`cassini_bayes.diagnosis.hypotheses`)."""

    events: Events
    unit = "nms"

    @property
    def event_ids(self) -> tuple[str, ...]:
        """All events, totals rows first."""
        return self.events.ids

    @property
    def findings(self) -> Sequence[str]:
        """Of reading the events."""
        return self.events.findings

    @property
    def digests(self) -> Mapping[str, str]:
        """Of every telemetry event and its channel map, the spacecraft, an earlier fit."""
        result, known = {}, self.events.priors
        for event in self.events.telemetry:
            if event.digest:
                result[f"event {event.id}"] = event.digest
            if event.channels:
                result[f"channels of {event.id}"] = event.channels.digest
        result[f"spacecraft {known.spacecraft.name}"] = known.spacecraft.digest
        if known.earlier is not None:
            result[known.earlier.path] = known.earlier.digest
        return result

    def weigh(
        self, rng: np.random.Generator, log: Log, workers: StageRunner = SERIAL
    ) -> list[Candidate]:
        """Evidence by searches from the baseline's mode, by draws near the best."""
        events = self.events
        full = none_hypothesis(events)
        none = compact(full)
        density, starts = none.log_density, none.model.starts
        find = partial(find_mode, density, none.dimension)
        base = highest(workers.results("", [partial(find, at) for at in starts.points], Mode))
        beside = [partial(find, at) for at in starts.beside(base.point)]
        base = highest([base, *workers.results("", beside, Mode)])
        log(f"none: log evidence {base.log_evidence:.1f}")
        unknown = compact(unknown_hypothesis(events))
        direct = [effect for effect in events.catalogue.effects if not effect.needs_search]
        higher: Mode | None = base
        while higher is not None:
            base = higher
            start = _unknown_start(none, unknown, base)
            remainder = innovations(full, base.point) if events.telemetry else None
            beginnings = Beginnings.of(full, base.point, remainder, direct, events)
            hypotheses = [compact(extend(full, [effect])) for effect in beginnings.likely()]
            to_find = [] if remainder is None else _to_find(events, remainder)
            first = [partial(find_mode, unknown.log_density, unknown.dimension, start)]
            (unknown_mode, *settled_by), near = _side_by_side(
                first, to_find, hypotheses, base, "searches for causes", workers
            )
            higher = _higher_beside_unknown(none, base, unknown, unknown_mode)
            if higher is not None:
                gained = higher.log_evidence - base.log_evidence
                log(f"none: {gained:+.1f} nats beside the mode of unknown: searched again from it")
        log(f"unknown: {unknown_mode.log_evidence - base.log_evidence:+.1f} nats")
        weighed = [
            replace(by_laplace(none, base), remainder=remainder),
            by_laplace(unknown, unknown_mode),
        ]
        floor = unknown_mode.log_evidence - MARGIN_NATS
        causes = weigh_extensions(hypotheses, near, base, log, workers, floor)
        gained = max((c.log_evidence for c in causes), default=floor) - base.log_evidence
        further = [compact(extend(full, [effect])) for effect in beginnings.missed(gained)]
        if further:
            what = "searches for further beginnings"
            _, near = _side_by_side((), (), further, base, what, workers)
            causes += weigh_extensions(further, near, base, log, workers, floor)
        if causes and is_far_from_prior(base.point) and not is_mended(causes, unknown_mode):
            log(
                "no cause mends a baseline that bent: searched from the centre of the prior, "
                "best first"
            )
            gains = gains_about(full, np.zeros(len(base.point)), causes, events)
            causes = from_centre(causes, gains, unknown_mode, workers)
        causes = from_best(causes, base, workers)
        weighed += from_best_beginning(causes, workers)
        for (effect, _), settled in zip(to_find, settled_by, strict=True):
            if settled is not None:
                best = max(w.log_evidence for w in weighed)
                result = effect.settled_by(settled)
                weighed.append(self._settled(result, (), base, best, workers))
        believed = events.catalogue.unknown.torque_noise
        if is_known := leads(weighed) == UNKNOWN:  # before draws, for what is near the best
            gained = gain_of_unknown(weighed[1], weighed[0], believed)
            weighed[1] = with_lesser_gain(weighed[1], weighed[0], gained)
        sampled = _sampled_near_best(weighed, rng, workers)
        if is_known:  # draws have other evidences
            sampled[1] = with_lesser_gain(sampled[1], sampled[0], gained)
        summed = beginnings.summed(sampled, sampled[0].net_evidence)
        again = reckoned_again(torque_again(summed), believed, unknown_too=not is_known)
        return with_thruster_forms(again, events.catalogue.unknown)

    def _settled(
        self,
        effect: Effect,
        beside: Sequence[Effect],
        base: Mode,
        best: float,
        workers: StageRunner,
    ) -> Candidate:
        """An effect as its search has settled it, beside other effects or alone."""
        effects = [*beside, effect]
        events = self.events.with_columns_of(effects)
        hypothesis = compact(extend(none_hypothesis(events), effects))
        near = workers.results("", [partial(newton_search, hypothesis, base)], ModeSearch)
        least = best - MARGIN_NATS
        (weighed,) = weigh_extensions([hypothesis], near, base, silent, workers, least)
        return weighed

    def scores_at(
        self, width: float, verdict: Ranking[Hypothesis], _: np.random.Generator
    ) -> Mapping[str, float]:
        """By the draws that there are (:mod:`cassini_bayes.diagnosis.widths`)."""
        return {
            w.name: score + change_of_evidence(self.events, w, float(np.exp(score)), width)
            for w, score in zip(verdict.weighed, verdict.log_probabilities, strict=True)
        }

    def by_width(
        self, verdict: Ranking[Hypothesis], rng: np.random.Generator
    ) -> list[dict[str, Any]]:
        """By weighting the same draws."""
        return by_width(verdict, rng)

    def pairs(
        self, first: Candidate, least: float, rng: np.random.Generator, workers: StageRunner
    ) -> list[Candidate]:
        """By searches from the first cause's mode, by draws for what could be the best pair."""
        (effect,) = first.hypothesis.effects
        prior = self.events.catalogue.effect(effect.name).prior_probability
        effect = replace(effect, prior_probability=prior)
        events = self.events.with_columns_of([effect])
        full = extend(none_hypothesis(events), [effect])
        base = first.mode
        if not base.is_whole:
            base = with_whole_curvature(first.hypothesis, base)
        others = [e for e in events.catalogue.effects if e.name != effect.name]
        direct = [e for e in others if not e.needs_search]
        remainder = left_by(first) if events.telemetry else None
        beginnings = Beginnings.of(full, base.point, remainder, direct, events)
        seconds = beginnings.likely(SECOND_CAUSE_NATS - SHORT_NATS)
        pairs = [compact(extend(full, [e])) for e in seconds]
        to_find = []
        if remainder is not None and any(e.needs_search for e in others):
            to_find = [(e, work) for e, work in _to_find(events, remainder) if e in others]
        what = "searches for a second cause"
        settled_by, near = _side_by_side((), to_find, pairs, base, what, workers, SECOND_CAUSE_NATS)
        # pairs have the first cause's likeliest beginning; others count for them as for it alone,
        # and what a second reckoning takes off as well
        least -= first.net_evidence - first.own_evidence
        weighed = weigh_extensions(pairs, near, base, silent, workers, least)
        for (e, _), settled in zip(to_find, settled_by, strict=True):
            if settled is not None and _could_gain(settled, SECOND_CAUSE_NATS):
                second = e.settled_by(settled)
                best = base.log_evidence
                weighed.append(self._settled(second, [effect], base, best, workers))
        reach = [e.net_evidence + e.unsure + CONFOUNDED_NATS for e in weighed]
        bar = max([least, *(e.net_evidence for e in weighed)])
        which = [i for i, e in enumerate(reach) if e > bar]
        drawn = with_draws(weighed, which, FEW_DRAWS, rng, workers)
        drawn = beginnings.summed(drawn, first.own_evidence)
        return [
            replace(pair, summed=pair.summed + first.summed, withheld=first.withheld)
            for pair in drawn
        ]

    def confirmed(self, pair: Candidate, rng: np.random.Generator) -> Candidate:
        """With as many draws as the best causes have."""
        return importance_sampled(pair, rng, DRAWS)

    @property
    def kinds(self) -> Kinds:
        """Those of its catalogue."""
        return self.events.catalogue.kinds

    def sizes(self, weighed: Candidate, rng: np.random.Generator) -> Mapping[str, Size]:
        """From draws with what counters leave open."""
        return summarised(*mixed(partial(self.size_draws, rng=rng), weighed))

    def size_draws(
        self, weighed: Candidate, rng: np.random.Generator
    ) -> tuple[dict[str, Array], Array]:
        """Of the balance's model (:mod:`cassini_bayes.diagnosis.sizes`)."""
        return size_draws(weighed, rng)

    def settled(self, weighed: Candidate) -> Sequence[SearchResult]:
        """Of its effects."""
        return settled_for(weighed.hypothesis.effects)

    def refit(
        self,
        weighed: Candidate,
        folder: Path,
        seed: int,
        log: Log = silent,
        store: CheckpointStore | None = None,
    ) -> pd.DataFrame:
        """As an ordinary model (:mod:`.refit`)."""
        return fit_extended(weighed, folder, seed, log, store=store)

    def fits_to_hold_out(
        self, weighed: Candidate, log: Log = silent
    ) -> Sequence[Callable[[], Fits]]:
        """To all events, and to all but each."""
        return fits_to_hold_out(self.events, weighed, log)

    def held_out(
        self,
        weighed: Candidate,
        rng: np.random.Generator,
        log: Log = silent,
        fits: Sequence[Fits] | None = None,
    ) -> HeldOut | None:
        """Telemetry events or totals rows (:mod:`cassini_bayes.diagnosis.gain`)."""
        if fits is None:
            fits = [fit() for fit in self.fits_to_hold_out(weighed, log)]
        return held_out(self.events, weighed, rng, fits)

    def at_edge(self, weighed: Candidate) -> Sequence[str]:
        """Sizes at the wall of the search (:data:`.hypotheses.EFFECT_FARTHEST`)."""
        hypothesis = weighed.hypothesis
        keys = [f"{e.name}, {p.key}" for e in hypothesis.effects for p in e.parameters]
        size = np.abs(weighed.mode.point[hypothesis.sizes])
        return [
            f"{key}: as large as any size that is weighed, {EFFECT_FARTHEST:g} standard deviations "
            "of its prior: it may be larger, and its interval here is not one; give it a wider "
            "prior (a table of effects, --effects)"
            for key, own in zip(keys, size, strict=True)
            if own > EFFECT_FARTHEST - EDGE
        ]

    def examined(self, weighed: Candidate) -> Candidate:
        """With what a cause leaves of telemetry."""
        return examined(weighed) if self.events.telemetry and weighed.is_cause else weighed

    def rmse(self, weighed: Candidate) -> float | None:
        """RMS innovation, N m s; None for totals alone."""
        if weighed.remainder is None:
            return None
        values = np.concatenate([event.residual_n_m_s.ravel() for event in weighed.remainder.rows])
        return float(np.sqrt((values**2).mean()))

    def p_value(self, weighed: Candidate, rng: np.random.Generator) -> float | None:
        """Of the innovations; None for totals alone."""
        left = weighed.remainder
        if left is None:
            return None
        return p_value(left.linear, left.target, [event.time_s for event in left.rows], rng)

    def show(
        self, baseline: Candidate, extended: Candidate, rng: np.random.Generator
    ) -> Discrepancies:
        """Symptoms, closure, tests, what bends and trades, overlays; nothing for totals alone."""
        before = baseline.remainder
        if before is None:
            return Discrepancies()
        of_tests, of_trade = rng, rng.spawn(1)[0]
        after = extended.remainder or before
        tests = extended_tests = innovation_tests(before.linear, before.rows, of_tests)
        if after is not before:
            extended_tests = innovation_tests(after.linear, after.rows, of_tests)
        cause = extended if extended.is_cause else None
        laid_over = overlays(self.events, baseline, cause)
        trade = None if cause is None else traded(cause, of_trade)
        lines = spectra(before.rows)
        return Discrepancies(
            [asdict(symptom) for symptom in find_symptoms(before.rows, tests)],
            _closure(tests, extended_tests),
            {
                "taken_up": [] if cause is None else nuisance_shifts(baseline, cause),
                "trade": None if trade is None else trade.record,
                "fit_percent": [row for overlay in laid_over for row in overlay.record],
                "spectrum": [spectrum.record for spectrum in lines],
                "drivers": strongest(tests),
            },
            BalanceDetail(
                before.rows,
                after.rows if cause is not None else (),
                tests,
                extended_tests,
                laid_over,
                trade,
                lines,
            ),
        )

    def curves(self, unknown: Candidate, rng: np.random.Generator) -> Sequence[Curve]:
        """Of the momentum that nothing explains (:mod:`.discrepancy`)."""
        return curves_of(self.events, unknown, rng)

    def drafts(self, weighed: Candidate) -> Sequence[Draft]:
        """Forms of discrepancy in what is left (:mod:`.drafts`)."""
        if not self.events.telemetry:
            return ()
        return drafted(self.events, weighed)

    def visible(self, none: Candidate, cause: Candidate) -> dict[str, Any] | None:
        """Of causes of one size (:mod:`.visible`)."""
        return visible_record(none, cause, self.kinds)

    def separation(self, one: str, other: str) -> str:
        """The advice of the kinds, or events that fire other thrusters."""
        kinds, priors = self.events.catalogue.kinds, self.events.priors
        return separating_measurement(kinds, priors, one, other)


def _unknown_start(none: Hypothesis, unknown: Hypothesis, base: Mode) -> Array:
    """The baseline's mode in the coordinates of ``unknown``, its own new ones where best."""
    at = dict(zip(none.model.space.names, base.point, strict=True))
    is_new = np.array([name not in at for name in unknown.model.space.names])
    point = np.array([at.get(name, 0.0) for name in unknown.model.space.names])
    starts = np.where(is_new, np.array(UNKNOWN_STARTS)[:, None], point)
    return np.asarray(starts[int(np.nanargmax(unknown.log_density(starts)))])


def _higher_beside_unknown(
    none: Hypothesis, base: Mode, unknown: Hypothesis, unknown_mode: Mode
) -> Mode | None:
    """The baseline's mode from that of ``unknown``, if its density is higher there.

    Few rows between firings may have two modes: from the centre the search ended at a tail-off
    seven times too long, 90 to 135 nats too low (two biases of 12 and 16 rows).
    """
    point = none.part_of(unknown, unknown_mode.point)
    if not none.log_density(point[None])[0] > base.value:
        return None
    mode = find_mode(none.log_density, none.dimension, point)
    return mode if mode.log_evidence > base.log_evidence + HIGHER_NATS else None


def _to_find(events: Events, remainder: Remainder) -> list[tuple[Effect, Work]]:
    """Effects that need a search before the fit, and that search in what a hypothesis leaves."""
    to_find: list[tuple[Effect, Work]] = []
    for effect in events.catalogue.effects:
        if effect.kind.search is not None:
            priors = {p.key: p.distribution for p in effect.parameters}
            to_find.append((effect, partial(effect.kind.search, remainder, priors)))
    return to_find


def _searched(search: Callable[..., Any] | None) -> Any:
    """Type of what one of the package's searches before a fit finds; None of an effect of others.

    Nobody knows whether arrays can stand for what these find.
    """
    if search is None or not search.__module__.startswith("cassini_bayes."):
        return None
    return get_type_hints(search).get("return")


def _could_gain(result: SearchResult, nats: float) -> bool:
    return result.log_gain + HOPED_NATS > result.log_looks + nats


def _side_by_side(
    modes: Sequence[Work],
    to_find: Sequence[tuple[Effect, Work]],
    hypotheses: Sequence[Hypothesis],
    base: Mode,
    what: str,
    workers: StageRunner,
    worth: float = -np.inf,
) -> tuple[list[Any], list[ModeSearch]]:
    """Modes, searches before a fit, and the causes' searches beside the baseline, in one stage.

    The former come first, as each takes as long as many searches. Causes that do not gain ``worth``
    (nats) do not matter.
    """
    near = [partial(newton_search, hypothesis, base, worth) for hypothesis in hypotheses]
    work: list[Work] = [*modes, *(search for _, search in to_find), *near]
    result = (_searched(effect.kind.search) for effect, _ in to_find)
    kinds = [*(Mode for _ in modes), *result, *(ModeSearch for _ in near)]
    # importance draws need ArviZ, whose import takes most of a second
    results: list[Any] = workers.results(what, work, kinds, arviz)
    first = len(modes) + len(to_find)
    return results[:first], results[first:]


def _sampled_near_best(
    weighed: Sequence[Candidate], rng: np.random.Generator, workers: StageRunner
) -> list[Candidate]:
    """Importance-sampled evidence for the hypotheses nearest the best, more draws for the best."""
    candidates = list(weighed)
    least = max(w.score for w in candidates) - NEAR_NATS
    near = [i for i, w in enumerate(candidates) if w.score + w.unsure > least]
    candidates = with_draws(candidates, near, FEW_DRAWS, rng, workers)
    best = sorted(near, key=lambda i: -candidates[i].score)[:MOST_DRAWN]
    return with_draws(candidates, best, DRAWS, rng, workers)


def _closure(before: InnovationTests, after: InnovationTests) -> list[dict[str, Any]]:
    """Momentum at the end against the start, N m s, with 1 σ if the model is true."""
    return [
        {
            "event": old.event,
            "axis": old.axis,
            "baseline_n_m_s": old.value,
            "baseline_sd_n_m_s": old.sd,
            "extended_n_m_s": new.value,
            "extended_sd_n_m_s": new.sd,
        }
        for old, new in zip(before.closure, after.closure, strict=True)
    ]
