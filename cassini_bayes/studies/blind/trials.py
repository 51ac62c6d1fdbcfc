"""Blind trials: an effect is hidden in simulated telemetry and the diagnosis has to find it.

A trial draws truth, geometry, cause and size, flies the scenario, diagnoses it without a hint and
keeps what was said: one JSON file per trial.
"""

from __future__ import annotations

import time
import traceback
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from cassini_bayes.diagnosis.balance_case import BalanceCase
from cassini_bayes.diagnosis.events import Events
from cassini_bayes.diagnosis.hypotheses import Hypothesis, compact, none_hypothesis
from cassini_bayes.diagnosis.modes import highest_mode
from cassini_bayes.diagnosis.p_value import p_value
from cassini_bayes.diagnosis.sizes import size_draws, summarised
from cassini_bayes.diagnosis.verdict import Verdict, weigh
from cassini_bayes.effects.catalogue import Catalogue
from cassini_bayes.effects.effect import Effect
from cassini_bayes.effects.oscillation import Oscillation
from cassini_bayes.errors import InputError
from cassini_bayes.files.code import code_digest
from cassini_bayes.priors.reader import Priors
from cassini_bayes.studies.blind.alias import nearest_cause
from cassini_bayes.studies.blind.flights import Blind, Hidden, Scene
from cassini_bayes.studies.blind.likelihood_oracle import likelihood_classifier
from cassini_bayes.studies.blind.oracle import classifier, sizes_of
from cassini_bayes.studies.blind.oscillations import hidden_line
from cassini_bayes.studies.blind.sizes import (
    BESIDE_NONE,
    MOST_DRAWS,
    Stage,
    draw_path,
    sensitivity,
    sized_between,
    sized_from_prior,
    stage,
)
from cassini_bayes.studies.blind.strata import Stratum, stratum_of
from cassini_bayes.studies.blind.uncatalogued import draw_uncatalogued

KEPT_CAUSES: Final = 8
LEAST_SEEN: Final = 1e-2  # σ per prior scale: rounding leaves 1e-4 of what events cannot show


class NothingToHideError(Exception):
    """No effect of the wanted size could be flown."""


def draw_effect(catalogue: Catalogue, rng: np.random.Generator, kind: str | None = None) -> Effect:
    """A cause drawn by its prior probability among the catalogue's, or among those of a kind."""
    effects = [e for e in catalogue.effects if kind in (None, e.kind.name)]
    weights = np.array([effect.prior_probability for effect in effects])
    return effects[int(rng.choice(len(weights), p=weights / weights.sum()))]


def choose_hidden(stratum: Stratum, set_up: Stage, rng: np.random.Generator) -> tuple[Hidden, ...]:
    """What a trial of this stratum hides.

    Raises
    ------
    NothingToHideError
        After many draws none could be flown at such a size.
    """
    catalogue = set_up.events.catalogue
    if stratum.name == "prior":
        total = catalogue.odds.none + sum(e.prior_probability for e in catalogue.effects)
        if rng.uniform() < catalogue.odds.none / total:
            return ()
    wanted = 2 if stratum.name == "two" else 1
    hidden_effects: list[Hidden] = []
    for _ in range(MOST_DRAWS):
        made = _drawn(stratum, set_up, [h.name.partition(":")[0] for h in hidden_effects], rng)
        if made is not None:
            hidden_effects.append(made)
        if len(hidden_effects) == wanted:
            return tuple(hidden_effects)
    raise NothingToHideError(f"nothing to hide in {MOST_DRAWS} draws for {stratum.name}")


def _drawn(
    stratum: Stratum, set_up: Stage, taken: Sequence[str], rng: np.random.Generator
) -> Hidden | None:
    if stratum.name == "uncatalogued":
        return draw_uncatalogued(set_up, rng)
    effect = draw_effect(set_up.events.catalogue, rng, stratum.kind)
    if effect.kind.name in taken or not is_seen(set_up, effect, rng):
        return None
    if stratum.sigmas is None:
        return sized_from_prior(set_up, effect, rng)
    return sized_between(set_up, effect, *stratum.sigmas, rng)


