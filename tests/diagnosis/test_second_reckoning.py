"""Second reckonings: what is there keeps its gains, what roundings make up has none.

The likelihood has the longest roundings as unknowns, and these flights need no second reckoning any
more. It is shown where all of them are noise of bands, as short ones are.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from cassini_bayes.balance.statistics import counter_reduction
from cassini_bayes.balance.statistics.long_levels import NO_LEVELS
from cassini_bayes.computing.log import silent
from cassini_bayes.diagnosis import second_reckoning
from cassini_bayes.diagnosis.balance_case import BalanceCase
from cassini_bayes.diagnosis.case import Weighed
from cassini_bayes.diagnosis.events import Events
from cassini_bayes.diagnosis.hypotheses import (
    Hypothesis,
    compact,
    extend,
    none_hypothesis,
    unknown_hypothesis,
)
from cassini_bayes.diagnosis.innovations import left_by
from cassini_bayes.diagnosis.modes import LOG_2_PI, Mode, find_mode, highest_mode
from cassini_bayes.diagnosis.search import search_from_starts, with_whole_curvature
from cassini_bayes.diagnosis.second_reckoning import (
    acts_between_pulses,
    acts_on_pulses,
    gain_by_levels,
    gain_by_wander,
    gains_of_columns,
    has_coarse_counters,
    named_in_columns,
    reckoned_again,
    unknown_again,
    with_lesser_gain,
)
from cassini_bayes.diagnosis.thruster_forms import (
    LEVER,
    thruster_forms,
    with_thruster_forms,
)
from cassini_bayes.effects.registry import standard
from cassini_bayes.studies.blind.flights import Blind, Hidden
from cassini_bayes.studies.blind.strata import OVER_CONDITIONS

ROOT = Path(__file__).parents[2]
SEED, TRIAL = 20263603, 97  # one bias, counters of 10 ms, adapted widths, rates ten times finer
# The first of six biases, such counters and widths as well: a hundred roundings in fifteen minutes.
FEW_LEVELS = 20263908, 1105
# One bias, counters every ten seconds: what no cause of the catalogue does bends its baseline.
BENT, PLUMES = (20263703, 331), Hidden("plume_impingement:z2", {"lever_m": 0.43}, float("nan"))
BELIEVED = standard().unknown.torque_noise
STEADY, LEAK = "external_torque", "thruster_leak:y2"
SIZES = {
    "thruster_degraded:y2": {"thrust_factor": 0.5},
    STEADY: {
        "external_torque_x_n_m": 8e-5,
        "external_torque_y_n_m": -2e-5,
        "external_torque_z_n_m": 8e-5,
    },
    LEAK: {"leak_n": 1e-4},
}
"""Of what is hidden."""

usual_drive = pytest.mark.usefixtures("usual_drive")


def over_conditions(seed: int) -> Blind:
    """A campaign over conditions."""
    scenario = ROOT / "runs" / "scenarios" / "calibration.toml"
    return Blind(scenario, ROOT / "priors", seed, (), OVER_CONDITIONS, over_conditions=True)


@contextmanager
def roundings(*, all_of_bands: bool) -> Iterator[None]:
    """Reductions in which no rounding is an unknown, or the usual ones."""
    with pytest.MonkeyPatch.context() as patch:
        if all_of_bands:
            patch.setattr(counter_reduction, "longest", lambda *_: NO_LEVELS)
        yield


@cache
def flown(*hidden: str, of_bands: bool = False) -> tuple[Events, Weighed[Hypothesis]]:
    """That flight, with what is hidden, and its baseline; all roundings as noise ``of_bands``."""
    campaign = over_conditions(SEED)
    effects = [Hidden(name, SIZES[name], float("nan")) for name in hidden]
    with roundings(all_of_bands=of_bands):
        events = campaign.scene(campaign.stream(TRIAL)).fly(effects)
    none = compact(none_hypothesis(events))
    mode = highest_mode(none.log_density, none.model.starts)
    return events, Weighed(none, mode, mode.log_evidence)


def weighed(name: str, *hidden: str, of_bands: bool = False) -> Weighed[Hypothesis]:
    """A cause at its mode."""
    events, none = flown(*hidden, of_bands=of_bands)
    cause = compact(extend(none_hypothesis(events), [events.catalogue.effect(name)]))
    mode = with_whole_curvature(cause, search_from_starts(cause, none.mode).mode)
    return Weighed(cause, mode, mode.log_evidence)


def by_bands(none: Weighed[Hypothesis], cause: Weighed[Hypothesis]) -> float:
    """Log density that the likelihood has more at the cause's mode."""
    extra = len(cause.mode.point) - len(none.mode.point)
    return cause.mode.value - none.mode.value + 0.5 * extra * LOG_2_PI


