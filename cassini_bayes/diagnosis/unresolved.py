"""What counters leave open, as unknowns of the rows' linear model.

Counters tell what fired in an interval, not when. The likelihood's columns are averages over when;
each firing departs from them by an amount of its own: single tails may have been cut
(:mod:`cassini_bayes.diagnosis.cut_tails`), and effects whose columns depend on when a pulse was
fired say what they leave open (``left_open`` of their kind). Rows can have a column for every
firing, which a Gram matrix could not.
"""

from __future__ import annotations

import numpy as np

from cassini_bayes.computing.arrays import Array
from cassini_bayes.diagnosis.cut_tails import single_cuts
from cassini_bayes.diagnosis.hypotheses import Hypothesis
from cassini_bayes.effects.effect import FittedRows
from cassini_bayes.effects.firings import firings

Unknowns = tuple[Array, Array, Array]


def unresolved(hypothesis: Hypothesis, z: Array, place: int) -> Unknowns:
    """What counters leave open in the rows of an event (``place``) by a hypothesis at z (d,).

    Returns
    -------
    Columns (n, 3, s) in N m s, variances (s,) of their unknowns, whose means are 0, and what the
    likelihood lacks on average (n, 3).
    """
    columns, variance, mean = single_cuts(hypothesis, z, place)
    model = hypothesis.model
    term = model.telemetry[place]
    layout = term.event.statistics.layout
    timed = [effect for effect in hypothesis.effects if effect.kind.left_open is not None]
    if not timed or not layout.thrusters:
        return columns, variance, mean
    samples = term.event.samples
    points = model.points(z[None])
    physics = term.physics(points)
    arms = np.broadcast_to(physics.arms_m, (1, 3, len(layout.thrusters)))[0]
    rows = FittedRows(term.event.usable_rows.time_s, samples, physics)
    parts = [(columns, variance)]
    for members in layout.couples:
        fired = firings(samples, members, model.thrust_prior.common_mean_n * arms)
        for effect in timed:
            setting = effect.setting(model.spacecraft, model.branch)
            values = effect.values(points.parameters)
            assert effect.kind.left_open is not None  # it is timed
            parts.append(effect.kind.left_open(fired, rows, values, setting))
    together, variances = zip(*parts, strict=True)
    return np.concatenate(together, axis=2), np.concatenate(variances), mean