def is_seen(set_up: Stage, effect: Effect, rng: np.random.Generator) -> bool:
    """Whether the events can show an effect: where nothing fires, many need what is not there."""
    if set_up.fires or effect.kind.search is not None:
        return True
    path = draw_path(effect, rng)
    return sensitivity(set_up.events, set_up.base, path, beside=BESIDE_NONE) > LEAST_SEEN


def trial(campaign: Blind, index: int, priors: Priors | None = None) -> dict[str, Any]:
    """One trial, as the record that is kept.

    Under conditions, events that the package refuses are no failure: the record says what it said.
    """
    rng = campaign.stream(index)
    stratum = stratum_of(campaign.strata, index)
    scene = campaign.scene(rng, priors)
    known = identity_of(campaign, index)
    began, worked = time.monotonic(), time.process_time()
    try:
        events = scene.fly(())
    except InputError as refusal:
        if scene.condition is None:
            raise
        return {**known, "declined": str(refusal)}
    hidden: tuple[Hidden, ...] = ()
    told: dict[str, Any] = {}
    if stratum.name != "null":
        none = compact(none_hypothesis(events))
        base = highest_mode(none.log_density, none.model.starts)
        set_up = stage(scene, events, base)
        hidden = choose_hidden(stratum, set_up, rng)
        if stratum.name == "uncatalogued":
            alias = nearest_cause(set_up.view(hidden[0]), set_up.plain)
            told = {"alias": alias.name, "alias_left": alias.left_sigma}
    if hidden:
        events = scene.fly(hidden)
    prepared = time.process_time()
    verdict = weigh(BalanceCase(events), rng, pairs=stratum.name == "two")
    diagnosed = time.process_time()
    return {
        **known,
        **_record(verdict, hidden, rng),
        **_oracle(scene, events, verdict, hidden, rng),
        **told,
        "cpu_prepare_s": prepared - worked,
        "cpu_diagnose_s": diagnosed - prepared,
        "wall_s": time.monotonic() - began,
    }


def _oracle(
    scene: Scene,
    events: Events,
    verdict: Verdict[Hypothesis],
    hidden: Sequence[Hidden],
    rng: np.random.Generator,
) -> dict[str, Any]:
    """Place of a single catalogued cause for the oracle, and how often it expects the best three.

    Its oscillation is the hidden one, or else the one that the diagnosis looked at. Over conditions
    it knows all that the likelihood does, and says which causes are as likely.
    """
    nothing = {"oracle_rank": None, "oracle_expected": None}
    if len(hidden) != 1 or hidden[0].name not in events.catalogue.names:
        return nothing
    effect, values = events.catalogue.effect(hidden[0].name), hidden[0].parameters
    effects = [effect for weighed in verdict.weighed for effect in weighed.hypothesis.effects]
    line = next(
        (
            effect.search_result
            for effect in effects
            if isinstance(effect.search_result, Oscillation)
        ),
        None,
    )
    over_conditions = scene.condition is not None
    if effect.kind.search is not None:
        line = hidden_line(scene, events, hidden[0])
    size = sizes_of(effect, values, scene.truth().parameters)
    make = likelihood_classifier if over_conditions else classifier
    settled = make(events, verdict.none.mode, values, line)
    group = {"oracle_group": settled.group(effect.name, size)} if over_conditions else {}
    return {
        "oracle_rank": settled.rank_by_data(effect.name),
        "oracle_expected": settled.expected(effect.name, size, rng),
        **group,
    }


