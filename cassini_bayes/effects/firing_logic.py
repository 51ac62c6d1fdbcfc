"""Which thrusters fire is not what the on-time predictor assumes.

Of the demand the share s is answered by pairs (paper 001 Table 2), the rest by the two single
thrusters that need least (its ideal calculation), and both sides of an axis fire against each
other, M. With B M what opposing firings turn, which the rest takes out, momentum h stays what it
was:

    on-times = M + (1 − s) single(h − B M) + s pair(h − B M).
"""

from __future__ import annotations

from typing import Final

import numpy as np

from cassini_bayes.effects.controller import Controller, Fired
from cassini_bayes.effects.effect import Kind, Values, unchanged
from cassini_bayes.effects.wording import Clause

LEAST_COMMON_S: Final = 1e-6
"""On-time of the common thruster below which nothing is shared: a division by zero otherwise."""


def fire(controller: Controller, values: Values) -> Fired:
    """Opposing firings, and pairs for a share of what is left."""
    expected = controller.expected_opposing(values)
    opposing = controller.opposing(expected)
    rest = controller.rest(opposing)
    single, pair = controller.singles(rest), controller.pairs(rest)
    share = values["pairing_share"][:, None]
    common = np.maximum(2.0 * controller.common_s(), LEAST_COMMON_S)
    return Fired(
        opposing + (1.0 - share[..., None]) * single + share[..., None] * pair,
        expected,
        (1.0 - share) * common,
        (single - pair) / common[..., None],
    )


KIND: Final = Kind(
    "firing_logic",
    unchanged,
    fire=fire,
    says=Clause(
        "thrusters fire in pairs for {0} of the demand, where the prediction has single ones",
        (("%", 100.0),),
    ),
)
