"""Prior means that data are checked against: refused where they contradict the spacecraft."""

from __future__ import annotations

from dataclasses import replace

import pytest
from spacecraft_cases import priors_of

from cassini_bayes.errors import InputError
from cassini_bayes.model.nominal import nominal_values


def test_reversed_pairs_are_refused_before_telemetry_is_read() -> None:
    """Totals were refused with such a file, telemetry was fitted with it."""
    priors = priors_of("twelve")
    assert nominal_values(priors)
    pairs = dict(priors.spacecraft.axis_pairs)
    pairs["+x"], pairs["-x"] = pairs["-x"], pairs["+x"]
    turned = replace(priors, spacecraft=replace(priors.spacecraft, axis_pairs=pairs))
    with pytest.raises(InputError, match=r"axis_pairs\.\+x .*whose torque about x is positive"):
        nominal_values(turned)
