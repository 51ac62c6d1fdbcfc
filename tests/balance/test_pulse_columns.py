"""Columns of pulses: effective times of all widths at all pulse parameters from a few."""

from __future__ import annotations

import numpy as np
import pytest

from cassini_bayes.balance.statistics.pulse_columns import WIDTHS_S, PulseBasis
from cassini_bayes.computing.arrays import Array
from cassini_bayes.spacecraft.pulses import PULSE_SHAPES

REFERENCE = (0.005, 0.020, 0.050)
WIDTHS = np.array([0.007, 0.015, 0.03, 0.07, 0.125, 0.25, 1.0, 600.0])
SHAPES = ("first_order", "first_order_held", "published_2005")


def drawn_tau(n: int = 2000) -> tuple[Array, Array, Array]:
    """Pulse parameters of the shipped priors: τ_rise 20 ± 2.5 ms, τ_fall 50 ± 20 ms."""
    rng = np.random.default_rng(20261124)
    rise = np.clip(0.020 + 0.0025 * rng.standard_normal(n), 0.012, 0.028)
    fall = np.clip(0.050 + 0.020 * rng.standard_normal(n), 0.005, 0.110)
    return np.full(n, REFERENCE[0]), rise, fall


def errors(shape: str, tau: tuple[Array, Array, Array]) -> Array:
    """Columns times weights less the effective time, (widths, n), s."""
    basis = PulseBasis(PULSE_SHAPES[shape], REFERENCE)
    exact = PULSE_SHAPES[shape].effective_time(WIDTHS[:, None], *tau)
    return basis.columns(WIDTHS) @ basis.weights(tau).T - exact


@pytest.mark.parametrize("shape", SHAPES)
def test_all_widths_are_right_over_the_prior(shape: str) -> None:
    """Over the prior a pulse of any width is known to 50 us rms."""
    found = np.sqrt((errors(shape, drawn_tau()) ** 2).mean(axis=1))
    assert found.max() < 5e-5


@pytest.mark.parametrize("shape", SHAPES)
def test_reference_and_widths_of_the_basis_are_exact(shape: str) -> None:
    """At the reference every width is exact; at any parameters those of the basis are."""
    at_reference = tuple(np.array([value]) for value in REFERENCE)
    assert errors(shape, at_reference) == pytest.approx(0.0, abs=1e-12)
    basis = PulseBasis(PULSE_SHAPES[shape], REFERENCE)
    delay, rise, fall = drawn_tau(5)
    exact = PULSE_SHAPES[shape].effective_time(np.array(WIDTHS_S)[:, None], delay, rise, fall)
    found = basis.columns(np.array(WIDTHS_S)) @ basis.weights((delay, rise, fall)).T
    assert found == pytest.approx(exact, abs=1e-12)


def test_slopes_at_the_reference_are_not_enough() -> None:
    """Control: linear in both time constants, a pulse of 15 ms is a millisecond wrong."""
    g = PULSE_SHAPES["first_order"].effective_time
    (_, rise, fall), step, width = drawn_tau(), 1e-6, 0.015
    by_rise = (g(width, 0.0, 0.020 + step, 0.050) - g(width, 0.0, 0.020 - step, 0.050)) / (2 * step)
    by_fall = (g(width, 0.0, 0.020, 0.050 + step) - g(width, 0.0, 0.020, 0.050 - step)) / (2 * step)
    linear = g(width, 0.0, 0.020, 0.050) + by_rise * (rise - 0.020) + by_fall * (fall - 0.050)
    assert np.sqrt(np.mean((linear - g(width, 0.0, rise, fall)) ** 2)) > 7e-4


