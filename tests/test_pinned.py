"""Numbers that no change of structure may move: densities, moments, evidences, simulated telemetry.

A pin is no oracle: it says that a number is what it was, not that it is right. Numbers are in
``data/pinned.json``, the points at which they were taken in ``data/pinned_inputs.npz``; where a
change of numbers is meant, ``python tests/make_pinned.py`` makes them again. What is pinned is in
``pinned_cases.py``: when modules move, that file alone changes.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from functools import cache, partial
from pathlib import Path
from typing import Any, Final

import numpy as np
import pytest
from pinned_cases import (
    CAUSES,
    CLOSED,
    DRAWN,
    EXACT,
    SOUGHT,
    SUBJECTS,
    WIDER,
    WITH_MOMENTS,
    Subject,
    evidence_draws,
)

from cassini_bayes.computing.arrays import Array

NUMBERS: Final = Path(__file__).parent / "data" / "pinned.json"
INPUTS: Final = Path(__file__).parent / "data" / "pinned_inputs.npz"
FEW: Final = 2  # points at which collapsed blocks are pinned


@cache
def stored() -> Mapping[str, Any]:
    """The pins: ``numbers`` by name, and the ``walked`` parameters of the points in order."""
    found: Mapping[str, Any] = json.loads(NUMBERS.read_text(encoding="utf-8"))
    return found


@cache
def inputs() -> Mapping[str, Array]:
    """Points by name, in double precision."""
    with np.load(INPUTS, allow_pickle=False) as archive:
        return {name: archive[name].astype(np.float64) for name in archive.files}


def pinned(name: str) -> Array:
    """One of the stored numbers."""
    return np.array(stored()["numbers"][name], dtype=np.float64)


def point(what: str, name: str, subject: Subject) -> Array:
    """Stored walked coordinates (..., d) in the subject's own order of parameters."""
    order = stored()["walked"][name]
    return inputs()[f"{what}: {name}"][..., [order.index(own) for own in subject.names]]


def density(name: str) -> Array:
    """Log densities of a subject at its stored points."""
    subject = SUBJECTS[name]()
    return subject.density(point("points", name, subject))


def moments(name: str, what: str) -> Array:
    """Moments of a subject's collapsed blocks at a few of its points."""
    subject = SUBJECTS[name]()
    return subject.moments[what](point("points", name, subject)[:FEW])


def at_mode(name: str) -> Array:
    """Log density of a hypothesis at its stored mode, and Laplace's log evidence there."""
    subject = CAUSES[name].subject()
    mode = point("mode", name, subject)
    evidence = CAUSES[name].laplace(mode, inputs()[f"factor: {name}"])
    return np.array([*subject.density(mode[None]), evidence])


def search(name: str) -> Array:
    """Laplace's log evidence where the search for a hypothesis ends."""
    return np.array([CAUSES[name].sought()[2]])


def drawn(name: str) -> Array:
    """Importance draws about a stored mode."""
    subject = CAUSES[name].subject()
    order = [stored()["walked"][name].index(own) for own in subject.names]
    assert order == sorted(order), "the seed's draws go to parameters in order"
    return evidence_draws(subject, point("mode", name, subject), inputs()[f"factor: {name}"])


DENSITIES: Final = {f"log density: {name}": partial(density, name) for name in SUBJECTS}
MOMENTS: Final = {
    f"{what}: {name}": partial(moments, name, what)
    for name, found in WITH_MOMENTS.items()
    for what in found
}
MODES: Final = {f"at the mode: {name}": partial(at_mode, name) for name in CAUSES}
SEARCHES: Final = {f"search: {name}": partial(search, name) for name in CAUSES}
DRAWS: Final = {f"importance draws: {name}": partial(drawn, name) for name in DRAWN}
ALL: Final[Mapping[str, Callable[[], Array]]] = {
    **EXACT,
    **DENSITIES,
    **MOMENTS,
    **MODES,
    **SEARCHES,
    **DRAWS,
    **CLOSED,
    **SOUGHT,
}
"""Every pin: its name in the file and how it is asked for."""

