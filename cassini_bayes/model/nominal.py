"""Prior means as the values that data are checked against, and the check of totals rows by them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

from cassini_bayes.balance.physics import INERTIA_PARAMETERS
from cassini_bayes.events.plausibility import STRICT, Policy, check_totals
from cassini_bayes.events.totals import TotalsEvent
from cassini_bayes.priors.reader import Priors
from cassini_bayes.spacecraft import check_axis_pairs
from cassini_bayes.spacecraft.description import CENTRE_OF_MASS
from cassini_bayes.spacecraft.parameters import THRUST_COMMON, TORQUES

FIRING_PARAMETERS: Final = (THRUST_COMMON, "tau_rise_s", "tau_fall_s")


def check_rows(
    rows: Sequence[TotalsEvent],
    priors: Priors,
    where: str,
    policy: Policy = STRICT,
    *,
    steady: bool = True,
) -> tuple[str, ...]:
    """Check totals rows of the priors' branch against the balance of momentum.

    Rows of another branch are the model's to refuse. See :func:`check_totals`.
    """
    of_branch = [row for row in rows if row.branch == priors.branch]
    nominal = nominal_values(priors)
    torques = [priors.parameters.get(name) for name in TORQUES]
    torque_n_m = [0.0 if each is None else math.hypot(each.mean, each.sd) for each in torques]
    return check_totals(
        of_branch, priors.spacecraft, nominal, where, policy, steady=steady, torque_n_m=torque_n_m
    )


def nominal_values(priors: Priors) -> dict[str, float]:
    """Prior means of all parameters; wheels that the priors know nothing of weigh nothing.

    Raises
    ------
    InputError
        Inertia, wheels, or what fires is missing: momentum cannot be computed. Thrusters that are
        fired for a torque turn the spacecraft the other way.
    """
    spacecraft = priors.spacecraft
    geometry = spacecraft.geometry[priors.branch]
    needed = (*INERTIA_PARAMETERS, *CENTRE_OF_MASS, *geometry.parameters, *FIRING_PARAMETERS)
    priors.require(needed, "telemetry")
    means = priors.means()
    check_axis_pairs(spacecraft, priors.branch, means)
    return {**dict.fromkeys(spacecraft.wheel_parameters(), 0.0), **means}
