"""What the page of published cases says of widths, gains and doubtful draws."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from cassini_bayes.diagnosis.score import HeldOut
from cassini_bayes.studies.published_cases import a_branch, fsds
from cassini_bayes.studies.published_diagnosis import estimate_section
from cassini_bayes.studies.published_sections import Section, gain_table


@cache
def branch() -> Section:
    """Case (d) at every width."""
    return estimate_section("d", a_branch()[1], 1)


def test_the_a_branch_turns_on_the_prior_width() -> None:
    """``unknown`` at default width, the far shift at double width; numbers of the recomputation."""
    text = branch().verdict_sentence()
    assert "Most probable: `unknown` (1.00)" in text
    assert "`center_of_mass:y` at width × 2" in text
    assert branch().log_bayes_factor["center_of_mass:y"] == pytest.approx(22.5, abs=0.1)
    assert branch().verdict.named("center_of_mass:y").log_evidence_se < 0.05
    assert branch().sizes["center_of_mass:y"].split("cm_y shift (m) ")[1].startswith("-0.13")


def test_draws_and_gain_are_told() -> None:
    """Eight thrusters left out in turn; no hypothesis's draws are doubtful."""
    assert "each of 8 estimates in turn." in branch().details
    assert "| `center_of_mass:y` | +" in branch().details
    assert "effective, Pareto k̂" in branch().details
    assert "not to be relied upon" not in branch().details


def test_one_estimate_cannot_be_left_out() -> None:
    """The test-bed case has a single thrust: its gain is not measurable."""
    assert "not measurable" in estimate_section("c", fsds(), 1).details


@pytest.mark.parametrize(
    ("differences", "ratio", "verdict"),
    [
        ([2.0, 3.0, 2.5], 0.9, "gain"),
        ([2.0, 3.0, 2.5], 5.0, "no gain"),
        ([9.0, 0.1, -0.2], 0.9, "no gain"),
        ([-1.0, -1.1], 0.9, "no gain"),
        ([4.5, 5.5, 228.0], 0.8, "gain"),
        ([4.5, 5.5, 228.0], 0.92, "no gain"),
        ([4.5, -5.5, 228.0], 0.8, "no gain"),
    ],
)
def test_gain_takes_two_standard_errors_or_what_chance_never_has(
    differences: list[float], ratio: float, verdict: str
) -> None:
    """A sum that one event makes alone, a loss, or larger residuals are no gain.

    Unless the sum is large, no event loses, and residuals are smaller.
    """
    base = HeldOut(np.zeros(len(differences)), 1.0, 0.9)
    scores = {"cause": HeldOut(np.array(differences), ratio, 0.9)}
    assert gain_table("each event", "N", base, scores).endswith(f" | {ratio:.3f} | {verdict} |")