# Relative tolerances. Rounding differs between processors and with the order of sums; how much was
# measured with code compiled for several processors, whose figure is given.
CLOSED_FORM: Final = 1e-10  # 7e-12, and on one processor nothing
# Gram matrices hold sums of squares that cancel: 9e-11, a millionth of a nat
TELEMETRY: Final = 1e-9
# Tails far below their prior's sd: 3e-9 with statistics summed otherwise
OWN_UNKNOWNS: Final = 1e-8
DRAWN_EVIDENCE: Final = 1e-7  # weights are exponentials of such densities: 1.1e-8
# A search ends a little elsewhere where differences, its slopes, round otherwise: 8e-9
ENDED: Final = 1e-6
NATS: Final = 0.1  # within which Laplace's evidence is good; a search by another processor: 0.055


def off(found: Array, wanted: Array, floor: Array | float = 1.0) -> float:
    """Largest difference relative to the pinned number, or to a floor where that is larger."""
    assert found.shape == wanted.shape
    return float(np.max(np.abs(found - wanted) / np.maximum(np.abs(wanted), floor)))


def off_in_rows(found: Array, wanted: Array) -> float:
    """The same with a thousandth of the largest number of the row as the floor."""
    return off(found, wanted, np.maximum(1e-3 * np.abs(wanted).max(-1, keepdims=True), 1e-300))


def tolerance(name: str) -> float:
    """That of a closed form of totals rows, or of telemetry."""
    if name.startswith("own unknowns"):
        return OWN_UNKNOWNS
    return CLOSED_FORM if ": totals" in name else TELEMETRY


def test_every_pin_is_asked_for() -> None:
    """No stored number is left over, and none is missing."""
    assert set(stored()["numbers"]) == set(ALL)


@pytest.mark.parametrize("name", EXACT)
def test_seeds_give_the_draws_that_pins_lean_on(name: str) -> None:
    """A numpy whose generator gives other draws is seen here first."""
    assert np.array_equal(ALL[name](), pinned(name))


@pytest.mark.parametrize("name", [*SUBJECTS, *CAUSES])
def test_walked_parameters_keep_their_order(name: str) -> None:
    """Densities do not depend on it, the draws of a seed do."""
    subject = SUBJECTS[name]() if name in SUBJECTS else CAUSES[name].subject()
    assert list(subject.names) == stored()["walked"][name]


@pytest.mark.parametrize("name", DENSITIES)
def test_log_densities_stay(name: str) -> None:
    """Collapsed log posterior densities at points within the posterior and far from it."""
    assert off(ALL[name](), pinned(name)) < tolerance(name)


@pytest.mark.parametrize("name", WIDER)
def test_a_prior_wider_by_a_millionth_is_seen(name: str) -> None:
    """Negative control: densities then miss their pins by more than ten tolerances."""
    pin = f"log density: {name}"
    subject = WIDER[name](1.0)
    z = point("points", name, subject)
    assert off(subject.density(z), pinned(pin)) < tolerance(pin)
    assert off(WIDER[name](1.0 + 1e-6).density(z), pinned(pin)) > 10.0 * tolerance(pin)


@pytest.mark.parametrize("name", MOMENTS)
def test_collapsed_blocks_stay(name: str) -> None:
    """Conditional thrusts, their variances, and the means of telemetry's own unknowns."""
    assert off(ALL[name](), pinned(name), 1e-300) < tolerance(name)


@pytest.mark.parametrize("name", MODES)
def test_evidence_at_a_stored_mode_stays(name: str) -> None:
    """Log density and Laplace's log evidence of none, unknown and causes of every kind."""
    assert off(ALL[name](), pinned(name)) < tolerance(name)


@pytest.mark.parametrize("name", SEARCHES)
def test_searches_end_where_they_did(name: str) -> None:
    """The modes of none, unknown and causes, found anew, have the stored log evidence."""
    assert ALL[name]() == pytest.approx(pinned(name), abs=NATS)


@pytest.mark.parametrize("name", DRAWS)
def test_importance_draws_of_a_seed_stay(name: str) -> None:
    """Log evidence with its error and the efficiency of draws from a stored proposal."""
    assert off(ALL[name](), pinned(name)) < DRAWN_EVIDENCE


@pytest.mark.parametrize("name", CLOSED)
def test_forward_calculations_stay(name: str) -> None:
    """Ideal on-times with their noise, printed estimates, simulated telemetry, Gram matrices."""
    assert off_in_rows(ALL[name](), pinned(name)) < CLOSED_FORM


@pytest.mark.parametrize("name", SOUGHT)
def test_verdicts_stay(name: str) -> None:
    """Evidences and probabilities at the end of searches and of the draws of a seed."""
    assert off(ALL[name](), pinned(name)) < ENDED
