"""Evidence of causes: searches from the baseline's mode against closed forms and quadrature."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Final, cast

import numpy as np
import pytest
from scipy.integrate import dblquad, quad

from cassini_bayes.computing.arrays import Array
from cassini_bayes.diagnosis import evidence, modes
from cassini_bayes.diagnosis.case import Weighed
from cassini_bayes.diagnosis.evidence import (
    importance_sampled,
    weigh_extensions,
    worth_continuing,
)
from cassini_bayes.diagnosis.hypotheses import Hypothesis
from cassini_bayes.diagnosis.modes import Mode, find_mode
from cassini_bayes.diagnosis.search import (
    UNSURE_NATS,
    ModeSearch,
    has_moved,
    higher_of,
    newton_search,
    search_from_starts,
    with_whole_curvature,
)


def hypothesis(density: Callable[[Array], Array], dimension: int, name: str = "x") -> Hypothesis:
    """A hypothesis of nothing but its density."""
    own = SimpleNamespace(name=name, log_density=density, dimension=dimension)
    return cast(Hypothesis, own)


def linear(columns: Array, data: Array) -> Callable[[Array], Array]:
    """Log density of standard normals z seen through columns (m, d) with unit noise."""

    def density(z: Array) -> Array:
        left = data - z @ columns.T
        constant = 0.5 * (len(data) + z.shape[-1]) * np.log(2.0 * np.pi)
        return np.asarray(-0.5 * (left**2).sum(-1) - 0.5 * (z**2).sum(-1) - constant)

    return density


def exact(columns: Array, data: Array) -> float:
    """Log evidence log N(data; 0, 1 + columns columnsᵀ)."""
    covariance = np.eye(len(data)) + columns @ columns.T
    _, log_det = np.linalg.slogdet(covariance)
    square = data @ np.linalg.solve(covariance, data)
    return float(-0.5 * (square + log_det + len(data) * np.log(2.0 * np.pi)))


@pytest.mark.parametrize("size", [0.0, 0.7, 6.0])
def test_evidence_beside_a_nuisance_on_a_ridge_is_exact(size: float) -> None:
    """Linear and normal, the effect alike a nuisance to 0.1 %: the determinant formula."""
    rng = np.random.default_rng(3)
    columns = rng.standard_normal((40, 4)) * [30.0, 300.0, 3.0, 0.3]
    own = columns[:, :1] * 5.0 + 0.15 * rng.standard_normal((40, 1))
    together = np.concatenate([columns, own], axis=1)
    data = together @ np.array([0.5, -1.0, 0.3, 1.0, size]) + rng.standard_normal(40)
    base = find_mode(linear(columns, data), 4)
    assert base.log_evidence == pytest.approx(exact(columns, data), abs=2e-3)
    own = hypothesis(linear(together, data), 5)
    found = search_from_starts(own, base)
    assert found.lacking == 0.0
    assert found.mode.log_evidence == pytest.approx(exact(together, data), abs=0.02)
    draws = importance_sampled(Weighed(own, found.mode, 0.0, 0.0), rng)
    assert abs(draws.log_evidence - exact(together, data)) < 4.0 * draws.log_evidence_se
    assert draws.pareto_k < 0.5
    near = newton_search(own, base)
    assert (near.lacking == 0.0) == (size == 0.0)  # what gains many nats calls for a longer search
    if size < 6.0:
        assert near.mode.log_evidence == pytest.approx(exact(together, data), abs=0.02)


@pytest.mark.parametrize(("size", "is_left"), [(1.0, True), (3.0, False)])
def test_a_cause_that_cannot_matter_is_left_early(size: float, is_left: bool) -> None:
    """What will not gain what is worth a while takes fewer points; a gain is found as ever."""
    rng = np.random.default_rng(3)
    columns = rng.standard_normal((40, 4))
    own = columns[:, :1] + 0.15 * rng.standard_normal((40, 1))
    together = np.concatenate([columns, own], axis=1)
    data = together @ np.array([0.5, -1.0, 0.3, 1.0, size]) + rng.standard_normal(40)
    base = find_mode(linear(columns, data), 4)
    points: list[int] = []

    def counted(z: Array) -> Array:
        points.append(len(z))
        return linear(together, data)(z)

    whole = newton_search(hypothesis(counted, 5), base)
    needed = sum(points)
    points.clear()
    early = newton_search(hypothesis(counted, 5), base, worth=4.0)
    assert (sum(points) < needed) == is_left
    assert early.mode.log_evidence == pytest.approx(whole.mode.log_evidence, abs=1.0)
    assert early.lacking == whole.lacking
    assert (whole.mode.log_evidence - base.log_evidence < 4.0) == is_left


def test_a_search_knows_whether_it_has_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    """A normal density is seen whole in a few looks; in a single one from rough axes it is not."""
    rng = np.random.default_rng(5)
    columns = rng.standard_normal((40, 3)) * [30.0, 1.0, 0.1]
    density = linear(columns, columns.sum(1))
    assert find_mode(density, 3).is_whole
    monkeypatch.setattr(modes, "MOST_CURVATURES", 1)
    assert not find_mode(density, 3).is_whole


def bent(z: Array) -> Array:
    """A nuisance whose weight falls with the effect: so does its curvature."""
    seen = 12.0 * z[:, 0] * np.exp(-0.5 * z[:, 1]) + 2.0 * z[:, 1]
    return np.asarray(-0.5 * (5.0 - seen) ** 2 - 0.5 * (z**2).sum(-1) - np.log(2.0 * np.pi))


def test_evidence_where_curvature_changes_agrees_with_quadrature() -> None:
    """A skew density of nuisance and effect: importance draws against an integral in the plane."""
    base = find_mode(lambda z: bent(np.column_stack([z, np.zeros(len(z))])), 1)
    own = hypothesis(bent, 2)
    wanted, _ = dblquad(
        lambda y, x: float(np.exp(bent(np.array([[x, y]]))[0])), -6, 6, -5, 6, epsabs=1e-9
    )
    mode = with_whole_curvature(own, search_from_starts(own, base).mode)
    found = importance_sampled(
        Weighed(own, mode, mode.log_evidence, float("nan")), np.random.default_rng(1)
    )
    assert abs(found.log_evidence - np.log(wanted)) < 4.0 * found.log_evidence_se
    assert found.log_evidence_se < 0.1


def walled(z: Array) -> Array:
    """An effect that takes a nuisance from 0 to 1, ten of its standard deviations there.

    Where it is at 1 it is four times as wide.
    """
    width = 0.1 + 0.3 / (1.0 + np.exp(-20.0 * (z[:, 0] - 0.5)))
    at = np.where(z.shape[-1] > 1, z[:, -1], 0.0)
    fit = -0.5 * ((z[:, 0] - at) / width) ** 2 - 0.5 * 400.0 * (at - 1.0) ** 2
    return np.asarray(fit - 0.5 * (z**2).sum(-1))


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_a_search_that_has_not_ended_tells_a_volume_of_any_axes(order: tuple[int, int]) -> None:
    """Two sizes, each along a ridge of its own, in either order: the volume is that of the axes."""
    rng = np.random.default_rng(8)
    columns = rng.standard_normal((40, 3)) * [30.0, 100.0, 3.0]
    own = np.stack([columns[:, 0], 0.02 * columns[:, 1]], axis=1)[:, order]
    together = np.concatenate([columns, own + 0.5 * rng.standard_normal((40, 2))], axis=1)
    data = together @ np.array([0.5, -1.0, 0.3, 3.0, 3.0]) + rng.standard_normal(40)
    base = find_mode(linear(columns, data), 3)
    found = newton_search(hypothesis(linear(together, data), 5), base)
    _, log_det = np.linalg.slogdet(found.mode.factor)
    volume = found.mode.log_evidence - linear(together, data)(found.mode.point[None])[0]
    assert found.lacking > 0.0
    assert volume == pytest.approx(log_det + 2.5 * np.log(2.0 * np.pi))
    assert np.triu(found.mode.factor, 1) == pytest.approx(0.0, abs=1e-12)


def test_a_cause_that_took_a_nuisance_far_is_marked_and_sampled_right() -> None:
    """Laplace with the baseline's curvature is short by nats and says so; draws mend it."""
    base = find_mode(lambda z: walled(np.column_stack([z, np.zeros(len(z))])), 1)
    own = hypothesis(walled, 2)
    assert has_moved(search_from_starts(own, base).mode, base)
    (rough,) = weigh_extensions([own], [newton_search(own, base)], base, print)
    assert rough.unsure > 0.0
    wanted, _ = dblquad(
        lambda y, x: float(np.exp(walled(np.array([[x, y]]))[0])), -3, 4, -3, 4, epsabs=1e-9
    )
    found = importance_sampled(rough, np.random.default_rng(4), 2_000)
    assert rough.log_evidence < np.log(wanted) - 1.0
    assert abs(found.log_evidence - np.log(wanted)) < 4.0 * found.log_evidence_se
    assert found.unsure == 0.0


