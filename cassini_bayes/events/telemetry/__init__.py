"""Telemetry of an event: its description, and its rows as a stream of checked chunks.

``docs/reference/telemetry-format.md`` tells the format, and what is refused or mended.
"""

from __future__ import annotations

from cassini_bayes.events.telemetry.chunk import Chunk
from cassini_bayes.events.telemetry.event import TelemetryEvent, read_event
from cassini_bayes.events.telemetry.mends import Mend, Mends
from cassini_bayes.events.telemetry.reader import load_event, read_chunks

__all__ = ["Chunk", "Mend", "Mends", "TelemetryEvent", "load_event", "read_chunks", "read_event"]
