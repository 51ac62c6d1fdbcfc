"""The physics of an event at a batch of parameter points: what every likelihood is built from.

One place turns parameter names into inertia, wheel momentum, lever arms and pulse parameters.
Effects that extend the model (:mod:`cassini_bayes.effects`) change a :class:`Physics` and nothing
else, so totals rows and telemetry see the same effect in the same way.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from cassini_bayes.computing.arrays import Array
from cassini_bayes.computing.cached import cached_property
from cassini_bayes.spacecraft import (
    Spacecraft,
    inertia_tensor,
    lever_arms,
    wheel_axes,
    wheel_inertias,
)
from cassini_bayes.spacecraft.parameters import CLOSE_SHARE, LATE_FACTOR, OPEN_FACTOR, PAIR_FACTOR
from cassini_bayes.spacecraft.pulses import PulseShape, effective_on_time

Parameters = Mapping[str, Array | float]

PULSE_PARAMETERS: Final = ("tau_delay_s", "tau_rise_s", "tau_fall_s")
INERTIA_PARAMETERS: Final = tuple(
    f"inertia_{element}_kg_m2" for element in ("xx", "yy", "zz", "xy", "xz", "yz")
)
DELTA_V_NOISE: Final = ("delta_v_noise_m_s", "delta_v_resolution_m_s")
"""Noise and least step of a velocity change, measured or printed."""


@dataclass(frozen=True)
class Physics:
    """Quantities of the momentum balance; leading axes ``...`` are the batch of points.

    A thruster's impulse is F_k Σ g(w + impulse_offset_k) over its pulses of widths w: they go on
    for longer than commanded. ``thrust_factor`` is that of its level, about which F_k scatters as
    its prior says (docs/topics/criticism.md §2). Measured rates are (1 + rate_scale) ω +
    rate_bias. ``extra`` names further columns of telemetry (built by the same name in the
    reduction) with their weights in the momentum that goes in.
    """

    inertia_kg_m2: Array  # (..., 3, 3) with the stationary wheels
    wheel_axes: Array  # (..., 3, W) columns of T, all wheels in file order
    wheel_inertia_kg_m2: Array  # (..., W)
    arms_m: Array  # (..., 3, K) torque per newton; no thrusters: K = 0
    tau_s: tuple[Array, Array, Array]  # delay, rise, fall, each (...)
    close_share: Array | float = 0.0  # (...) of pulses within a second, a control cycle apart
    pair_factor: Array | float = 1.0  # (...) on the variance of what pairs of pulses lose
    late_factor: Array | float = 1.0  # (...) on the variance of what is late in rows, or cut there
    open_factor: Array | float = 1.0  # (...) on the variance of what coarse counters leave open
    thrust_factor: Array | float = 1.0  # (..., K) of the thrusters' levels
    impulse_offset_s: Array | float = 0.0  # (..., K) by which every pulse lasts longer
    steady_torque_n_m: Array | float = 0.0  # (..., 3) beyond the collapsed external torque
    rate_bias_rad_s: Array | float = 0.0  # (..., 3)
    rate_scale: Array | float = 0.0  # (..., 3)
    extra: Mapping[str, Array] = field(default_factory=dict)  # column → (..., 3)

    @cached_property
    def wheel_weights(self) -> Array:
        """T diag(I_w), (..., 3, W): momentum of the wheels per rad/s."""
        return np.asarray(self.wheel_axes * self.wheel_inertia_kg_m2[..., None, :])

    @cached_property
    def momentum_per_rate(self) -> Array:
        """Momentum per measured rate (..., 3, 3): the true one is (measured − bias)/(1 + scale)."""
        inertia = self.inertia_kg_m2
        scale = np.broadcast_to(self.rate_scale, inertia.shape[:-1])
        return np.asarray(inertia / (1.0 + scale)[..., None, :])


Modifier = Callable[[Physics, Parameters], Physics]
"""An effect: the physics with it, at the values of its parameters."""


def physics_of(
    spacecraft: Spacecraft,
    branch: str,
    parameters: Mapping[str, Array],
    modifiers: tuple[Modifier, ...] = (),
    *,
    fires: bool = True,
) -> Physics:
    """Physics at parameters (name → (...) array), with every modifier applied in order.

    ``fires`` is False for events without thrusters, whose parameters need not be there.
    """
    zero = np.zeros(())
    delay, rise, fall = (parameters[name] if fires else zero for name in PULSE_PARAMETERS)
    physics = Physics(
        inertia_kg_m2=inertia_tensor(parameters),
        wheel_axes=wheel_axes(spacecraft, parameters),
        wheel_inertia_kg_m2=wheel_inertias(spacecraft, parameters),
        arms_m=lever_arms(spacecraft, branch, parameters) if fires else np.zeros((3, 0)),
        tau_s=(delay, rise, fall),
        close_share=parameters.get(CLOSE_SHARE, zero) if fires else zero,
        pair_factor=parameters.get(PAIR_FACTOR, np.ones(())),
        late_factor=parameters.get(LATE_FACTOR, np.ones(())),
        open_factor=parameters.get(OPEN_FACTOR, np.ones(())),
        rate_bias_rad_s=_rate_bias(parameters),
    )
    for modify in modifiers:
        physics = modify(physics, parameters)
    return physics


def _rate_bias(parameters: Mapping[str, Array]) -> Array | float:
    names = [f"rate_bias_{axis}_rad_s" for axis in "xyz"]
    if not all(name in parameters for name in names):
        return 0.0
    return np.stack(np.broadcast_arrays(*(parameters[name] for name in names)), axis=-1)


def effective_on_times(
    pulse_shape: PulseShape, physics: Physics, on_time_s: Array, pulses: Array
) -> Array:
    """Impulse over thrust of every thruster and event, (..., E, K) s, effects included.

    n g(u/n + o), with n pulses of the on-time u together, g the pulse shape's effective time and o
    how much longer than commanded an effect makes each; nothing where u/n + o is negative.
    ``on_time_s`` (s) and ``pulses`` (..., E, K).
    """
    tau_s = (np.asarray(tau)[..., None, None] for tau in physics.tau_s)
    if np.ndim(physics.impulse_offset_s):
        longer = np.asarray(physics.impulse_offset_s)[..., None, :] * pulses
        on_time_s = np.maximum(on_time_s + longer, 0.0)
    return effective_on_time(pulse_shape, on_time_s, pulses, *tau_s)


def delta_v_variance(parameters: Parameters) -> Array:
    """Variance (...) of a velocity change, (m/s)²: its noise and its least step."""
    noise, step = (np.asarray(parameters[name]) for name in DELTA_V_NOISE)
    return np.asarray(noise**2 + step**2 / 12.0)
