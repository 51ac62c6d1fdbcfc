"""Telemetry of an event: its description, and its rows as a stream of checked chunks.

``docs/reference/telemetry-format.md`` has the format, and what is refused or repaired.
"""

from __future__ import annotations

from cassini_bayes.events.telemetry.channel_map import ChannelMap, read_channel_map
from cassini_bayes.events.telemetry.chunk import Chunk
from cassini_bayes.events.telemetry.event import TelemetryEvent, event_from_frame, read_event
from cassini_bayes.events.telemetry.mends import Mend, Mends
from cassini_bayes.events.telemetry.reader import load_event, read_chunks

__all__ = [
    "ChannelMap",
    "Chunk",
    "Mend",
    "Mends",
    "TelemetryEvent",
    "event_from_frame",
    "load_event",
    "read_channel_map",
    "read_chunks",
    "read_event",
]