def test_rectangular_pulses_have_no_time_constants() -> None:
    """Where nothing depends on the pulse parameters, the first column is all, and the count is."""
    basis = PulseBasis(PULSE_SHAPES["rectangular"], REFERENCE)
    assert basis.columns(WIDTHS)[:, 0] == pytest.approx(WIDTHS)
    assert basis.columns(WIDTHS)[:, 1:-1] == pytest.approx(0.0)
    assert basis.weights(drawn_tau(3)) == pytest.approx(np.array([[1.0, 0.0, 0.0, 0.0, 0.0]] * 3))


def test_unlike_pulses_deliver_what_is_expected_of_them() -> None:
    """Sums of five pulses of 15 to 125 ms: the mean of many is right; that of alike pulses is not.

    The widths' distribution is known from single pulses; of a sum, only the sum is.
    """
    rng = np.random.default_rng(20261125)
    widths = 0.015 * (0.125 / 0.015) ** rng.random((4000, 5))
    usual = 0.015 * (0.125 / 0.015) ** ((np.arange(12) + 0.5) / 12)
    basis = PulseBasis(PULSE_SHAPES["first_order"], REFERENCE, tuple(usual.tolist()))
    true = PULSE_SHAPES["first_order"].effective_time(widths, *REFERENCE).mean(axis=1)
    found = basis.expected_columns(widths.mean(axis=1), np.full(4000, 5.0))[:, 0]
    alike = basis.columns(widths.mean(axis=1))[:, 0]
    assert abs(np.mean(found - true)) < 4e-4
    assert np.mean(alike - true) > 1.5e-3


def test_two_pulses_are_told_by_their_sum() -> None:
    """Of pulses of 7, 63 and 125 ms, two that add up to 132 ms are a short and a long one.

    Taken as two of 66 ms, or of all widths with that mean, they would deliver some 110 or 80 ms too
    much. Two that add up to 126 ms may be two of 63 ms alone; nothing adds up to 30 ms, so that the
    mean of all with this sum is taken.
    """
    usual = (0.007,) * 4 + (0.063,) * 4 + (0.125,) * 4
    shape, tau = PULSE_SHAPES["first_order"], (0.005, 0.02, 0.2)
    basis = PulseBasis(shape, tau, usual)
    mean, two = np.array([0.066, 0.063, 0.015]), np.full(3, 2.0)
    found = 2.0 * basis.expected_columns(mean, two)[:, 0]
    alone = [float(shape.effective_time(np.array([w]), *tau)[0]) for w in (0.007, 0.063, 0.125)]
    assert found[0] == pytest.approx(alone[0] + alone[2], abs=5e-4)
    assert found[1] == pytest.approx(2.0 * alone[1], abs=5e-4)
    alike = 2.0 * basis.columns(mean)[:, 0]
    assert alike[0] - found[0] > 0.1
    assert found[2] != pytest.approx(alike[2], abs=1e-3)
    assert basis.scatter(mean[:2], two[:2])[:, 0, 0] == pytest.approx(0.0, abs=2e-5)


def test_what_unlike_pulses_scatter_is_known() -> None:
    """Sums of pulses of 15 to 125 ms miss their expectation by as much as is stated."""
    rng = np.random.default_rng(20261126)
    usual = 0.015 * (0.125 / 0.015) ** ((np.arange(12) + 0.5) / 12)
    basis = PulseBasis(PULSE_SHAPES["first_order"], REFERENCE, tuple(usual.tolist()))
    for n, ratio in ((2, 0.8), (4, 1.2), (16, 1.05)):
        widths = usual[rng.integers(0, 12, (8000, n))]
        mean, count = widths.mean(axis=1), np.full(8000, float(n))
        true = PULSE_SHAPES["first_order"].effective_time(widths, *REFERENCE).sum(axis=1)
        missed = true - n * basis.expected_columns(mean, count)[:, 0]
        stated = basis.scatter(mean, count)[:, 0, 0].mean()
        assert (missed**2).mean() == pytest.approx(ratio * stated, rel=0.15)
    assert not basis.scatter(usual, np.ones(12)).any()


