"""Draws of a mission: chained ones equal those of all events together, and are resumed."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mission_cases import PRIORS, mission_of, mission_table, mixed_events
from totals_cases import flight

from cassini_bayes.computing.arrays import Array
from cassini_bayes.files.checkpoint import CheckpointStore
from cassini_bayes.model.mission.losses import Loss, loss_prior
from cassini_bayes.priors.reader import Priors, read_priors
from cassini_bayes.results.mission.fitting import (
    EarlierDraws,
    Losses,
    Remembered,
    embedded,
    fit_mission,
    target,
    weighed_losses,
)
from cassini_bayes.studies.mission_flights import study_priors


def few_unknowns() -> Priors:
    """The mission's priors with most nuisances fixed."""
    return study_priors(str(PRIORS))


def test_chained_draws_equal_the_joint_fit() -> None:
    """Five events and then one more: moments and evidence of the fit of all six."""
    events, _ = flight()
    table, priors = mission_table(pressure=None, dated=[]), few_unknowns()
    short, whole = (mission_of(some, table, priors) for some in (events[:5], events[:6]))
    prior, size = loss_prior(priors), {"draws": 800, "proposals": 1_500}
    joint = fit_mission(whole, prior, np.random.default_rng(1), **size)
    begun = fit_mission(short, prior, np.random.default_rng(2), **size)
    chained = fit_mission(whole, prior, np.random.default_rng(3), earlier=begun, **size)
    assert joint.converged
    assert chained.converged
    assert chained.log_evidence == pytest.approx(joint.log_evidence, abs=0.4)
    assert np.abs(chained.z.mean(0) - joint.z.mean(0)).max() < 0.35
    np.testing.assert_allclose(chained.z.std(0), joint.z.std(0), rtol=0.35)
    # negative control: the shorter mission says something else
    assert abs(begun.log_evidence - joint.log_evidence) > 0.8


def test_draws_of_one_branch_go_on_into_two() -> None:
    """A mission of the A branch names its tail-off without the branch; the longer one with it."""
    events, table = mixed_events(), mission_table()
    short, whole = (mission_of(some, table, few_unknowns()) for some in (events[:2], events))
    rng = np.random.default_rng(5)
    z = rng.standard_normal((7, short.space.dimension))
    earlier = EarlierDraws(short.space.names, z, np.zeros(7), {"A": ()}, 0.0, 0.0)
    found, new = embedded(earlier, whole, rng)
    names = whole.space.names
    for name in ("tau_fall_s", "cm_y_m"):
        place = names.index("A.tau_fall_s" if name == "tau_fall_s" else name)
        np.testing.assert_array_equal(found[:, place], z[:, short.space.names.index(name)])
    # only the other branch's are new, and the change of the centre of mass at the swap
    assert {names[i] for i in new} == {n for n in names if n.startswith("B.") or "_since_" in n}


def test_branches_may_have_dots_in_their_names() -> None:
    """The name of a branch is what the earlier mission says it is; the other branch's is new."""
    events, _ = flight(2)
    short = mission_of(events, mission_table(pressure=None, dated=[]), few_unknowns())
    names = ("A.1.tau_fall_s", "A.tau_fall_s", "cm_y_m")
    own = short.space
    both = replace(own, names=names, distributions=own.distributions[:3], blocks=own.blocks[:3])
    z = np.random.default_rng(6).standard_normal((5, 2))
    earlier = EarlierDraws(("tau_fall_s", "cm_y_m"), z, np.zeros(5), {"A.1": ()}, 0.0, 0.0)
    found, new = embedded(earlier, replace(short, space=both), np.random.default_rng(7))
    np.testing.assert_array_equal(found[:, [0, 2]], z)
    assert new.tolist() == [1]


def test_draws_of_both_branches_belong_to_the_same_points() -> None:
    """Places weigh what all hypotheses have; hypotheses follow their probability at a place."""
    which = ((), (Loss(0, 1),))
    log_ratio = np.log([[1.0, 1.0], [1.0, 3.0]])
    losses = Losses("A", which, np.zeros(2), np.array([0.4, 0.6]), 0, log_ratio)
    np.testing.assert_allclose(losses.log_weight, np.log([2.0, 4.0]))
    drawn = losses.draw_at(np.repeat([0, 1], 4_000), np.random.default_rng(0))
    share = np.array([len(hypothesis) for hypothesis in drawn]).reshape(2, -1).mean(1)
    np.testing.assert_allclose(share, [0.5, 0.75], atol=0.03)


def test_batches_of_points_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Likelihood and losses of eleven points at once, and of three at a time."""
    events, _ = flight()
    model = mission_of(events[:5], mission_table(pressure=None, dated=[]), few_unknowns())
    prior, none = loss_prior(few_unknowns()), {"B": ()}
    z = np.random.default_rng(4).standard_normal((11, model.space.dimension))
    likelihood, (whole,) = model.log_likelihood(z), weighed_losses(model, prior, z, none)
    monkeypatch.setattr("cassini_bayes.model.mission.model._MOST_ROWS", 15)
    assert len(list(model.batches(len(z)))) == 4
    np.testing.assert_allclose(model.log_likelihood(z), likelihood, rtol=1e-9)
    (batched,) = weighed_losses(model, prior, z, none)
    # hypotheses are looked for at the first batch: the few that differ have next to no probability
    both = [(batched.which.index(h), i) for i, h in enumerate(whole.which) if h in batched.which]
    one, other = (list(places) for places in zip(*both, strict=True))
    np.testing.assert_allclose(batched.log_ratio[:, one], whole.log_ratio[:, other], atol=1e-6)
    np.testing.assert_allclose(batched.failing(8), whole.failing(8), atol=2e-3)
    # negative control: other points
    (elsewhere,) = weighed_losses(model, prior, z + 0.3, none)
    assert np.abs(elsewhere.failing(8) - whole.failing(8)).max() > 2e-3


def test_values_of_a_killed_fit_are_read_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A density that took time is kept in a file and not worked out again."""
    monkeypatch.setattr("cassini_bayes.results.mission.fitting._WORTH_KEEPING_S", 0.0)
    calls = []

    def density(z: Array) -> Array:
        calls.append(len(z))
        return np.asarray(z.sum(-1))

    z = np.random.default_rng(0).standard_normal((250, 3))
    store = CheckpointStore(tmp_path, "one")
    first = Remembered(density, store)(z)
    again = Remembered(density, store)(z)
    np.testing.assert_array_equal(first, again)
    assert sum(calls) == 250
    np.testing.assert_array_equal(Remembered(density, None)(z), first)


def test_target_is_likelihood_and_prior() -> None:
    """Without losses the target is the collapsed likelihood plus a unit normal."""
    events, _ = flight(3)
    model = mission_of(events, mission_table(pressure=None, dated=[]))
    z = 0.2 * np.random.default_rng(1).standard_normal((2, model.space.dimension))
    expected = model.log_likelihood(z) - 0.5 * (z**2 + np.log(2 * np.pi)).sum(-1)
    found = target(model, {"B": ()}, loss_prior(read_priors(PRIORS)))(z)
    np.testing.assert_allclose(found, expected, rtol=1e-12)
