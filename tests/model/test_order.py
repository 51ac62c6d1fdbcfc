"""Events in order of time, by their epochs."""

from __future__ import annotations

from dataclasses import replace

from event_cases import events

from cassini_bayes.model.order import in_order_of_time


def test_epochs_decide_whatever_the_order_given() -> None:
    """The bias is of May, the slews of July; without an epoch the order given stays."""
    bias, slews = events("bias", "slews")
    assert in_order_of_time([slews, bias]) == ("bias", "slews")
    assert in_order_of_time([replace(slews, epoch=None), bias]) == ("slews", "bias")
    assert in_order_of_time([replace(slews, epoch=bias.epoch), bias]) == ("slews", "bias")
