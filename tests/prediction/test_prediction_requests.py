"""What can be asked of a prediction: every refusal says what to change."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from prediction_cases import flights

from cassini_bayes.errors import InputError
from cassini_bayes.prediction.beliefs import read_beliefs
from cassini_bayes.prediction.requests import (
    BiasRequest,
    check_ids,
    check_request,
    parse_bias,
    parse_epoch,
    parse_quaternion,
    parse_rates,
    read_requests,
    request_of,
)

CRAFT = flights()[1].spacecraft
START = datetime(2009, 8, 22, tzinfo=UTC)
LINE = "rwa1: -1118 -> 626, rwa2: 1290 -> 1300, rwa4: 330 -> -729"


def test_a_line_of_text_is_read() -> None:
    """Wheels in order of number, signs and decimals kept; arrows of three kinds."""
    request = parse_bias("rwa4: 330.5 to -729, rwa1: -1118 → 626", CRAFT)
    assert request.wheels == (1, 4)
    np.testing.assert_allclose(request.start_rpm, [-1118, 330.5])
    np.testing.assert_allclose(request.end_rpm, [626, -729])


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("rwa1: 0", "start -> end"),
        ("rwa9: 0 -> 5", "rwa1"),
        ("rwa1: 0 -> 5, rwa1: 0 -> 6", "twice"),
        ("rwa1: 0 -> nan", "rev/min"),
        ("", "start -> end"),
    ],
)
def test_bad_lines_are_refused(text: str, said: str) -> None:
    """What is not a wheel with two rates is named, with an example."""
    with pytest.raises(InputError, match=said):
        parse_bias(text, CRAFT)


@pytest.mark.parametrize(
    ("text", "branch", "epoch", "said"),
    [
        ("rwa3: 0 -> 500", None, None, "not prime"),
        ("rwa1: 0 -> 2001", None, None, "within ±2000"),
        ("rwa1: -2000.5 -> 0", None, None, "within ±2000"),
        ("rwa1: 0 -> 500", "C", None, "one of A, B"),
        ("rwa1: 0 -> 500", "A", None, "branch B"),
        ("rwa1: 0 -> 500", None, "2009-08-21", "from 2009-08-22 on"),
        ("rwa1: 500 -> 500", None, None, "changes its rate"),
    ],
)
def test_what_cannot_be_flown_is_refused(
    text: str, branch: str | None, epoch: str | None, said: str
) -> None:
    """Wheel not prime, speed beyond the limit, unknown branch, epoch before the data."""
    asked = parse_bias(text, CRAFT)
    when = None if epoch is None else parse_epoch(epoch)
    request = BiasRequest(asked.id, asked.wheels, asked.start_rpm, asked.end_rpm, when, branch)
    with pytest.raises(InputError, match=said):
        check_request(request, CRAFT, "B", (1, 2, 4), START)


def test_the_limits_themselves_are_allowed() -> None:
    """±2000 rev/min, the first day and the fit's own branch pass."""
    asked = parse_bias("rwa1: -2000 -> 2000", CRAFT)
    request = BiasRequest("x", asked.wheels, asked.start_rpm, asked.end_rpm, START, "B")
    check_request(request, CRAFT, "B", (1, 2, 4), START)


def test_a_spacecraft_with_faster_wheels_has_a_limit_of_its_own() -> None:
    """5000 rev/min of wheels that may be planned so; beyond it the file is named."""
    fast = replace(CRAFT, planned_wheel_rpm=(0.0, 5_000.0))
    for size, passes in ((5_000.0, True), (5_001.0, False)):
        asked = BiasRequest("x", (1,), np.array([0.0]), np.array([size]), START, "B")
        if passes:
            check_request(asked, fast, "B", (1, 2, 4), START)
            continue
        with pytest.raises(InputError, match="within ±5000 rev/min, got 5001; plan a slower"):
            check_request(asked, fast, "B", (1, 2, 4), START)


def test_a_request_of_an_event_has_nothing_that_was_flown() -> None:
    """Only id, wheels, rates, epoch and branch of an event come over."""
    event = flights()[0][0]
    request = request_of(event)
    assert set(vars(request)) == {
        *("id", "wheels", "start_rpm", "end_rpm", "epoch", "branch", "quaternion")
    }
    assert request.epoch == event.epoch


@pytest.mark.parametrize("text", ["1 0 0", "0 0 0 2", "a b c d"])
def test_bad_quaternions_are_refused(text: str) -> None:
    """Four numbers of unit norm."""
    with pytest.raises(InputError, match="unit norm"):
        parse_quaternion(text)


def test_bad_epochs_and_rates_are_refused() -> None:
    """With an example each."""
    with pytest.raises(InputError, match="2010-04-15"):
        parse_epoch("next week")
    with pytest.raises(InputError, match="rwa1: -1118"):
        parse_rates("rwa1 = 5", CRAFT, "--from")
    assert parse_rates("rwa1: 5, rwa4: -7", CRAFT, "--from") == {1: 5.0, 4: -7.0}
    with pytest.raises(InputError, match="--from: expected every wheel once, got rwa1 twice"):
        parse_rates("rwa1: 500, rwa1: 700", CRAFT, "--from")


@pytest.mark.parametrize("rate", ["9" * 100_000, "9" * 100_000 + "x", "1." + "3" * 100_000])
def test_rates_have_few_digits(rate: str) -> None:
    """Digits without end are refused at once, not taken as an infinite rate."""
    with pytest.raises(InputError, match="rev/min"):
        parse_bias(f"rwa1: 0 -> {rate}", CRAFT)
    with pytest.raises(InputError, match="rev/min"):
        parse_rates(f"rwa1: {rate}", CRAFT, "--from")