@usual_drive
def test_what_roundings_make_up_is_no_cause() -> None:
    """Nothing hidden, and longer pulses lead by 12 nats: by levels they are worse than none.

    With the longest roundings as unknowns they lead by less than one.
    """
    assert by_bands(flown()[1], weighed("pulse_shape")) < 3.0
    _, none = flown(of_bands=True)
    cause = weighed("pulse_shape", of_bands=True)
    assert by_bands(none, cause) > 8.0
    assert gain_by_levels(none.hypothesis, cause) < 0.0
    before, after = reckoned_again([none, cause], BELIEVED)
    assert before is none
    assert after.score < none.score
    assert after.net_evidence == pytest.approx(
        cause.net_evidence - by_bands(none, cause) + gain_by_levels(none.hypothesis, cause)
    )


@usual_drive
def test_a_cause_that_is_there_keeps_what_it_gains() -> None:
    """A thruster at half its thrust gains as much and more by levels, and stays as it is."""
    name = "thruster_degraded:y2"
    _, none = flown(name)
    cause = weighed(name, name)
    assert by_bands(none, cause) > 10.0
    assert gain_by_levels(none.hypothesis, cause) > 0.9 * by_bands(none, cause)
    assert reckoned_again([none, cause], BELIEVED)[1].net_evidence > 0.9 * by_bands(none, cause) + (
        none.net_evidence
    )


@usual_drive
def test_a_leak_gains_what_the_torque_that_it_is_gains() -> None:
    """Centre of mass and thrusters move a leak's torque; a baseline without one has no use of that.

    In a flight by another simulator a leak had 80 nats by levels, and the torque 104.
    """
    campaign = over_conditions(SEED)
    leak = Hidden("thruster_leak:y1", {"leak_n": 1e-4}, float("nan"))
    events = campaign.scene(campaign.stream(TRIAL)).fly([leak])
    full = none_hypothesis(events)
    none = compact(full)
    mode = highest_mode(none.log_density, none.model.starts)
    leaks, turned = (
        compact(extend(full, [events.catalogue.effect(name)]))
        for name in (leak.name, "external_torque")
    )
    found = search_from_starts(leaks, mode).mode
    physics = leaks.model.telemetry[0].physics(leaks.model.points(found.point[None]))
    nuisances, size = np.split(found.point, [none.dimension])
    (steady,) = turned.effects
    same = physics.steady_torque_n_m[0] / [own.distribution.sd() for own in steady.parameters]
    other = replace(found, point=np.concatenate([nuisances, same]))
    one, two = (Weighed(h, at, 0.0) for h, at in ((leaks, found), (turned, other)))
    gained = gain_by_levels(none, one) + 0.5 * size @ size
    assert gained > 30.0
    assert gained == pytest.approx(gain_by_levels(none, two) + 0.5 * same @ same, rel=1e-6)


@usual_drive
def test_causes_of_the_channels_are_left_as_they_are() -> None:
    """An inertia is no matter of pulses, and counters of 1 ms are none of this module."""
    _, none = flown()
    inertia = weighed("inertia:xx")
    assert not acts_on_pulses(none.hypothesis, inertia.hypothesis, inertia.mode.point)
    ahead = replace(inertia, log_evidence=none.log_evidence + 40.0)
    assert reckoned_again([none, ahead], BELIEVED)[1] is ahead
    assert has_coarse_counters(none.hypothesis)


@usual_drive
def test_a_thruster_acts_on_pulses() -> None:
    """Body, wheels and gyro stay as they are."""
    _, none = flown()
    cause = weighed("thruster_misalignment:y2")
    point = cause.mode.point + 0.1 * np.eye(len(cause.mode.point))[-1]
    assert acts_on_pulses(none.hypothesis, cause.hypothesis, point)