def test_a_longer_search_that_ends_lower_does_not_replace_a_shorter_one() -> None:
    """What came higher is kept, as a search that has not ended."""
    base = Mode(np.zeros(1), np.eye(1), 0.0)
    low, high = (
        ModeSearch(Mode(np.zeros(1), np.eye(1), v), r) for v, r in ((-8.0, 30.0), (68.0, 0.0))
    )
    assert higher_of(high, low, base) is high
    kept = higher_of(low, high, base)
    assert kept.mode is high.mode
    assert kept.lacking > 90.0


def test_only_causes_that_may_come_near_the_best_are_searched_further() -> None:
    """A search that has ended is not repeated; a hopeless one is left; a floor raises the bar."""

    def search_at(log_evidence: float, reach: float) -> ModeSearch:
        return ModeSearch(Mode(np.zeros(1), np.eye(1), log_evidence), reach)

    found = [
        search_at(0.0, 0.0),
        search_at(-20.0, 30.0),
        search_at(-500.0, 30.0),
        search_at(-900.0, np.inf),
    ]
    assert worth_continuing(found, -np.inf) == [1, 3]
    assert worth_continuing(found, 50.0) == [3]
    assert worth_continuing(
        [search_at(0.0, 0.0), search_at(-5.0, 30.0), search_at(-2.0, 30.0)], -50.0
    ) == [2, 1]
    assert (
        worth_continuing([search_at(0.0, 0.0), search_at(-1.0, 3.0)], -50.0) == []
    )  # for importance draws