def test_a_file_of_biases_is_read(tmp_path: Path) -> None:
    """Empty cells are wheels that are not prime; epoch and quaternion are optional."""
    path = tmp_path / "biases.csv"
    path.write_text(
        "id,rwa1_rpm_start,rwa1_rpm_end,rwa2_rpm_start,rwa2_rpm_end,epoch,q1,q2,q3,q4\n"
        "first,-100,400,,,2010-05-01,0,0,0,1\nsecond,5,6,7,8,,,,,\n"
    )
    first, second = read_requests(path, CRAFT)
    assert (first.wheels, second.wheels) == ((1,), (1, 2))
    assert first.epoch == datetime(2010, 5, 1, tzinfo=UTC)
    assert first.quaternion == (0.0, 0.0, 0.0, 1.0)
    assert second.epoch is None
    assert second.quaternion is None
    path.write_text("id,rwa1_rpm_start,rwa1_rpm_end\nx,5,\n")
    with pytest.raises(InputError, match="rwa1_rpm_end"):
        read_requests(path, CRAFT)
    path.write_text("id,rwa1_rpm_start,rwa1_rpm_end\nx,,\n")
    with pytest.raises(InputError, match="at least one wheel"):
        read_requests(path, CRAFT)


@pytest.mark.parametrize("name", ["../escape", "a/b", "a\\b", ".hidden", "", "a\nb", "x" * 61])
def test_ids_are_plain_names(name: str) -> None:
    """An id becomes the name of a figure, so that it leads to no other folder."""
    with pytest.raises(InputError, match=r"b\.csv: id: expected up to 60 letters"):
        check_ids("b.csv", ["first", name])


def test_ids_are_all_different() -> None:
    """Two biases of one id would overwrite each other's figure; the dates of events pass."""
    with pytest.raises(InputError, match="'same' twice"):
        check_ids("b.csv", ["same", "other", "same"])
    check_ids("b.csv", ["2009-08-22-bias", "Bias 2.1+x", "übung"])


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("[event_spread]", "[event_spred]", "event_spread"),
        ('unit = "s/rpm"', 'unit = "s"', "s/rpm"),
        ('dist = "halfnorm"\nscale = 0.25', 'dist = "norm"\nscale = 0.25', "positive"),
        ('dist = "norm"\nloc = 16.0', 'dist = "gumbel_r"\nloc = 16.0', "integrated out"),
        ('source = "firings', 'low = 0.0\nsauce = "firings', "with dist, unit and source"),
    ],
)
def test_a_bad_file_of_priors_is_refused(tmp_path: Path, old: str, new: str, said: str) -> None:
    """Unknown names, wrong units and unusable distributions are named."""
    import cassini_bayes.prediction as package

    text = (Path(package.__file__).parent / "prediction.toml").read_text()
    assert old in text
    path = tmp_path / "prediction.toml"
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(InputError, match=said):
        read_beliefs(path)


def test_a_file_of_priors_replaces_those_that_it_has(tmp_path: Path) -> None:
    """One table suffices; what the package believes of whole pulses goes with the control cycle."""
    path = tmp_path / "mine.toml"
    path.write_text(
        '[wheel_ramp_s_per_rpm]\ndist = "norm"\nloc = 1.2\nscale = 0.1\n'
        'unit = "s/rpm"\nsource = "x"\n'
    )
    ours, mine, slow = read_beliefs(), read_beliefs(path), read_beliefs(path, 1.0)
    assert mine.moments("wheel_ramp_s_per_rpm") == slow.moments("wheel_ramp_s_per_rpm")
    assert mine.moments("wheel_ramp_s_per_rpm") == (1.2, 0.1)
    assert mine.moments("wheel_loop_s") == ours.moments("wheel_loop_s")
    assert slow.moments("pulses_per_second") == pytest.approx((0.95, 0.05))
    assert slow.moments("minor_quantum_s")[0] == pytest.approx(
        8.0 * ours.moments("minor_quantum_s")[0]
    )
    assert slow.moments("event_spread") == ours.moments("event_spread")


def asked(**changed: object) -> BiasRequest:
    """A request for two wheels, as a program makes it, something of it changed."""
    given: dict[str, object] = {
        "id": "a",
        "wheels": (1, 2),
        "start_rpm": [0.0, 10.0],
        "end_rpm": [100.0, 500.0],
    }
    return BiasRequest(**(given | changed))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"start_rpm": [float("nan"), 10.0]}, "start_rpm: expected one finite rate"),
        ({"end_rpm": [100.0]}, "for each of 2 wheels"),
        ({"wheels": (1, 1)}, "wheel 1 twice"),
        ({"wheels": (), "start_rpm": [], "end_rpm": []}, "of at least one"),
        ({"quaternion": (0.0, 0.0, 0.0, 3.0)}, "of unit norm"),
    ],
)
def test_a_request_of_a_program_is_checked(changed: dict[str, object], said: str) -> None:
    """What cannot be a bias is refused where the request is made."""
    with pytest.raises(InputError, match=said):
        asked(**changed)


def test_a_request_without_a_zone_is_in_utc_and_unknown_wheels_are_named() -> None:
    """As texts are; a wheel that the spacecraft lacks is no prime wheel."""
    request = asked(epoch=datetime(2011, 1, 1))  # noqa: DTZ001  that it has none is the case
    assert request.epoch == datetime(2011, 1, 1, tzinfo=UTC)
    check_request(request, CRAFT, "B", (1, 2, 4), START)
    with pytest.raises(InputError, match="wheel 7, which is not prime"):
        check_request(asked(wheels=(1, 7)), CRAFT, "B", (1, 2, 4), START)
