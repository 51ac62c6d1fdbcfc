"""The same data under two names: they would count twice."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence

import numpy as np

from cassini_bayes.errors import InputError
from cassini_bayes.events.plausibility.verdict import STRICT, Findings, Policy
from cassini_bayes.events.totals import TotalsEvent


def content_of_totals(event: TotalsEvent) -> str:
    """Digest of what a row measured, whatever it is called."""
    arrays = (event.rwa_start_rpm, event.rwa_end_rpm, event.on_time_s)
    optional = (event.pulses, event.delta_v_m_s)
    numbers = [*arrays, *(np.zeros(0) if a is None else a for a in optional)]
    digest = hashlib.sha256(f"{event.branch} {event.wheels} {event.duration_s}".encode())
    for array in numbers:
        digest.update(f"{array.shape}".encode() + array.tobytes())
    return digest.hexdigest()


def refuse_duplicates(
    contents: Sequence[tuple[str, str]], policy: Policy = STRICT
) -> tuple[str, ...]:
    """Refuse data that are there twice, by content, not by name.

    Parameters
    ----------
    contents
        Where each event came from, and the digest of what it holds.

    Raises
    ------
    InputError
        Two events hold the same.
    """
    findings = Findings(policy)
    first: dict[str, str] = {}
    for where, content in contents:
        if first.get(content) == where:
            raise InputError(where, "each event once", "the same event twice", "leave one out")
        if content in first:
            findings.refuse(
                "same-telemetry",
                where,
                "each event's data once",
                f"the data of {first[content]} under another name",
                "leave one of the two out: they would count twice",
            )
        first.setdefault(content, where)
    return tuple(findings.sentences)
