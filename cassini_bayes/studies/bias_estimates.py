"""Thrust of each thruster from single biases, as paper 003 takes it: least squares, no priors.

A bias without its time history gives three equations. Unknown are the thrusts of those that were
on for more than five seconds, the others keep the expected one; where that is more than three, the
smallest change does.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from cassini_bayes.computing.arrays import Array
from cassini_bayes.events.totals import TotalsEvent
from cassini_bayes.model.mission.model import INTERCEPT, MissionModel
from cassini_bayes.results.mission.trend import LEAST_ON_TIME_S


def bias_estimates(model: MissionModel, events: Sequence[TotalsEvent]) -> Mapping[str, Array]:
    """Pressure-normalised thrust (E, K) of every branch, NaN where an event did not see it, N.

    Nuisances are at their prior means, thrust goes in proportion to the pressure (paper 003).
    """
    centre = {**model.space.centre(), INTERCEPT: 0.0}
    tank = model.circumstances.tank
    relative = tank.pressures_kpa(np.ones(1))[0] / tank.reference_kpa
    result = {
        branch.branch: np.full((len(branch.events), len(branch.thrusters)), np.nan)
        for branch in model.branches
    }
    for part in model.parts:
        of_branch = next(b for b in model.branches if b.branch == part.branch)
        values = part.parameters_at(centre, np.ones(1), 0.0)
        points = part.model.points_at(
            {name: np.atleast_1d(value) for name, value in values.items()}, 1
        )
        system = part.model.totals_rows.at(points).system
        for i, place in enumerate(part.places):
            event = int(of_branch.events[place])
            expected = of_branch.common_n * relative[event]
            seen = np.flatnonzero(events[event].on_time_s > LEAST_ON_TIME_S)
            design = system.design[0, i]
            misfit = system.target[0, i] - expected * design.sum(-1)
            change = np.linalg.lstsq(design[:, seen], misfit, rcond=1e-6)[0]
            result[part.branch][place, seen] = (expected + change) / relative[event]
    return result
