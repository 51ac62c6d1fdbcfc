"""The verdict in sentences: the answer first with size and unit, and why numbers differ."""

from __future__ import annotations

import pytest
from diagnosis_record_cases import CAUSE, SAYS, cause, named, record

from cassini_bayes.report.diagnosis_verdict import alike_nothing, verdict_sentences


def test_the_first_sentence_has_size_probability_gain_and_p_value() -> None:
    """In engineering units, with the kind of the interval."""
    first = verdict_sentences(named())[0]
    assert first == (
        "Z3 delivers 74 ± 4 % (90 % HDI 66 to 80 %) of its thrust; probability 0.957; held out "
        "+9.7 ± 1.2 nats over three events; p = 0.12 for the baseline."
    )


def test_a_large_p_value_beside_a_probable_cause_is_explained_by_what_bends() -> None:
    """Names what takes the effect up; says nothing of the kind where p is small."""
    bent = [{"quantity": "thrust level of Z3", "baseline": -2.7, "extended": -0.01}]
    second = verdict_sentences(named(taken_up=bent))[1]
    assert "p = 0.12 and no symptom" in second
    assert "thrust level of Z3 (−2.7 prior σ, with the cause 0.0)" in second
    assert not any("although" in s for s in verdict_sentences(named(p_value=0.003)))


def test_no_sure_gain_beside_a_probable_cause_is_explained() -> None:
    """Held-out events that show nothing do not contradict the probability."""
    gain = named()["gain"] | {"elpd_diff": 1.7, "elpd_diff_se": 5.7, "verdict": "no gain"}
    sentences = verdict_sentences(named(gain=gain))
    assert any("no sure gain (less than two standard errors" in s for s in sentences)
    assert any("predicts nearly as well" in s for s in sentences)
    large = gain | {"elpd_diff": 600.0, "elpd_diff_se": 580.0}
    assert not any("predicts nearly as well" in s for s in verdict_sentences(named(gain=large)))


@pytest.mark.parametrize(("p", "expected"), [(0.02, "chance alone leaves as much"), (0.5, "")])
def test_nothing_named_with_a_small_p_value_is_a_hint(p: float, expected: str) -> None:
    """The baseline stands, and the small p-value is put in its place; a large one needs no word."""
    sentences = verdict_sentences(record(cause("none", 0.95, 0.0), p_value=p))
    assert sentences[0].startswith("Nothing is missing: the baseline explains three events")
    assert any("chance alone" in s for s in sentences) == bool(expected)


def test_unknown_names_runner_up_peak_drivers_and_draft() -> None:
    """Each of what helps stands in a sentence of its own."""
    left = {"name": CAUSE, "behind_unknown_nats": 32555.0, "rmse_nms": 0.08, "p_value": 0.002}
    line = {"event": "a", "axis": "x", "peak_hz": 0.21, "power": 80.0, "share": 0.6, "chance": 0.0}
    driver = {"driver": "speed of rwa2", "event": "a", "axis": "x", "z": -16.0, "band_z": 3.7}
    draft = {
        "name": "draft_thrust",
        "says": "all thrusters push 10.4 ± 0.2 % more from t = 285 s on",
        "heldout_gain_nats": 2687.0,
        "heldout_gain_se_nats": 547.0,
        "held_out": "event",
        "is_gain": True,
    }
    whole = record(
        cause("unknown", 1.0, 36000.0),
        cause(CAUSE, 0.0, 3445.0, says=SAYS),
        cause("none", 0.0, 0.0),
        runner_up=left,
        spectrum=[line],
        drivers=[driver],
        drafts=[draft],
    )
    text = "\n".join(verdict_sentences(whole))
    assert "p = 0.12 does not see it" in text
    assert f"32,555.0 nats behind unknown: {SAYS}. It leaves RMS 0.08 N m s" in text
    assert "peaks at 0.21 Hz (a period of 4.76 s) about X in a" in text
    assert "speed of rwa2 (−16 σ)" in text
    assert "+2,687 ± 547 nats, each event held out" in text
    assert "drafts/draft_thrust.py" in text
    assert "about unknown" in text
    more = record(cause(CAUSE, 1.0, 40.0, says=SAYS), cause("none", 0.0, 0.0), drafts=[draft])
    assert "held out in turn, in the linear model about what is named" in "\n".join(
        verdict_sentences(more)
    )
    no_gain = record(*whole["causes"], drafts=[draft | {"is_gain": False}])
    assert "No drafted effect predicts" in "\n".join(verdict_sentences(no_gain))


def test_forty_confounded_causes_are_a_count() -> None:
    """Four names, the rest counted; and causes near none are those within three nats of it."""
    many = [f"thruster_leak:{i}" for i in range(40)]
    best = cause(CAUSE, 0.5, 2.0, says=SAYS, confounded_with=many)
    sentences = verdict_sentences(record(best, cause("none", 0.4, 0.0)))
    (line,) = [s for s in sentences if "cannot tell" in s]
    assert line.endswith("thruster_leak:3 and 36 others.")
    none = record(cause("none", 0.9, 0.0), cause("a", 0.01, -2.9), cause("b", 0.0, -3.1))
    assert alike_nothing(none) == ["a"]


def test_nothing_named_says_what_would_have_been_seen() -> None:
    """Of each kind the target that is seen least, in words; what would have stayed hidden is not.

    Negative control: where a cause is named, nothing of it.
    """

    def row(name: str, thruster: str | None, says: str | None) -> dict[str, object]:
        return {"cause": name, "thruster": thruster, "says": says}

    rows = [
        row("rate_bias:x", None, "the gyro reads ±1 µrad/s or more too much about X"),
        row("thruster_degraded:z1", "z1", "Z1 delivers 90 % or less of its thrust"),
        row("thruster_degraded:z3", "z3", "Z3 delivers 80 % or less of its thrust"),
        row("center_of_mass:y", None, None),
    ]
    nothing = record(cause("none", 0.9, 0.0), cause("unknown", 0.1, -1.0), visible=rows)
    assert verdict_sentences(nothing)[-1] == (
        "Nine of ten such flights would have shown, at odds of nine to one: Z3 delivers 80 % or "
        "less of its thrust; the gyro reads ±1 µrad/s or more too much about X."
    )
    assert not any("would have" in sentence for sentence in verdict_sentences(named(visible=rows)))
