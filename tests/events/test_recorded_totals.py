"""Totals of a recorded wheel bias against those that the simulation wrote beside it."""

from __future__ import annotations

import numpy as np
import pytest
from event_cases import priors, simulated

from cassini_bayes.errors import InputError
from cassini_bayes.events.recorded_totals import is_bias, recorded_totals
from cassini_bayes.events.telemetry import read_event
from cassini_bayes.events.totals import read_totals


def test_a_recording_gives_the_totals_that_were_flown() -> None:
    """On-times to the counters' step, pulses exactly, wheel rates within their noise."""
    spacecraft = priors().spacecraft
    (flown,) = read_totals(str(simulated() / "totals.csv"), spacecraft, "simulation")
    found = recorded_totals(read_event(simulated() / "bias", spacecraft), spacecraft)
    assert (found.id, found.epoch, found.branch) == (flown.id, flown.epoch, flown.branch)
    assert (found.wheels, found.thrusters) == (flown.wheels, flown.thrusters)
    np.testing.assert_allclose(found.on_time_s, flown.on_time_s, atol=0.002)
    np.testing.assert_array_equal(found.pulses, flown.pulses)
    np.testing.assert_allclose(found.rwa_start_rpm, flown.rwa_start_rpm, atol=1.5)  # noise 0.2 rpm
    np.testing.assert_allclose(found.rwa_end_rpm, flown.rwa_end_rpm, atol=1.5)
    assert found.duration_s == pytest.approx(flown.duration_s, abs=1.0)
    assert found.delta_v_m_s is None
    assert found.hydrazine_g is None


def test_a_slew_has_no_totals() -> None:
    """Negative control: without firings there is nothing to print."""
    spacecraft = priors().spacecraft
    slews = read_event(simulated() / "slews", spacecraft)
    assert not is_bias(slews)
    with pytest.raises(InputError, match="expected a wheel bias"):
        recorded_totals(slews, spacecraft)
