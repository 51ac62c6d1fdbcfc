"""The response Jacobian of totals rows: powers of thrust, gradient, axes that nothing answers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from totals_cases import flight

from cassini_bayes.balance.totals_terms import response_jacobian, stack_events
from cassini_bayes.spacecraft import lever_arms


@pytest.mark.parametrize(
    ("fired", "power"),
    [((1.0,) * 8, 3.0), ((1.0,) * 4 + (0.0,) * 4, 2.0), ((0.0,) * 4 + (1.0,) * 4, 1.0)],
)
def test_thrust_counts_once_for_every_axis_that_fired(
    fired: tuple[float, ...], power: float
) -> None:
    """F³ with all thrusters, F² without those about Z, F with those alone; the gradient likewise.

    About an axis that nothing answered the on-time is a probability at 0, no density. With F³ for
    rows in which nothing fired, eight of them drew the thrust from 0.760 to 0.832 N.
    """
    (event, *_), priors = flight()
    own = replace(event, on_time_s=np.asarray(event.on_time_s) * np.array(fired))
    stack = stack_events((own,), priors.spacecraft, "B")
    arms = lever_arms(priors.spacecraft, "B", priors.means())[None]
    thrust = np.random.default_rng(5).uniform(0.6, 0.9, (1, 8))

    def jacobian(thrust_n: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        found = response_jacobian(
            arms, np.full((1, 8), 1.1), stack.response, thrust_n, stack.answered
        )
        return found.value, found.gradient

    (value, gradient), (doubled, _) = jacobian(thrust), jacobian(2.0 * thrust)
    np.testing.assert_allclose(doubled - value, power * np.log(2.0), atol=1e-12)
    np.testing.assert_allclose((gradient * thrust).sum(), power, atol=1e-12)
    for k in range(8):
        step = 1e-6 * np.eye(8)[[k]]
        slope = (jacobian(thrust + step)[0] - jacobian(thrust - step)[0]) / 2e-6
        np.testing.assert_allclose(slope, gradient[:, k], atol=1e-7)
