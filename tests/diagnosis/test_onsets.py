"""From which event on a cause acts: named, summed over, held out, against dense oracles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache, partial
from pathlib import Path

import numpy as np
import pytest
from event_cases import document, eased, priors
from scipy.special import logsumexp
from scipy.stats import multivariate_normal, norm

from cassini_bayes.balance.part_columns import PartColumns
from cassini_bayes.computing.arrays import Array
from cassini_bayes.diagnosis.balance_case import BalanceCase
from cassini_bayes.diagnosis.case import Weighed
from cassini_bayes.diagnosis.diagnosis import diagnose
from cassini_bayes.diagnosis.events import Events, prepare
from cassini_bayes.diagnosis.gain import fits_without, taught
from cassini_bayes.diagnosis.hypotheses import Hypothesis, extend, none_hypothesis
from cassini_bayes.diagnosis.modes import Mode
from cassini_bayes.diagnosis.onsets import (
    HALF_NORMAL,
    LEAST_GAIN,
    SIZES,
    Beginnings,
    _with_totals,
    information_from_each,
    log_bayes,
    sizes_tried,
    without_event,
)
from cassini_bayes.diagnosis.verdict import Verdict, weigh
from cassini_bayes.effects.effect import Effect, onsets
from cassini_bayes.effects.registry import Odds, standard
from cassini_bayes.events.totals import TotalsEvent, read_totals
from cassini_bayes.model.posterior import log_likelihood, log_posterior
from cassini_bayes.priors.reader import read_priors
from cassini_bayes.sampling.warmstart import warm_start
from cassini_bayes.simulation import scenario_of
from cassini_bayes.studies.blind.flights import reduced
from cassini_bayes.studies.scenario import draw_wheel_rates, simulate_file

ROOT = Path(__file__).parents[2]
Z3 = "thruster_degraded:z3"
LEFT = 0.77
CAUSES = ("thrust_scale", Z3, "thruster_degraded:z4")
SIX = tuple(f"bias-{i}" for i in range(1, 7))
TOTALS_PRIORS = read_priors(ROOT / "priors" / "cassini_b_branch_2010.toml")
FLIGHT = ROOT / "cassini_bayes" / "published" / "flight_2009_2010.csv"


def flown(ids: Sequence[str], weak: Sequence[str], causes: Sequence[str] = CAUSES) -> Events:
    """Short biases a month apart, in some of them Z3 at 77 %; a few causes to weigh."""
    content = eased(document(), share=1.0)
    bias = content["event"][0]
    content["event"] = [
        {**bias, "id": name, "epoch": f"2010-0{i}-01T00:00:00Z"} for i, name in enumerate(ids, 1)
    ]
    draw_wheel_rates(content["event"], np.random.default_rng(7))
    if weak:
        hidden = {"name": Z3, "parameters": {"thrust_factor": LEFT}, "events": list(weak)}
        content["effect"] = [hidden]
    events = reduced(simulate_file(scenario_of(content), 7, priors=priors()), priors())
    chosen = tuple(e for e in events.catalogue.effects if e.name in causes)
    return replace(events, catalogue=replace(events.catalogue, effects=chosen))


def verdict_of(events: Events) -> Verdict[Hypothesis]:
    """All causes weighed, without a second one."""
    return weigh(BalanceCase(events), np.random.default_rng(1), pairs=False)


@cache
def late() -> tuple[Events, Verdict[Hypothesis]]:
    """Six biases, Z3 at 77 % in the last three of them."""
    events = flown(SIX, SIX[3:])
    return events, verdict_of(events)


def probabilities(weighed: Weighed[Hypothesis]) -> dict[str, float]:
    """Of every beginning, by event; throughout is empty."""
    return {own.event: own.probability for own in weighed.beginnings}


def test_a_loss_between_events_is_named_with_its_thruster_onset_and_size() -> None:
    """Z3 from the fourth bias on: thrust_scale at 1.9 was named when nothing began between events
    and a factor widened departures; now the thruster, the event and the size are.
    """
    events, verdict = late()
    assert verdict.best.name == Z3
    assert verdict.probabilities[Z3] > 0.99
    assert verdict.probabilities["thrust_scale"] < 0.01
    begins = verdict.best.begins
    assert begins is not None
    assert (begins.event, begins.probability > 0.99) == ("bias-4", True)
    size = BalanceCase(events).sizes(verdict.best, np.random.default_rng(2))["thrust_factor"]
    assert size.interval[0] < LEFT < size.interval[1]
    assert size.sd < 0.02


def test_its_record_and_its_words_say_when() -> None:
    """Record, sentence and held-out gain; the residuals of events held out get smaller."""
    events = flown(SIX[:3], SIX[1:3], (Z3,))
    record = diagnose(BalanceCase(events), np.random.default_rng(1), pairs=False).record
    cause = record["causes"][0]
    assert cause["onset"]["event"] == "bias-2"
    assert sum(cause["onset"]["probabilities"].values()) == pytest.approx(1.0)
    assert list(cause["onset"]["probabilities"]) == ["throughout", *SIX[1:3]]
    assert "of its thrust" in cause["says"]
    assert cause["says"].endswith("from bias-2 on (probability > 0.99)")
    assert record["causes"][1]["onset"] is None
    assert record["gain"]["verdict"] == "gain"


def test_an_event_beside_the_onset_is_predicted_by_both_sides() -> None:
    """Without the fourth bias the others cannot tell whether the loss is there: half and half.

    One fit to them is enough for both. Without another event they can.
    """
    events, verdict = late()
    fits = fits_without(events, verdict.best, "bias-4")
    assert len(fits) == 1
    ways = taught(events, verdict.best, "bias-4", fits)
    assert [way.whole.effects[-1].acts_in("bias-4") for way in ways] == [True, False]
    assert ways[0].score == pytest.approx(ways[1].score)
    of_others = fits_without(events, verdict.best, "bias-2")
    assert len(taught(events, verdict.best, "bias-2", of_others)) == 1
    alone = ways[0].mode.log_evidence + np.log(0.1)
    assert logsumexp([way.score for way in ways]) == pytest.approx(alone + np.log(2.0))


def test_a_loss_that_was_always_there_acts_throughout() -> None:
    """In all three biases, it is not said to begin with one."""
    verdict = verdict_of(flown(SIX[:3], SIX[:3]))
    assert verdict.best.name == Z3
    assert probabilities(verdict.best)[""] > 0.9


def test_nothing_hidden_begins_nowhere() -> None:
    """Negative control: the baseline stays, and beginnings keep about their prior odds."""
    verdict = verdict_of(flown(SIX[:3], ()))
    assert verdict.best.name == "none"
    assert verdict.probabilities["none"] > 0.9
    for cause in verdict.weighed:
        if cause.is_cause:
            assert max(share for name, share in probabilities(cause).items() if name) < 0.9


@cache
def three() -> tuple[TotalsEvent, ...]:
    """The first three flight biases, in another order than that of time."""
    first, second, third = read_totals(str(FLIGHT), TOTALS_PRIORS.spacecraft, "flight")[:3]
    return second, first, third


def test_summed_evidence_of_totals_rows_is_that_of_importance_sampling() -> None:
    """Half the prior throughout, the rest even over later rows, each sampled by itself."""
    events = prepare((), TOTALS_PRIORS, three())
    effect = events.catalogue.effect("tail_off")
    order = events.in_order
    assert order == (three()[1].id, three()[0].id, three()[2].id)
    full = none_hypothesis(events)

    def sampled(place: int) -> float:
        begun = replace(effect, onset=(None, *onsets(order))[place])
        model = extend(full, [begun]).model
        start = warm_start(
            partial(log_posterior, model), model.space.dimension, np.random.default_rng(place)
        )
        return start.draws.log_evidence

    wanted = logsumexp([sampled(0), sampled(1), sampled(2)], b=[0.5, 0.25, 0.25])
    only = replace(events, catalogue=replace(events.catalogue, effects=(effect,)))
    found = verdict_of(only).named("tail_off")
    assert found.net_evidence == pytest.approx(wanted, abs=0.15)
    assert sum(probabilities(found).values()) == pytest.approx(1.0)


def test_levels_of_totals_rows_vary_as_the_first_cause_scales_them() -> None:
    """Beside factors of 0.66 and 1.35 on all thrusts rows change as the model's likelihood does.

    But for 0.4 nats of the controller's response. Control: with levels as wide as without a factor
    17 nats are between them.
    """
    rows = tuple(replace(row, delta_v_m_s=None) for row in three())
    events = prepare((), TOTALS_PRIORS, rows)
    thrust, tail = (events.catalogue.effect(name) for name in ("thrust_scale", "tail_off"))
    base = extend(none_hypothesis(events), [thrust])
    extended = [(extend(base, [tail]), sizes_tried(tail))]
    d = base.dimension
    points = np.stack([np.r_[np.zeros(d - 1), size] for size in (-1.0, 1.0)])
    factors = thrust.values(base.model.points(points).parameters)["thrust_factor"]
    rank = base.model.thrust_prior.shared.shape[1]

    def density(z: Array, wider: float = 1.0) -> float:
        linear, _ = _with_totals(base, z, extended, None)
        columns = linear.columns.written_out()[:, d:].copy()
        columns[:, :rank] *= wider
        covariance = np.eye(len(columns)) + columns @ columns.T
        return float(multivariate_normal(cov=covariance).logpdf(linear.target))

    wanted = np.diff(log_likelihood(base.model, points))[0]
    assert density(points[1]) - density(points[0]) == pytest.approx(wanted, abs=0.5)
    unscaled = [density(z, 1.0 / factor) for z, factor in zip(points, factors, strict=True)]
    assert abs(unscaled[1] - unscaled[0] - wanted) > 10.0


def test_linear_gains_are_those_of_the_dense_normal() -> None:
    """b and I of every beginning, by cumulative sums, against the covariance of all rows."""
    rng = np.random.default_rng(5)
    counts, p = (7, 5, 6), 4
    columns = [rng.standard_normal((m, p)) for m in counts]
    target = [rng.standard_normal(m) for m in counts]
    added = [rng.standard_normal((m, 1)) for m in counts]
    precision, mean = rng.uniform(0.5, 2.0, p), rng.standard_normal(p)
    columns[1][:, 2] = 0.0  # which the second event has not
    found = information_from_each(
        [PartColumns.of(own) for own in columns], target, added, precision, mean
    )
    x, y = np.concatenate(columns), np.concatenate(target)
    covariance = np.eye(len(y)) + x @ np.diag(1.0 / precision) @ x.T
    for first, (matrix, vector) in enumerate(found):
        each = [own if i >= first else 0.0 * own for i, own in enumerate(added)]
        effect = np.concatenate(each)[:, 0]

        def log_density(size: float, effect: np.ndarray = effect) -> float:
            return float(multivariate_normal(x @ mean + size * effect, covariance).logpdf(y))

        wanted = 1.7 * vector[0] - 0.5 * 1.7**2 * matrix[0, 0]
        assert log_density(1.7) - log_density(0.0) == pytest.approx(wanted, rel=1e-9)


def test_odds_of_beginnings_add_up() -> None:
    """One event has no choice; else half throughout and the rest even; none later if so told."""
    odds = standard().odds
    assert odds.of_onsets(1) == (1.0,)
    assert odds.of_onsets(6) == pytest.approx((0.5, *5 * (0.1,)))
    assert replace(odds, throughout=1.0).of_onsets(3) == (1.0, 0.0, 0.0)


def test_linear_evidence_of_one_sided_and_of_free_sizes() -> None:
    """Log Bayes factors from columns at two sizes, against integrals over the prior of the size."""
    total, own = 9.0, 3.0  # I and b of an effect of one scale
    size = np.linspace(-12.0, 12.0, 200_001)
    likelihood = np.exp(own * size - 0.5 * total * size**2)
    for at, prior in (
        (np.array(SIZES), norm.pdf(size)),
        (np.array([0.2, HALF_NORMAL[1]]), 2.0 * norm.pdf(size) * (size > 0)),
        (np.array([HALF_NORMAL[0], 0.3]), 2.0 * norm.pdf(size) * (size > 0)),
    ):
        wanted = np.log(np.trapezoid(likelihood * prior, size))
        found = log_bayes(total * np.outer(at, at), own * at)
        assert found == pytest.approx(wanted, abs=1e-3)


def test_what_an_event_hardly_tells_gains_little() -> None:
    """Sizes of ten prior scales are not believed; control: what it tells well gains as before."""
    effects = tuple(prepare((), TOTALS_PRIORS, three()).catalogue.effects[:1])
    at = np.array(SIZES)
    for total, own, wanted in ((0.01, 0.35, 0.0606), (400.0, 60.0, 4.4888)):
        one = (total * np.outer(at, at), own * at)
        odds = Odds(0.5, 0.45, 0.05, 0.5)
        found = Beginnings.of_information(effects, ("a", "b"), odds, lambda _, one=one: [one, one])
        assert found.gains == pytest.approx(np.full((1, 2), wanted), rel=1e-3)
    assert LEAST_GAIN < 0.5 * 0.35**2 / 0.01


def test_only_what_can_matter_is_searched() -> None:
    """Beginnings far behind the best, or with little gain, are not."""
    effects = tuple(prepare((), TOTALS_PRIORS, three()).catalogue.effects[:2])
    gains = np.array([[10.0, 100.0, 60.0], [1.0, 4.0, 99.0]])
    beginnings = Beginnings(effects, ("a", "b", "c"), Odds(0.5, 0.45, 0.05, 0.5), gains, gains)
    likely = [e for e in beginnings.likely() if e.onset is not None]
    named = [(e.name, e.onset.event) for e in likely if e.onset is not None]
    assert named == [(effects[0].name, "b"), (effects[1].name, "c")]
    assert likely[0].prior_probability == pytest.approx(0.25 * effects[0].prior_probability)
    # where the best turns out to gain less than its linear model says, others come within reach
    (further,) = beginnings.missed(70.0)
    assert further.onset is not None
    assert (further.name, further.onset.event) == (effects[0].name, "c")


def test_what_gains_too_little_throughout_is_left_out_where_that_is_asked() -> None:
    """By its log Bayes factor, unless a later beginning is searched; control: all by default."""
    effects = tuple(prepare((), TOTALS_PRIORS, three()).catalogue.effects[:3])
    gains = np.array([[1.0, 0.0], [1.0, 9.0], [3.0, 0.0]])
    factors = np.array([[-2.0, 0.0], [-2.0, 7.0], [1.0, 0.0]])
    beginnings = Beginnings(effects, ("a", "b"), Odds(0.5, 0.45, 0.05, 0.5), gains, factors)
    throughout = [e.name for e in beginnings.likely(-1.0) if e.onset is None]
    assert throughout == [effects[1].name, effects[2].name]
    assert [e.name for e in beginnings.likely() if e.onset is None] == [e.name for e in effects]


def test_what_a_rotor_weighs_does_not_change_between_events() -> None:
    """`wheel_inertia` is looked for throughout alone, by its whole prior; control: a thrust."""
    catalogue = prepare((), TOTALS_PRIORS, three()).catalogue
    rotor, thrust = catalogue.effect("wheel_inertia:2"), catalogue.effect("thrust_scale")
    at = np.array(SIZES)

    def information(choose: Sequence[Effect]) -> list[tuple[Array, Array]]:
        sizes = np.tile(at, len(choose))
        return [(400.0 * np.outer(sizes, sizes), 90.0 * sizes)] * 2

    odds = Odds(0.5, 0.45, 0.05, 0.5)
    found = Beginnings.of_information((rotor, thrust), ("a", "b"), odds, information).likely()
    assert [e for e in found if e.name == rotor.name] == [rotor]
    assert [e.onset is None for e in found if e.name == thrust.name] == [True, False]


def test_a_cause_that_does_nothing_any_more_is_no_beginning() -> None:
    """Throughout it is 4 nats below none, by its linear model 9: what begins where nothing fires is
    none, and not 5 nats above it. What gains little elsewhere is short by its share of the 5 nats.
    """
    events = prepare((), TOTALS_PRIORS, three())
    effects = tuple(events.catalogue.effects[:1])
    gains, factors = np.array([[0.2, 0.1, 0.0]]), np.array([[-9.0, -4.5, 0.0]])
    odds = Odds(0.5, 0.45, 0.05, 0.5)
    beginnings = Beginnings(effects, ("a", "b", "c"), odds, gains, factors)
    whole = none_hypothesis(events)
    share = replace(effects[0], prior_probability=0.5 * effects[0].prior_probability)
    cause = replace(extend(whole, [share]), prior_probability=share.prior_probability)
    mode = Mode(np.zeros(1), np.eye(1), 96.0)
    (found,) = beginnings.summed([Weighed(cause, mode, 96.0)], 100.0)
    weights = np.array([0.5 * np.exp(-4.0), 0.25 * np.exp(-4.5 + 0.5 * 5.0), 0.0])
    told = [beginning.probability for beginning in found.beginnings]
    assert told == pytest.approx(weights / weights.sum(), rel=1e-6)
    assert found.net_evidence == pytest.approx(100.0 + np.log(weights.sum()), abs=1e-6)


def test_the_others_tell_an_event_its_side() -> None:
    """Beginnings alike without an event are one; an unseen loss may have been there always."""
    _, verdict = late()
    best = verdict.best
    assert [first for first, _ in without_event(best, SIX, "bias-4")] == [3, 4]
    assert [first for first, _ in without_event(best, SIX, "bias-3")] == [2, 3]
    assert [first for first, _ in without_event(best, SIX, "bias-6")] == [3]