@usual_drive
@pytest.mark.parametrize(
    ("name", "steady"),
    [(STEADY, True), (LEAK, True), ("thrust_warmup", False), ("time_offset", False)],
)
def test_a_steady_torque_leaves_pulses_as_they_are(name: str, steady: bool) -> None:
    """What acts by columns of the thrusters changes them, whatever lever arms and tails are."""
    events, none = flown()
    cause = extend(none.hypothesis, [events.catalogue.effect(name)])
    point = 0.5 * np.ones(cause.dimension)
    assert acts_on_pulses(none.hypothesis, cause, point)
    assert acts_between_pulses(none.hypothesis, cause, point) == steady


def baseline_and_unknown(events: Events) -> tuple[Weighed[Hypothesis], Weighed[Hypothesis]]:
    """``none`` and ``unknown`` at their modes."""
    none, unknown = (compact(make(events)) for make in (none_hypothesis, unknown_hypothesis))
    mode = highest_mode(none.log_density, none.model.starts)
    other = find_mode(unknown.log_density, unknown.dimension, np.zeros(unknown.dimension))
    weighed = (Weighed(h, at, at.log_evidence) for h, at in ((none, mode), (unknown, other)))
    return next(weighed), next(weighed)


@cache
def wandering(
    torque_noise: float, *, of_bands: bool = False
) -> tuple[Events, Weighed[Hypothesis], Weighed[Hypothesis]]:
    """A bias with few levels, its torque wandering by so much (N m s^½); ``none``, ``unknown``."""
    seed, trial = FEW_LEVELS
    campaign = over_conditions(seed)
    scene = campaign.scene(campaign.stream(trial))
    document = {
        **scene.document,
        "event": scene.document["event"][:1],
        "torque_noise": torque_noise > 0.0,
        "truth": {**scene.document["truth"], "torque_noise_n_m_s05": torque_noise},
    }
    with roundings(all_of_bands=of_bands):
        events = replace(scene, document=document).fly(())
    return events, *baseline_and_unknown(events)


def about_mode(none: Weighed[Hypothesis]) -> float:
    """What torque noise gains about the baseline's mode."""
    return gain_by_wander(none.hypothesis, none.mode.point, left_by(none), BELIEVED)


def test_what_few_roundings_make_up_is_no_torque_that_wanders() -> None:
    """Nothing hidden, and ``unknown`` leads by 10 nats: by levels it gains next to nothing.

    With the longest roundings as unknowns it leads by less than one.
    """
    _, none, unknown = wandering(0.0)
    assert unknown.net_evidence - none.net_evidence < 3.0
    _, none, unknown = wandering(0.0, of_bands=True)
    assert unknown.net_evidence - none.net_evidence > 8.0
    after = unknown_again(unknown, none, BELIEVED)
    assert -3.0 < after.net_evidence - none.net_evidence < 3.0
    assert reckoned_again([none, unknown], BELIEVED)[1].net_evidence == after.net_evidence


@pytest.mark.parametrize("drawn", [26.0, 14.0, 8.0])
def test_unknown_has_the_lesser_of_both_gains_whatever_draws_say(drawn: float) -> None:
    """Laplace 20 nats, by columns 10: after draws 10, 10 and 8 are left.

    With what Laplace's evidence had withheld, 16, 4 and −2 had been.
    """
    _, none, unknown = wandering(0.0)
    first = replace(unknown, log_evidence=none.net_evidence + 20.0)
    before = with_lesser_gain(first, none, 10.0)
    assert before.net_evidence - none.net_evidence == pytest.approx(10.0)
    sampled = replace(before, log_evidence=none.net_evidence + drawn)
    after = with_lesser_gain(sampled, none, 10.0)
    assert after.net_evidence - none.net_evidence == pytest.approx(min(drawn, 10.0))


