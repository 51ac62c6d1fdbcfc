"""Causes that ended in a valley: searched from elsewhere they come higher, and else stay."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from cassini_bayes.computing.arrays import Array
from cassini_bayes.diagnosis import other_starts
from cassini_bayes.diagnosis.case import Weighed
from cassini_bayes.diagnosis.evidence import by_laplace
from cassini_bayes.diagnosis.hypotheses import Hypothesis
from cassini_bayes.diagnosis.modes import Mode, find_mode
from cassini_bayes.diagnosis.other_starts import (
    FAR_FROM_PRIOR,
    from_best,
    from_best_beginning,
    from_centre,
    is_far_from_prior,
    is_mended,
)
from cassini_bayes.diagnosis.stages import SERIAL

Density = Callable[[Array], Array]


def cause(
    density: Density, found_at: Sequence[float], name: str = "x", begins: str | None = None
) -> Weighed[Hypothesis]:
    """A cause of one size beside one nuisance as a search from a point has it."""
    onset = None if begins is None else SimpleNamespace(event=begins)
    own = SimpleNamespace(
        name=name,
        log_density=density,
        dimension=2,
        sizes=slice(1, 2),
        effects=(SimpleNamespace(onset=onset),),
        log_penalty=0.0,
    )
    return by_laplace(cast(Hypothesis, own), find_mode(density, 2, np.array(found_at)))


def two_valleys(wanted: float, odds: float, near: float = 0.0, far: float = 4.0) -> Density:
    """A nuisance with peaks at two places, at ``far`` far higher if the size is as ``wanted``."""

    def density(z: Array) -> Array:
        fit = -0.5 * ((z[:, 1] - wanted) / 0.1) ** 2
        at = [-0.5 * ((z[:, 0] - place) / 0.1) ** 2 for place in (near, far)]
        return np.asarray(np.logaddexp(30.0 + at[0] - 0.5 * z[:, 1] ** 2, odds + at[1] + fit))

    return density


@pytest.mark.parametrize(("odds", "is_moved"), [(100.0, True), (20.0, False)])
def test_a_cause_in_a_valley_is_searched_from_the_best_ones_nuisances(
    odds: float, is_moved: bool
) -> None:
    """Two causes alike, one of which ended beside the bent baseline; the true one comes first.

    Control: where the other valley is no better the cause stays where it was found.
    """
    base = Mode(np.zeros(1), 0.1 * np.eye(1), 20.0)
    found = [
        cause(two_valleys(0.7, 90.0), (4.0, 0.7), "like it"),
        cause(two_valleys(1.0, odds), (0.0, 0.0), "true"),
    ]
    assert found[1].mode.point == pytest.approx(np.zeros(2), abs=0.01)
    again = from_best(found, base)
    assert again[0] is found[0]
    expected = [4.0, 1.0] if is_moved else [0.0, 0.0]
    assert again[1].mode.point == pytest.approx(expected, abs=0.01)
    assert (again[1].log_evidence > again[0].log_evidence) == is_moved


def test_causes_that_gain_next_to_nothing_are_left() -> None:
    """Nothing is searched from a best cause that is no better than the baseline."""
    found = [cause(two_valleys(0.7, 90.0), (4.0, 0.7)), cause(two_valleys(1.0, 100.0), (0.0, 0.0))]
    high = Mode(np.zeros(1), 0.1 * np.eye(1), found[0].log_evidence)
    again = from_best(found, high)
    assert all(now is then for now, then in zip(again, found, strict=True))


def test_other_beginnings_are_searched_from_that_of_the_best() -> None:
    """A cause throughout had ended in the valley that its later beginning is out of."""
    late = cause(two_valleys(0.7, 90.0), (4.0, 0.7), begins="bias-2")
    throughout = cause(two_valleys(0.7, 100.0), (0.0, 0.0))
    other = cause(two_valleys(0.7, 80.0), (0.0, 0.0), "another")
    found = from_best_beginning([throughout, late, other], SERIAL)
    assert found[0].mode.point == pytest.approx([4.0, 0.7], abs=0.01)
    assert found[0].log_evidence > late.log_evidence
    assert found[1] is late
    assert found[2] is other
    # the best acts throughout: there is nothing to mend
    assert from_best_beginning([found[0], late], SERIAL) == [found[0], late]


def bent(wanted: float, odds: float) -> Density:
    """A peak far from the prior without the cause, and one at its centre with it."""
    return two_valleys(wanted, odds, near=8.0, far=0.0)


def test_a_bent_baseline_is_searched_from_the_centre_until_a_cause_mends_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The cause of most linear gain first, one at a time here; the third is not searched for."""
    monkeypatch.setattr(other_starts, "TOGETHER", 1)
    base = np.array([8.0])
    assert is_far_from_prior(base)
    assert not is_far_from_prior(0.9 * np.array([FAR_FROM_PRIOR]))
    found = [cause(bent(0.5, odds), (8.0, 0.0), f"{odds}") for odds in (95.0, 10.0, 90.0)]
    unknown = Mode(base, 0.1 * np.eye(1), 50.0)
    assert not is_mended(found, unknown)
    again = from_centre(found, [20.0, 30.0, 10.0], unknown, SERIAL)
    assert again[0].mode.point == pytest.approx([0.0, 0.5], abs=0.01)
    assert again[1] is found[1]  # from the centre it is worse, and it keeps what it has
    assert again[2] is found[2]  # the first has mended the baseline
    assert is_mended(again, unknown)


def test_the_best_that_lies_behind_unknown_mends_nothing() -> None:
    """All causes are searched then, each of which takes what is higher."""
    found = [cause(bent(0.5, odds), (8.0, 0.0), f"{odds}") for odds in (95.0, 90.0)]
    unknown = Mode(np.array([8.0]), 0.1 * np.eye(1), 500.0)
    again = from_centre(found, [20.0, 1.0], unknown, SERIAL)
    assert all(own.mode.point == pytest.approx([0.0, 0.5], abs=0.01) for own in again)
    assert not is_mended(again, unknown)
