"""What a set of events can see, before anything is sampled.

At the prior means the model is linearised: a parameter's effect on the balance of every row is a
combination of the same columns that the likelihood has, so the expected information of all
parameters, thrusts, torques and momenta together comes from the Gram matrices alone. With the
priors (standard normal coordinates) it gives the expected posterior width over the prior's; the
data's own part gives the singular values, the signal over noise of every direction per prior width.
Noise levels act on the scatter of the rows, not on their mean, and have no place here.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import pandas as pd

from cassini_bayes.arrays import Array, Places
from cassini_bayes.model.posterior import Model
from cassini_bayes.model.unknowns import Unknowns

STEP: Final = 0.05  # in prior standard deviations
SEEN_WELL: Final = 0.3
SEEN: Final = 0.7
HARDLY: Final = 0.95
TOGETHER: Final = 0.9
NOISE_BLOCK: Final = "noise"


@dataclass(frozen=True)
class Observability:
    """Expected widths per quantity, singular values of all directions, and the same in words.

    ``table``: quantity, unit, prior_sd, expected_sd, ratio (expected posterior over prior width),
    verdict. ``together`` are pairs of quantities that the data tie to one combination.
    """

    table: pd.DataFrame
    singular_values: Array
    together: tuple[tuple[str, str, float], ...]
    sentences: tuple[str, ...]


def observability(model: Model) -> Observability:
    """Expected posterior over prior widths in a model, from Gram matrices and totals rows alone."""
    unknowns = model.unknowns
    information = _information(model, unknowns)
    covariance = np.asarray(np.linalg.inv(information + np.eye(unknowns.size)), dtype=np.float64)
    walked = _walked_rows(model, covariance)
    thrusts = _thrust_rows(model, unknowns, covariance)
    table = pd.DataFrame([*thrusts, *walked])
    table["verdict"] = [_verdict(float(ratio)) for ratio in table["ratio"]]
    asked = _asked(model, unknowns)
    singular = np.sqrt(np.maximum(np.linalg.eigvalsh(_marginal(information, asked)), 0.0))[::-1]
    together = _together(model, covariance)
    return Observability(table, singular, together, _sentences(table, singular, together))


def _information(model: Model, unknowns: Unknowns) -> Array:
    """Expected information (size, size) of the data on all standardised unknowns."""
    information = np.zeros((unknowns.size, unknowns.size))
    d = model.space.dimension
    steps = np.concatenate([np.zeros((1, d)), STEP * np.eye(d), -STEP * np.eye(d)])
    points = model.points(steps)
    for term, events in zip(model.terms, model.events_of_term, strict=True):
        for event, part in term.at(points).expected_information(unknowns, events.start, STEP):
            places = unknowns.of_event(event)
            information[np.ix_(places, places)] += part
    return information


def _asked(model: Model, unknowns: Unknowns) -> Places:
    """Places of what is asked for: walked parameters but the noise levels, shared thrust levels."""
    walked = [i for i, block in enumerate(model.space.blocks) if block != NOISE_BLOCK]
    return np.array([*walked, *range(unknowns.levels.start, unknowns.levels.stop)])


def _marginal(information: Array, asked: Places) -> Array:
    """The data's information on some unknowns, the others integrated out under their priors."""
    others = np.setdiff1d(np.arange(len(information)), asked)
    kept = information[np.ix_(asked, asked)]
    if len(others) == 0:
        return kept
    across = information[np.ix_(asked, others)]
    inner = information[np.ix_(others, others)] + np.eye(len(others))
    return np.asarray(kept - across @ np.linalg.solve(inner, across.T))


def _walked_rows(model: Model, covariance: Array) -> list[dict[str, object]]:
    rows: list[dict[str, object]] = []
    for i, name in enumerate(model.space.names):
        if model.space.blocks[i] == NOISE_BLOCK:
            continue
        prior = model.space.distributions[i].sd()
        ratio = float(np.sqrt(covariance[i, i]))
        rows.append(_row(name, model.space.blocks[i], model.specs[name].unit, prior, ratio))
    return rows