def test_a_diagnosis_reckons_unknown_with_the_evidence_of_its_draws(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Columns that tell half as much as the likelihood have the last word, draws or not.

    Control: evidence by draws is not Laplace's, by which the gain would be off.
    """
    events, none, unknown = wandering(3e-3)
    by_laplace = unknown.log_evidence - none.log_evidence
    monkeypatch.setattr(second_reckoning, "gain_by_wander", lambda *_: 0.5 * by_laplace)
    case = BalanceCase(replace(events, catalogue=replace(events.catalogue, effects=())))
    base, told = case.weigh(np.random.default_rng(1), silent)
    alone = told.without_forms
    assert np.isfinite(alone.pareto_k)
    assert abs(alone.log_evidence - base.log_evidence - by_laplace) > 0.01
    assert alone.net_evidence - base.net_evidence == pytest.approx(0.5 * by_laplace, abs=1e-3)


def test_a_torque_that_wanders_keeps_what_it_gains() -> None:
    """Flown with torque noise of three times its median: both reckonings have it, and it leads."""
    _, none, unknown = wandering(3e-3)
    assert unknown.net_evidence - none.net_evidence > 20.0
    assert about_mode(none) > 20.0
    after = unknown_again(unknown, none, BELIEVED)
    assert none.net_evidence + 20.0 < after.net_evidence <= unknown.net_evidence


def test_what_the_baseline_took_up_counts_beside_the_mode_of_unknown() -> None:
    """Plumes on the craft, in no catalogue: a bent baseline leaves little, and they stay."""
    seed, trial = BENT
    campaign = over_conditions(seed)
    events = campaign.scene(campaign.stream(trial)).fly([PLUMES])
    none, unknown = baseline_and_unknown(events)
    by_bands = unknown.net_evidence - none.net_evidence
    assert about_mode(none) < 0.5 * by_bands
    assert unknown_again(unknown, none, BELIEVED).net_evidence == unknown.net_evidence


@usual_drive
def test_causes_are_reckoned_again_where_unknown_leads() -> None:
    """``unknown`` that stays ahead does not keep what roundings make up for a cause behind it."""
    events, none = flown(of_bands=True)
    cause = weighed("pulse_shape", of_bands=True)
    unknown = compact(unknown_hypothesis(events))
    ahead = replace(none, hypothesis=unknown, log_evidence=cause.log_evidence + 50.0)
    told = reckoned_again([none, ahead, cause], BELIEVED, unknown_too=False)
    assert told[1] is ahead
    assert told[2].score < none.score


def test_behind_the_baseline_nothing_is_reckoned_again() -> None:
    """As in most flights."""
    _, none, unknown = wandering(0.0, of_bands=True)
    behind = replace(unknown, log_evidence=none.log_evidence - 1.0)
    assert reckoned_again([none, behind], BELIEVED)[1] is behind
    seen = reckoned_again([none, unknown], BELIEVED, unknown_too=False)
    assert seen[1] is unknown


def test_a_diagnosis_does_not_say_unknown_for_few_roundings() -> None:
    """The whole diagnosis of that flight has ``none`` first."""
    events, *_ = wandering(0.0)
    case = BalanceCase(events)
    ranked = case.weigh(np.random.default_rng(1), silent)
    assert max(ranked, key=lambda own: own.score).name == "none"


def pushed(*hidden: str, of_bands: bool = False) -> tuple[Weighed[Hypothesis], ...]:
    """That flight: none, a torque and a leak as causes, and unknown behind all."""
    events, none = flown(*hidden, of_bands=of_bands)
    unknown = compact(unknown_hypothesis(events))
    behind = Mode(np.zeros(unknown.dimension), np.eye(unknown.dimension), none.log_evidence - 9.0)
    causes = (weighed(name, *hidden, of_bands=of_bands) for name in (STEADY, LEAK))
    return (none, *causes, Weighed(unknown, behind, behind.log_evidence))


@usual_drive
@pytest.mark.parametrize("hidden", [(STEADY,), (LEAK,), ()])
def test_columns_know_a_cause_and_nothing_where_there_is_none(hidden: tuple[str, ...]) -> None:
    """Sizes with their priors: of a torque by slopes, of a leak as the mean over all sizes."""
    none, *causes, _ = pushed(*hidden)
    gains = gains_of_columns(none, [own.hypothesis for own in causes])
    assert set(gains) == {STEADY, LEAK}
    if hidden:
        assert gains[hidden[0]] > 10.0
    else:
        assert max(gains.values()) < 1.0


@usual_drive
def test_a_torque_that_rounding_hides_is_no_lever() -> None:
    """What columns know as a steady torque has a name, though the likelihood cannot tell it.

    With the longest roundings as unknowns the likelihood tells it, too.
    """
    now, named, *_ = pushed(STEADY)
    assert named.score - now.score > 20.0
    none, torque, leak, unknown = pushed(STEADY, of_bands=True)
    limits = standard().unknown
    assert thruster_forms(none, limits)[LEVER] > 10.0
    assert torque.score - none.score < 5.0
    assert named_in_columns([none, torque, leak, unknown]) > 10.0
    after = with_thruster_forms([none, torque, leak, unknown], limits)[-1]
    assert after.score < none.score
    alone = with_thruster_forms([none, unknown], limits)[-1]
    assert alone.score > none.score + 5.0
