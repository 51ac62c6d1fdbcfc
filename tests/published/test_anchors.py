"""Printed thrusts over the years: where each stands, and that their order in time is not one."""

from __future__ import annotations

import datetime

import pytest

from cassini_bayes.errors import InputError
from cassini_bayes.published.anchors import anchors, text_anchors, thrust_anchors


def test_every_thrust_that_is_printed_is_there() -> None:
    """Launch, June 2004, Probe relay, five biases of 2005, Tables 1 and 2, eight events, 2011."""
    thrusts = [a for a in anchors() if a.quantity == "thrust"]
    counts = {
        paper: sum(a.paper == paper for a in thrusts) for paper in ("000", "001", "003", "004")
    }
    # 000: three in the text, five biases three ways; 003: 8 + 4 and 8 + 8
    assert counts == {"000": 18, "001": 8, "003": 28, "004": 1}
    assert [a.date for a in anchors()] == sorted(a.date for a in anchors())


def test_kinds_are_told_apart() -> None:
    """The figures of the text, by kind; a constant on board is no measurement."""
    first = thrust_anchors("prediction")[0]
    assert (first.date, first.value.value) == (datetime.date(1997, 10, 15), 0.97)
    stale = {a.value.value for a in thrust_anchors("flight_software")}
    assert stale == {0.676, 0.69}


def test_software_constants_do_not_fall_with_time() -> None:
    """0.676 N in December 2011 and 0.69 N in 2012 contradict a thrust that only falls."""
    in_order = [a.value.value for a in thrust_anchors("flight_software")]
    assert in_order[0] < in_order[-1]


def test_an_unknown_kind_is_refused() -> None:
    """The kind decides what a figure may be used for."""
    header = "date,branch,quantity,value,unit,kind,paper,place\n"
    with pytest.raises(InputError, match="kind: expected measurement"):
        text_anchors(header + "1997-10-15,A,thrust,0.97,N,guess,000,here\n")
