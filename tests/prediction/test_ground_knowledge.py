"""What past events teach of durations and trends: also where they are unlike Cassini's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from prediction_cases import SIZE, beliefs, flights

from cassini_bayes.errors import InputError
from cassini_bayes.events.totals import TotalsEvent
from cassini_bayes.prediction.beliefs import Beliefs
from cassini_bayes.prediction.ground_knowledge import manager_regression, trend_of
from cassini_bayes.prediction.wheel_profile import WheelManager, duration_s
from cassini_bayes.priors.distributions import Distribution


def flown(manager: WheelManager) -> tuple[TotalsEvent, ...]:
    """The flight events with the durations that a wheel manager gives."""
    return tuple(
        replace(e, duration_s=duration_s(manager, e.wheels, e.rwa_end_rpm - e.rwa_start_rpm))
        for e in flights()[0]
    )


def with_ramp(mean: float, sd: float) -> Beliefs:
    """The beliefs with another prior of the ramps."""
    ramp = Distribution("norm", {"loc": mean, "scale": sd})
    return Beliefs({**beliefs().distributions, "wheel_ramp_s_per_rpm": ramp})


def test_the_slowest_wheel_is_the_one_that_ramps_longest() -> None:
    """Wheel 4 takes twice as long per rev/min, and is slowest in two events in which another one
    changes most. Ramps and durations come out; of wheel 2 only a bound is told.
    """
    events = flown(WheelManager({1: 0.5, 2: 0.5, 4: 1.0}, 16.0))
    rng = np.random.default_rng(1)
    found = manager_regression(events, (1, 2, 4), with_ramp(0.6, 0.3), rng, SIZE)
    mean, sd = found.coefficients.mean(0), found.coefficients.std(0)
    assert (np.abs(mean - [0.5, mean[1], 1.0, 16.0]) < 4.0 * sd).all()
    assert (sd[:3] < 0.02).all()
    for event in events:
        change = event.rwa_end_rpm - event.rwa_start_rpm
        manager = WheelManager(dict(zip((1, 2, 4), mean[:3].tolist(), strict=True)), mean[3])
        assert duration_s(manager, event.wheels, change) == pytest.approx(event.duration_s, abs=1.0)


def test_durations_that_end_before_the_wheels_settle_are_refused() -> None:
    """Recordings that stop with the ramp have no positive loop time, and say so in one line."""
    short = [replace(e, duration_s=e.duration_s - 90.0) for e in flights()[0]]
    with pytest.raises(InputError, match=r"duration_s .* loop time τ of -\d.*--beliefs"):
        manager_regression(tuple(short), (1, 2, 4), beliefs(), np.random.default_rng(1), SIZE)


def test_loop_times_are_positive_in_every_draw() -> None:
    """Durations that leave the loop time near nothing: draws of it are positive all the same."""
    events = flown(WheelManager({1: 0.562, 2: 0.562, 4: 0.562}, 1.0))
    rng = np.random.default_rng(1)
    found = manager_regression(events, (1, 2, 4), beliefs(), rng, SIZE)
    assert (found.coefficients > 0.0).all()


def test_a_trend_is_that_of_the_events_that_have_the_value() -> None:
    """One cell less moves the line a little; none at all is no trend."""
    epochs = [event.epoch for event in flights()[0]]
    values: list[float | None] = [event.thrust_predicted_n for event in flights()[0]]
    late = epochs[-1].replace(year=epochs[-1].year + 2)
    at = []
    for given in (values, [*values[:4], None, *values[5:]]):
        trend = trend_of(epochs, given, 0.005, np.random.default_rng(1), 4_000)
        assert trend is not None
        at.append(trend.at(late))
    assert at[1].mean() == pytest.approx(at[0].mean(), abs=0.5 * at[0].std())
    nothing: list[float | None] = [None] * len(epochs)
    assert trend_of(epochs, nothing, 0.005, np.random.default_rng(1), 10) is None
