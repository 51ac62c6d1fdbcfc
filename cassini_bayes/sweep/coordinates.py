"""Draws of every prior block in standard coordinates, before and after the data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import compress
from typing import Final

import numpy as np
import xarray as xr

from cassini_bayes.computing.arrays import Array
from cassini_bayes.model.terms import TORQUE
from cassini_bayes.priors.chaining import LEVELS
from cassini_bayes.priors.reader import Priors
from cassini_bayes.results.record import Fit
from cassini_bayes.spacecraft.parameters import SOFTWARE, THRUST_COMMON
from cassini_bayes.sweep.models import SweepModel, values_of, walked_values

THRUST: Final = "thrust"


@dataclass(frozen=True)
class Coordinates:
    """Coordinates of one prior block: names and draws from prior (m, p) and posterior (n, p).

    Before the data each has mean 0 and standard deviation 1.
    """

    names: tuple[str, ...]
    prior: Array
    posterior: Array


def block_coordinates(model: SweepModel, priors: Priors, fit: Fit) -> dict[str, Coordinates]:
    """Block → coordinates. Walked parameters by their own z, what is integrated out standardised.

    Thrust has the common level and every thruster's departure from it; torques are those of every
    event; the flight software has its two constants.
    """
    sets = (fit.prior, fit.posterior)
    walked = [
        model.space.to_standard(walked_values(data, model.space.names, priors.spacecraft))
        for data in sets
    ]
    result: dict[str, Coordinates] = {}
    for block in dict.fromkeys(model.space.blocks):
        columns = [i for i, item in enumerate(model.space.blocks) if item == block]
        names = tuple(model.space.names[i] for i in columns)
        result[block] = Coordinates(names, walked[0][:, columns], walked[1][:, columns])
    for block, drawn in _collapsed(sets, priors).items():
        mean, sd = drawn[1].mean(0), drawn[1].std(0, ddof=1)
        varies = sd > 0
        if varies.any():
            names = tuple(compress(drawn[0], varies))
            before, after = (((d - mean) / np.where(varies, sd, 1.0))[:, varies] for d in drawn[1:])
            result[block] = Coordinates(names, before, after)
    return result


def _collapsed(
    sets: tuple[xr.Dataset, xr.Dataset], priors: Priors
) -> Mapping[str, tuple[list[str], Array, Array]]:
    """Block → names, prior draws (m, p), posterior draws (n, p) of what is integrated out."""
    result: dict[str, tuple[list[str], Array, Array]] = {}
    posterior = sets[1]
    if LEVELS in posterior and priors.parameters[THRUST_COMMON].distribution is not None:
        levels = [f"{LEVELS}[{name}]" for name in posterior.coords["thruster"].values]
        before, after = (values_of(data, [THRUST_COMMON, *levels]) for data in sets)
        for drawn in (before, after):
            drawn[:, 1:] -= drawn[:, :1]
        result[THRUST] = ([THRUST_COMMON, *(f"{n} − common" for n in levels)], before, after)
    blocks = {"flight software": list(SOFTWARE)} if set(SOFTWARE) <= set(posterior) else {}
    if TORQUE in posterior:
        events = posterior.coords["event"].values
        names = [f"{TORQUE}[{event},{axis}]" for event in events for axis in "xyz"]
        blocks = {"torque": names, **blocks}
    for block, names in blocks.items():
        before, after = (values_of(data, names) for data in sets)
        result[block] = (names, before, after)
    return result
