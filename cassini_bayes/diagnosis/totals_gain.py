"""What naming a cause gains on totals rows that were held out.

Leave one row out: its log score given the others is log Z(all) − log Z(others), both by Laplace's
approximation. What it misses by is the balance of its momentum, r = ΔH − D F − T τ, with thrusts F,
inertias and the rest drawn from the posterior of the others; on-times are the row's own.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cassini_bayes.diagnosis.evidence import Weighed
from cassini_bayes.diagnosis.extended import Case, Hypothesis
from cassini_bayes.diagnosis.gain import WITHIN, HeldOut, fitted_to
from cassini_bayes.diagnosis.modes import Mode
from cassini_bayes.effects.catalogue import Catalogue
from cassini_bayes.events.totals import TotalsEvent
from cassini_bayes.model.posterior import collapse
from cassini_bayes.model.thrusts import draw_thrusts

Array = NDArray[np.float64]
DRAWS: Final = 400


def held_out_totals(
    case: Case,
    rows: Sequence[TotalsEvent],
    catalogue: Catalogue,
    weighed: Weighed,
    rng: np.random.Generator,
    say: Callable[[str], None] | None = None,
) -> HeldOut:
    """Every totals row of a case held out in turn.

    Parameters
    ----------
    case, rows
        The case and the rows that its totals were built from; three or more.
    catalogue, weighed
        The hypothesis that is fitted to the others each time.
    rng
        Of the posterior draws that predict a row.
    say
        Told which row is held out.
    """
    whole, mode = fitted_to(case, catalogue, weighed)
    scores, residuals, inside = [], [], []
    for place, left_out in enumerate(rows):
        if say is not None:
            say(f"{weighed.name}: {left_out.id} held out")
        others = tuple(row for i, row in enumerate(rows) if i != place)
        smaller = replace(case, totals=others)
        hypothesis, own = fitted_to(smaller, catalogue, weighed)
        scores.append(mode.log_evidence - own.log_evidence)
        residual, sd = predicted_balance(whole, place, hypothesis, own, rng)
        residuals.append(residual)
        inside.append(np.abs(residual) < WITHIN * sd)
    return HeldOut(
        np.array(scores),
        float(np.sqrt((np.array(residuals) ** 2).mean())),
        float(np.mean(inside)),
    )


def predicted_balance(
    whole: Hypothesis, place: int, others: Hypothesis, mode: Mode, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Mean and standard deviation (3,) about body axes of a row's balance, N m s.

    The mean is over posterior draws of the model fitted to the others; the deviation has theirs,
    the row's own thrust departures, torque and noise.
    """
    z = mode.point + rng.standard_normal((DRAWS, len(mode.point))) @ mode.factor.T
    linear = others.model.thrust_prior
    level = draw_thrusts(linear, collapse(others.model, z).thrusts, rng).level_n
    system = whole.model.totals_rows.at(whole.model.points(z)).system
    design = system.design[:, place, :3]
    residual = system.target[:, place, :3] - (design @ level[..., None])[..., 0]
    noise = system.covariance[:, place, :3, :3] + system.torque_covariance[place, :3, :3]
    own = design @ linear.own
    spread = np.einsum("nii->ni", noise) + (own**2).sum(-1)
    return residual.mean(0), np.sqrt(residual.var(0) + spread.mean(0))
