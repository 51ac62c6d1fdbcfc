"""Columns of an oscillation are integrated as it swings, and turned as its events start."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cassini_bayes.balance.statistics.rows import Samples
from cassini_bayes.balance.statistics.sampling import RowContext
from cassini_bayes.balance.statistics.turns import Pieces
from cassini_bayes.computing.arrays import Array
from cassini_bayes.effects.oscillation import BalancedRates, Oscillation


def samples_of(time_s: Array, rate_rad_s: Array) -> Samples:
    """Telemetry of an event in which nothing is fired."""
    none = np.zeros((len(time_s), 0))
    return Samples(time_s, np.zeros((len(time_s), 4)), rate_rad_s, *[none] * 3)


def test_an_event_with_a_start_of_its_own_has_columns_turned() -> None:
    """c + i s of an event is that of the fit times its turn; the answer to the body is not turned.

    An event that the search has not seen has no free oscillation, and costs nothing; where all
    start alike it has the same as the others.
    """
    time_s, rng = np.arange(0.0, 400.0, 4.0), np.random.default_rng(1)
    seen, other = (samples_of(time_s, rng.standard_normal((100, 3))) for _ in range(2))
    alike = Oscillation(0.03, 0.002, (1.0, 0.0, 0.0))
    balanced = (BalancedRates.instead(seen.rate_rad_s, seen.rate_rad_s, 1.0),)
    own = replace(alike, turns=((0.6, -1.1),), log_start=3.0, balanced=balanced)
    assert alike.record["starts"] == "alike"
    assert own.record["starts"] == "own"
    assert own.said == "about X, started anew in every event"

    def columns(line: Oscillation, samples: Samples) -> dict[str, Array]:
        counters = (time_s, *[np.zeros((len(time_s), 0))] * 2)
        context = RowContext(time_s, samples.rate_rad_s, samples.rate_rad_s, *counters)
        return {column.name: column.values(context) for column in line.columns(samples)}

    plain, turned, none = columns(alike, seen), columns(own, seen), columns(own, other)
    for of in ("", ":frequency", ":damping"):
        cosine, sine, driven = (f"flexible:{name}{of}" for name in ("cosine", "sine", "driven"))
        c, s = 0.7, 0.3
        z = (c + 1j * s) * (0.6 - 1.1j)
        wanted = z.real * plain[cosine] + z.imag * plain[sine]
        assert c * turned[cosine] + s * turned[sine] == pytest.approx(wanted)
        assert turned[driven] == pytest.approx(plain[driven])
        assert not none[cosine].any()
        assert not none[sine].any()
        assert none[driven].any()
    assert (own.log_start_of(seen), own.log_start_of(other)) == (3.0, 0.0)
    assert alike.log_start_of(seen) == 0.0


@pytest.mark.parametrize("hertz", [0.03, 0.06, 0.1])
def test_a_swing_is_integrated_as_it_swings(hertz: float) -> None:
    """Rows four seconds apart: trapezoids see 0.95 to 0.41 of the integral, columns all of it."""
    time_s = np.arange(0.0, 400.0, 4.0)
    samples = samples_of(time_s, np.zeros((len(time_s), 3)))
    cosine = Oscillation(hertz, 0.0, (1.0, 0.0, 0.0)).columns(samples)[0]
    omega = 2.0 * np.pi * hertz
    pieces = Pieces(time_s, np.array([0, 40, 100]))
    by_rows = pieces.integrated(np.cos(omega * time_s)[:, None])[:, 0]
    exact = pieces.centred(np.sin(omega * time_s)[:, None] / omega)[:, 0]
    assert cosine.over_trapezoids * by_rows == pytest.approx(exact, abs=1e-9 / omega)
    assert cosine.over_trapezoids > 1.04


def test_columns_of_an_event_do_not_depend_on_its_epoch() -> None:
    """An hour later they are the same, slopes as well: damping counts from the first row."""
    rate = np.random.default_rng(1).standard_normal((100, 3))
    line = Oscillation(0.05, 0.003, (0.0, 1.0, 0.0), span_s=400.0)
    each = []
    for start_s in (0.0, 3_600.0):
        time_s = start_s + np.arange(0.0, 400.0, 4.0)
        context = RowContext(time_s, rate, rate, time_s, *[np.zeros((len(time_s), 0))] * 2)
        columns = line.columns(samples_of(time_s, rate))
        each.append(np.stack([column.values(context) for column in columns]))
    first, later = each
    assert later == pytest.approx(first, abs=1e-7 * np.abs(first).max())
    assert first[0, 0] == 1.0