def test_pulses_too_short_for_the_event_may_have_any_widths() -> None:
    """Two of 104 ms together, where single ones last 63 ms and more, split that in any way.

    Mean and scatter are those of all splits; taken as two of 52 ms, 97 and 7 ms would be 17 ms
    less than expected, with no scatter. Sums that the event's pulses have stay what they are, and
    so do firings of many pulses, of which one may have been cut.
    """
    rng, shape = np.random.default_rng(20261128), PULSE_SHAPES["first_order"]
    usual = tuple(np.linspace(0.063, 0.132, 14).tolist())
    basis, total = PulseBasis(shape, REFERENCE, usual), 0.104
    first = total * rng.random(20_000)
    true = sum(shape.effective_time(part, *REFERENCE) for part in (first, total - first))
    mean, two = np.array([0.5 * total]), np.array([2.0])
    found = 2.0 * basis.expected_columns(mean, two)[0, 0]
    assert found == pytest.approx(true.mean(), abs=3e-4)
    assert basis.scatter(mean, two)[0, 0, 0] == pytest.approx(true.var(), rel=0.05)
    seven = sum(shape.effective_time(np.array([0.007, 0.097]), *REFERENCE))
    alike = 2.0 * basis.columns(mean)[0, 0]
    assert alike - seven == pytest.approx(0.017, abs=0.001)
    assert abs(found - seven) < 3.0 * true.std()
    many = np.array([0.06]), np.array([12.0])
    assert not basis.scatter(*many).any()
    assert basis.expected_columns(*many) == pytest.approx(basis.columns(many[0]))
    near = np.array([0.0625]), two  # as short by chance
    assert not basis.scatter(*near).any()


def test_long_and_equal_pulses_scatter_nothing() -> None:
    """Pulses of 125 ms that are all alike, and single ones of any width."""
    alike = PulseBasis(PULSE_SHAPES["first_order"], REFERENCE, (0.125,) * 12)
    assert not alike.scatter(np.full(3, 0.125), np.array([1.0, 2.0, 5.0])).any()
    unlike = PulseBasis(PULSE_SHAPES["first_order"], REFERENCE, (0.02, 0.05, 0.125))
    assert not unlike.scatter(np.array([0.02, 0.06]), np.ones(2)).any()


def test_slopes_are_those_of_the_effective_time() -> None:
    """1 + (τ_f/τ_r − 1) exp(−w/τ_r) at the reference, of the shortest as well."""
    basis = PulseBasis(PULSE_SHAPES["first_order"], REFERENCE)
    widths = np.array([4e-4, 0.007, 0.02, 0.06, 0.125])
    _, rise, fall = REFERENCE
    exact = 1.0 + (fall / rise - 1.0) * np.exp(-widths / rise)
    assert basis.slopes(widths, np.ones(5))[:, 0] == pytest.approx(exact, rel=0.02)


def test_single_and_equal_pulses_stay_as_they_are() -> None:
    """One pulse has its own width; pulses that are all alike, that of all."""
    usual = (0.02, 0.05, 0.125)
    basis = PulseBasis(PULSE_SHAPES["first_order"], REFERENCE, usual)
    mean = np.array([0.03, 0.02, 0.125, 0.3])
    count = np.array([1.0, 4.0, 4.0, 4.0])
    np.testing.assert_array_equal(basis.expected_columns(mean, count), basis.columns(mean))


@pytest.mark.parametrize("shape", SHAPES)
def test_one_width_is_enough_for_long_pulses(shape: str) -> None:
    """Where single pulses have 125 ms, these are exact, merged ones right to 0.1 ms rms.

    Two columns are zero, and so are their weights. A few short pulses bring all columns back.
    """
    tau = drawn_tau()
    long = PulseBasis(PULSE_SHAPES[shape], REFERENCE, (0.125,) * 8 + (0.25,) * 4)
    widths = np.array([0.125, 0.25, 0.5, 2.0])
    columns, weights = long.columns(widths), long.weights(tau)
    assert not columns[:, 2:-1].any()
    assert not weights[:, 2:].any()
    exact = PULSE_SHAPES[shape].effective_time(widths[:, None], *tau)
    rms = np.sqrt(((columns @ weights.T - exact) ** 2).mean(axis=1))
    assert rms[0] < 1e-12
    assert rms.max() < 1e-4
    mixed = PulseBasis(PULSE_SHAPES[shape], REFERENCE, (0.03,) + (0.125,) * 11)
    assert mixed.columns(widths)[:, 2:-1].any()