def test_what_the_best_leaves_behind_is_not_searched_further(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The best goes first; what it then gains is out of reach of the next, not of the one after."""
    at = {"best": (100.0, 500.0), "weak": (20.0, 100.0), "strong": (50.0, 800.0)}
    searched: list[str] = []

    def further(own: Hypothesis, base: Mode) -> ModeSearch:
        searched.append(own.name)
        gained = {"best": 600.0}.get(own.name, 60.0)
        return ModeSearch(Mode(base.point, base.factor, gained))

    monkeypatch.setattr(evidence, "search_from_starts", further)
    base = Mode(np.zeros(1), np.eye(1), 0.0)
    causes = [hypothesis(linear(np.eye(1), np.zeros(1)), 1, name) for name in at]
    near = [ModeSearch(Mode(base.point, base.factor, value), reach) for value, reach in at.values()]
    found = weigh_extensions(causes, near, base, lambda _: None)
    assert searched == ["best", "strong"]
    assert [own.log_evidence for own in found] == [600.0, 20.0, 60.0]


def test_a_small_gain_on_a_bent_ridge_is_told_by_draws() -> None:
    """A banana of effect and nuisance: Laplace within 3 nats of the integral, draws in error."""
    sd = 0.05

    def banana(z: Array) -> Array:
        bent = z[..., 0] + 4.0 * z[..., 1] + 0.5 * z[..., 1] ** 2 - 0.5
        prior = -0.5 * (z**2).sum(-1) - 0.5 * z.shape[-1] * np.log(2.0 * np.pi)
        return np.asarray(prior - 0.5 * (bent / sd) ** 2)

    def alone(z: Array) -> Array:
        return np.asarray(banana(np.c_[z, np.zeros(len(z))]) + 0.5 * np.log(2.0 * np.pi))

    def along(effect: float) -> float:  # the nuisance integrated out
        middle = 0.5 - 4.0 * effect - 0.5 * effect**2
        square = effect**2 + middle**2 / (1.0 + sd**2)
        return float(np.exp(-0.5 * square)) * sd / np.sqrt(2.0 * np.pi * (1.0 + sd**2))

    wanted = np.log(quad(along, -8.0, 8.0, points=[0.1])[0])
    bent, base = hypothesis(banana, 2), find_mode(alone, 1)
    (found,) = weigh_extensions([bent], [newton_search(bent, base)], base, lambda _: None)
    assert found.unsure > 0.0
    assert abs(found.log_evidence - wanted) < UNSURE_NATS
    told = importance_sampled(found, np.random.default_rng(6), 4_000)
    assert abs(told.log_evidence - wanted) < 4.0 * told.log_evidence_se


def test_a_second_sampling_starts_from_the_proposal_found() -> None:
    """More draws for the best do not search again, and agree with the first within their errors."""
    own = hypothesis(bent, 2)
    rough = Weighed(own, Mode(np.array([0.4, 0.0]), 0.2 * np.eye(2), 0.0), 0.0, 0.0)
    rng = np.random.default_rng(2)
    first = importance_sampled(rough, rng)
    second = importance_sampled(first, rng, 4_000)
    assert second.proposal is first.proposal
    error = np.hypot(first.log_evidence_se, second.log_evidence_se)
    assert abs(first.log_evidence - second.log_evidence) < 4.0 * error
    assert second.z is not None
    assert len(second.z) == 4_000


TWO_MODES: Final = 0.3, 0.1  # widths along three axes
BETWEEN: Final = 1.1  # along the first
SECOND_NATS: Final = 4.0  # of evidence beyond that of the first


def two_modes(z: Array) -> Array:
    """A density with evidence 1 about zero and exp(4) about a second, narrower mode."""
    wide, narrow = TWO_MODES
    away = z - BETWEEN * np.eye(1, z.shape[-1])[0]
    first = -0.5 * (z**2).sum(-1) / wide**2 - z.shape[-1] * np.log(wide)
    second = -0.5 * (away**2).sum(-1) / narrow**2 - z.shape[-1] * np.log(narrow)
    constant = 0.5 * z.shape[-1] * np.log(2.0 * np.pi)
    return np.asarray(np.logaddexp(first, second + SECOND_NATS) - constant)


@pytest.mark.parametrize("is_looked_for", [True, False])
def test_draws_that_reach_a_higher_mode_lead_to_it(
    is_looked_for: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A search that ended at the lesser mode: its draws' weights show the other one."""
    if not is_looked_for:
        monkeypatch.setattr(evidence, "_higher_mode", lambda *_: None)
    lesser = find_mode(two_modes, 3)
    np.testing.assert_allclose(lesser.point, 0.0, atol=0.01)
    rough = Weighed(hypothesis(two_modes, 3), lesser, lesser.log_evidence)
    found = importance_sampled(rough, np.random.default_rng(2), 2_000)
    assert found.log_weights is not None
    effective = 1.0 / np.exp(2.0 * found.log_weights).sum()
    if is_looked_for:
        # the lesser mode, with 1.8 % of the evidence, is out of reach of the narrow one's draws
        assert found.mode.point[0] == pytest.approx(BETWEEN, abs=0.01)
        assert found.log_evidence == pytest.approx(np.log1p(np.exp(SECOND_NATS)), abs=0.1)
        assert effective > 1_000.0
    else:
        assert found.mode.point[0] == pytest.approx(0.0, abs=0.01)
        assert effective < 100.0


def test_a_wall_beside_the_baseline_does_not_end_a_search() -> None:
    """Values of no density within a step: the search ends at what there is. It had raised."""
    free = linear(np.array([[3.0, 0.0], [0.0, 2.0]]), np.array([0.0, 4.0]))

    def walled(z: Array) -> Array:
        return np.where(z[:, 0] < 1e-5, free(z), -np.inf)

    base = Mode(np.zeros(1), np.array([[10.0**-0.5]]), float(free(np.zeros((1, 2)))[0]))
    found = newton_search(hypothesis(walled, 2), base)
    assert found.mode.point == pytest.approx([0.0, 1.6], abs=0.1)
    assert np.isfinite(found.mode.log_evidence)
