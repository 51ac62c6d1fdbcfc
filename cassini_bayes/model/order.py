"""The order of events in time, in which effects begin."""

from __future__ import annotations

from collections.abc import Sequence

from cassini_bayes.model.posterior import Event


def in_order_of_time(events: Sequence[Event]) -> tuple[str, ...]:
    """Ids of events by their epochs; as they were given where one has none or two are equal."""
    epochs = {event.id: event.epoch for event in events}
    known = {name: epoch for name, epoch in epochs.items() if epoch is not None}
    return tuple(epochs if len(known) < len(epochs) else sorted(epochs, key=lambda i: known[i]))