@pytest.mark.parametrize(
    ("offset", "share"), [(0.09, 1e-4), (0.01, 1e-4), (-0.01, 0.003), (-0.03, 0.05)]
)
def test_longer_pulses_deliver_what_their_closed_form_says(offset: float, share: float) -> None:
    """Weights of an offset make columns of every width those of pulses that go on for longer.

    Within a ``share`` of the offset, rms, of all widths from 15 ms on: a ten-thousandth, but for
    widths that are shorter than what a negative one takes. Controls: without the count of pulses
    short ones are off by a twentieth of the offset and more; a longer or shorter tail is half of it
    off, as short pulses have hardly begun to thrust.
    """
    shape, tau = PULSE_SHAPES["first_order"], (0.005, 0.02, 0.033)
    widths = np.geomspace(0.015, 0.25, 30)
    basis = PulseBasis(shape, REFERENCE, tuple(widths.tolist()))
    taus = tuple(np.array([value]) for value in tau)
    gained = basis.columns(widths) @ basis.longer(taus, np.array([[offset]]))[0, 0]
    left = np.maximum(widths + offset, 0.0)
    wanted = shape.effective_time(left, *tau) - shape.effective_time(widths, *tau)
    assert np.sqrt(np.mean((gained - wanted) ** 2)) < share * abs(offset)
    columns = basis.columns(widths)[:, :-1]
    without = columns @ np.linalg.lstsq(columns, wanted, rcond=None)[0]
    assert np.abs(without - wanted).max() > 0.05 * abs(offset)
    tail = (tau[0], tau[1], tau[2] + offset)
    later = shape.effective_time(widths, *tail) - shape.effective_time(widths, *tau)
    assert np.abs(later - wanted).max() > 0.5 * abs(offset)
    assert not basis.longer(taus, np.zeros((1, 1))).any()


def test_weights_of_longer_pulses_have_no_edges() -> None:
    """Where no width is known: pulses end to deliver one after the other, not all at 12 or 40 ms.

    With g(w + offset) at the widths of the columns alone (negative control) slopes jump there by
    all their size; between the 24 widths that weights are fitted to, by two fifths of it.
    """
    shape = PULSE_SHAPES["first_order"]
    basis = PulseBasis(shape, REFERENCE)
    taus = tuple(np.array([value]) for value in REFERENCE)
    offsets = np.linspace(-0.06, 0.02, 401)
    columns = basis.columns(np.array([0.02, 0.05, 0.125]))

    def jumps(weights: np.ndarray) -> np.ndarray:
        """The largest of every width over the range of its slopes."""
        slopes = np.diff(columns @ weights.T) / np.diff(offsets)
        return np.abs(np.diff(slopes)).max(axis=1) / np.ptp(slopes, axis=1)

    fitted = np.concatenate([basis.longer(taus, np.full((1, 1), o))[0] for o in offsets])
    moved = np.maximum(np.array(WIDTHS_S) + offsets[:, None], 0.0)
    at_nodes = np.zeros_like(fitted)
    at_nodes[:, 0] = 1.0
    at_nodes[:, 1:-1] = shape.effective_time(moved, *REFERENCE) - shape.effective_time(
        np.array(WIDTHS_S), *REFERENCE
    )
    assert (jumps(fitted) < 0.5).all()
    assert jumps(at_nodes).max() > 0.8