def _thrust_rows(model: Model, unknowns: Unknowns, covariance: Array) -> list[dict[str, object]]:
    """Thrust of every thruster in every event that fires, and of its level over all events."""
    rows: list[dict[str, object]] = []
    prior, levels = model.thrust_prior, unknowns.levels
    nothing = slice(levels.stop, levels.stop)
    cases = [("all events", nothing, prior.own[:, :0])] if model.fires else []
    cases += [
        (event.id, places.departures, prior.own)
        for event, places in zip(model.events, unknowns.events, strict=True)
        if event.fires
    ]
    for event, departures, factor in cases:
        index = np.r_[levels, departures]
        design = np.concatenate([prior.shared, factor], axis=1)
        after = np.einsum("kq,qr,kr->k", design, covariance[np.ix_(index, index)], design)
        before = (design**2).sum(1)
        for k, thruster in enumerate(model.thrusters):
            if before[k] > 0:
                ratio = float(np.sqrt(after[k] / before[k]))
                label = f"thrust[{event},{thruster}]"
                rows.append(_row(label, "thrust", "N", float(np.sqrt(before[k])), ratio))
    return rows


def _row(name: str, block: str, unit: str, prior: float, ratio: float) -> dict[str, object]:
    return {
        "quantity": name,
        "block": block,
        "unit": unit,
        "prior_sd": prior,
        "expected_sd": prior * ratio,
        "ratio": ratio,
    }


def _verdict(ratio: float) -> str:
    for limit, word in ((SEEN_WELL, "seen well"), (SEEN, "seen"), (HARDLY, "hardly seen")):
        if ratio < limit:
            return word
    return "not seen"


def _together(model: Model, covariance: Array) -> tuple[tuple[str, str, float], ...]:
    """Pairs of walked parameters whose expected posterior correlation is strong."""
    names = model.space.names
    width = np.sqrt(np.diagonal(covariance))
    found = []
    for i, first in enumerate(names):
        for j in range(i):
            correlation = float(covariance[i, j] / (width[i] * width[j]))
            if abs(correlation) > TOGETHER:
                found.append((names[j], first, correlation))
    return tuple(sorted(found, key=lambda pair: -abs(pair[2])))


def _sentences(
    table: pd.DataFrame, singular: Array, together: tuple[tuple[str, str, float], ...]
) -> tuple[str, ...]:
    """The result in words: directions, then thrusts, inertia and nuisances by verdict."""
    told = int((singular > 1.0).sum())
    said = [
        f"Expected before sampling: of {len(singular)} directions among thrust levels, inertia and "
        f"nuisances these events tell {told} better than the priors do (singular values "
        f"{singular[0]:.3g} to {singular[-1]:.2g}; 1 is as good as the prior)."
    ]
    levels = table[table["quantity"].str.startswith("thrust[all events")]
    groups = [("thrust levels", levels), ("inertia", table[table["block"] == "inertia"])]
    groups.append(("nuisances", table[~table["block"].isin(["thrust", "inertia"])]))
    for name, rows in groups:
        if rows.empty:
            continue
        parts = []
        for verdict in ("seen well", "seen", "hardly seen", "not seen"):
            members = rows[rows["verdict"] == verdict]["quantity"]
            if len(members):
                labels = [str(m).removeprefix("thrust[all events,").rstrip("]") for m in members]
                parts.append(f"{verdict}: {', '.join(labels)}")
        said.append(f"{name[0].upper()}{name[1:]} – {'; '.join(parts)}.")
    said += [
        f"{', '.join(group)} are tied together (pairwise |r| > {TOGETHER}): the data tell their "
        "combination far better than each alone."
        for group in _groups(together)
    ]
    return tuple(said)


def _groups(together: tuple[tuple[str, str, float], ...]) -> list[list[str]]:
    """Quantities that are connected by strong correlations, each group once."""
    groups: list[list[str]] = []
    for first, second, _ in together:
        own = [group for group in groups if first in group or second in group]
        merged = list(dict.fromkeys([*(name for group in own for name in group), first, second]))
        groups = [group for group in groups if group not in own] + [merged]
    return groups