def _record(
    verdict: Verdict[Hypothesis],
    hidden: Sequence[Hidden],
    rng: np.random.Generator,
) -> dict[str, Any]:
    probabilities, first = verdict.probabilities, verdict.best_cause
    assert first is not None  # the catalogue has causes
    causes = [
        {
            "name": w.name,
            "probability": probabilities[w.name],
            "log_bayes_factor": verdict.log_bayes_factor(w),
        }
        for w in verdict.weighed[:KEPT_CAUSES]
    ]
    p = float("nan")
    left = verdict.none.remainder
    if left is not None:
        p = p_value(left.linear, left.target, [event.time_s for event in left.rows], rng)
    return {
        "hidden": [
            {"name": h.name, "parameters": dict(h.parameters), "sigma": h.sigma} for h in hidden
        ],
        "causes": causes,
        "confounded_with": list(verdict.confounded_with(verdict.best.name)),
        "probability_of_none": probabilities["none"],
        "probability_of_unknown": probabilities["unknown"],
        "probability_of_truth": [probabilities.get(h.name, 0.0) for h in hidden]
        or [probabilities["none"]],
        "rank_of_truth": [_rank(verdict, h.name) for h in hidden],
        "sizes": [s for h in hidden for s in _sizes(verdict, h, rng)],
        "pair": None if verdict.pair is None else verdict.pair.name,
        "pair_gain": None
        if verdict.pair is None
        else float(verdict.pair.net_evidence - first.net_evidence),
        "pair_first_like": list(verdict.confounded_with(first.name)),
        "pair_second_like": list(verdict.equal_seconds),
        "p_value": p,
    }


def _rank(verdict: Verdict[Hypothesis], name: str) -> int | None:
    """Place of a name among the real causes, from 0; None outside the catalogue."""
    real = [w.name for w in verdict.weighed if w.is_cause]
    return real.index(name) if name in real else None


def _sizes(
    verdict: Verdict[Hypothesis], hidden: Hidden, rng: np.random.Generator
) -> list[dict[str, float | str | bool]]:
    """Whether the 90 % interval of the true cause's parameters holds what was hidden.

    That of what the verdict goes on with, where the cause is part of it: beside a second one it is
    another than that of the cause alone.
    """
    told = (verdict.extended, *verdict.weighed)
    cause = next((w for w in told if hidden.name in w.hypothesis.causes), None)
    if cause is None:
        return []
    result: list[dict[str, float | str | bool]] = []
    for key, size in summarised(*size_draws(cause, rng)).items():
        if key not in hidden.parameters:
            continue
        low, high = size.interval
        true = float(hidden.parameters[key])
        result.append(
            {
                "parameter": key,
                "true": true,
                "mean": size.mean,
                "sd": size.sd,
                "low": low,
                "high": high,
                "covers": low <= true <= high,
            }
        )
    return result


def trial_code() -> str:
    """Digest of all code that a verdict can depend on."""
    return code_digest("studies.blind.trials")[:16]


def trial_name(index: int) -> str:
    """Under which a trial's record is kept."""
    return f"trial_{index:04d}"


def identity_of(campaign: Blind, index: int) -> dict[str, Any]:
    """What every record of a trial says of it, however it ended."""
    condition = campaign.condition(campaign.stream(index))
    return {
        "index": index,
        "seed": campaign.seed,
        "events": list(campaign.events),
        "code": trial_code(),
        "stratum": stratum_of(campaign.strata, index).name,
        **({} if condition is None else {"condition": condition.strata}),
    }


def failed_trial(campaign: Blind, index: int, error: Exception) -> dict[str, Any]:
    """The record of a trial that ended in an exception: it is counted, and not done again."""
    where = traceback.extract_tb(error.__traceback__)[-1]
    told = f"{type(error).__name__}: {error} ({Path(where.filename).name}:{where.lineno})"
    return {**identity_of(campaign, index), "error": told}


def run_trial(campaign: Blind, index: int) -> dict[str, Any]:
    """The record of a trial, or of the exception that ended it."""
    try:
        return trial(campaign, index)
    # one trial must not end a campaign, whatever went wrong in it: the page counts failures
    except Exception as error:  # noqa: BLE001 - a campaign goes on
        return failed_trial(campaign, index, error)
