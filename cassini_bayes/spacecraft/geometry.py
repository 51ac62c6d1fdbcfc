"""Geometry of wheels and thrusters at given parameters, vectorised over leading batch axes.

``parameters`` maps names to floats or arrays of any broadcastable leading shape ``(...)``, e.g. a
batch of sampler walkers; a name that is needed and missing is a KeyError. Everything is in body
axes, metres, radians; positions and centre of mass are in one frame.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from cassini_bayes.computing.arrays import Array
from cassini_bayes.errors import InputError
from cassini_bayes.spacecraft.description import AXIS_DEMANDS, CENTRE_OF_MASS, Spacecraft

Parameters = Mapping[str, ArrayLike]


def _stack(parameters: Parameters, names: tuple[str, ...]) -> Array:
    """Values of several parameters on a last axis: (..., len(names))."""
    values = [np.asarray(parameters[name], dtype=np.float64) for name in names]
    # several times faster than numpy's stack of broadcast_arrays, in a path called per likelihood
    stacked = np.empty((*np.broadcast_shapes(*(value.shape for value in values)), len(names)))
    for column, value in enumerate(values):
        stacked[..., column] = value
    return stacked


def _weighted(values: Array, weights: Array) -> Array:
    """Σ_j values[..., j] weights[j] for values (..., J) and weights (J, 3, K): (..., 3, K)."""
    count, rows, columns = weights.shape  # count is 0 for positions without parameters
    flat = values @ weights.reshape(count, rows * columns)
    return np.asarray(flat.reshape(*values.shape[:-1], rows, columns))


def wheel_axes(spacecraft: Spacecraft, parameters: Parameters) -> Array:
    """Spin axes of all wheels in file order, the columns of T (paper 000 eq. 2).

    A wheel with tilt parameters (u, v) spins about unit(a + u e1 + v e2), with a its nominal axis,
    e1 = unit(ẑ × a), e2 = a × e1.

    Returns
    -------
    (..., 3, W) unit columns; no leading axes when no wheel can tilt.
    """
    tilted = [(column, w) for column, w in enumerate(spacecraft.wheels) if w.tilt_parameters]
    tilts = _stack(parameters, tuple(n for _, w in tilted for n in w.tilt_parameters or ()))
    axes = np.empty((*tilts.shape[:-1], 3, len(spacecraft.wheels)))
    for column, wheel in enumerate(spacecraft.wheels):
        axes[..., column] = wheel.axis
    for i, (column, wheel) in enumerate(tilted):
        axis = wheel.axis + tilts[..., 2 * i : 2 * i + 2] @ wheel.tilt_axes
        axes[..., column] = axis / np.sqrt((axis * axis).sum(-1, keepdims=True))
    return axes


def wheel_inertias(spacecraft: Spacecraft, parameters: Parameters) -> Array:
    """Spin inertias of all wheels in file order, (..., W) kg m²."""
    return _stack(parameters, tuple(wheel.inertia_parameter for wheel in spacecraft.wheels))


def centre_of_mass(parameters: Parameters) -> Array:
    """Centre of mass (..., 3) m, in the frame of the thruster positions."""
    return _stack(parameters, CENTRE_OF_MASS)


def inertia_tensor(parameters: Parameters) -> Array:
    """Inertia matrix (..., 3, 3) kg m² about the centre of mass, with the stationary wheels.

    Off-diagonal parameters are elements of the matrix, I_xy = −∫ x y dm.
    """
    order = ("xx", "xy", "xz", "xy", "yy", "yz", "xz", "yz", "zz")
    flat = _stack(parameters, tuple(f"inertia_{element}_kg_m2" for element in order))
    return flat.reshape(*flat.shape[:-1], 3, 3)


def thruster_positions(spacecraft: Spacecraft, branch: str, parameters: Parameters) -> Array:
    """Thruster positions of a branch, (..., 3, K) m.

    Raises
    ------
    InputError
        The spacecraft has no such branch.
    """
    geometry = spacecraft.geometry_of(branch)
    values = _stack(parameters, geometry.parameters)
    return geometry.position_constant + _weighted(values, geometry.position_weights)


def thruster_directions(spacecraft: Spacecraft, branch: str) -> Array:
    """Unit directions (3, K) of the force on the spacecraft, read-only.

    Raises
    ------
    InputError
        The spacecraft has no such branch.
    """
    return spacecraft.geometry_of(branch).directions


def lever_arms(spacecraft: Spacecraft, branch: str, parameters: Parameters) -> Array:
    """Torque per newton of every thruster about the centre of mass e: q_k = (r_k − e) × d_k.

    The matrix Q of paper 000 eq. (16), for any spacecraft.

    Returns
    -------
    (..., 3, K) in m (N m per N), thrusters in file order.

    Raises
    ------
    InputError
        The spacecraft has no such branch.
    """
    geometry = spacecraft.geometry_of(branch)
    values = _stack(parameters, (*geometry.parameters, *CENTRE_OF_MASS))
    return geometry.arm_constant + _weighted(values, geometry.arm_weights)


def pair_indicator(spacecraft: Spacecraft, branch: str) -> Array:
    """(6, K) indicator of the thrusters fired for +x, −x, +y, −y, +z, −z.

    Raises
    ------
    InputError
        The spacecraft has no such branch.
    """
    names = spacecraft.geometry_of(branch).names
    pairs = [spacecraft.axis_pairs[demand] for demand in AXIS_DEMANDS]
    return np.array([[float(name in pair) for name in names] for pair in pairs])


def couples(spacecraft: Spacecraft, branch: str) -> tuple[tuple[str, ...], ...]:
    """Groups of thrusters that only ever fire together, in file order.

    Thrusters that answer exactly the same demands; one that answers none (it serves velocity
    changes only) stands alone, for nothing ties it to another.

    Raises
    ------
    InputError
        The spacecraft has no such branch.
    """
    groups: dict[tuple[object, ...], list[str]] = {}
    names = spacecraft.geometry_of(branch).names
    for name, row in zip(names, pair_indicator(spacecraft, branch).T, strict=True):
        groups.setdefault(tuple(row) if row.any() else (name,), []).append(name)
    return tuple(tuple(group) for group in groups.values())


def check_axis_pairs(spacecraft: Spacecraft, branch: str, parameters: Mapping[str, float]) -> None:
    """Check that every axis pair turns the spacecraft about its stated axis in its stated sense.

    A spacecraft file has no values, so this needs a nominal geometry and centre of mass. Summed
    over its thrusters with equal thrust, the torque of a pair must have a positive component along
    its demand; components about other axes are allowed.

    Raises
    ------
    InputError
        A pair's torque about its axis is zero or has the wrong sign, or there is no such branch.
    """
    arms = lever_arms(spacecraft, branch, parameters)
    for row, demand in enumerate(AXIS_DEMANDS):
        pair = pair_indicator(spacecraft, branch)[row]
        value = float(arms[row // 2] @ pair)
        along = value if demand[0] == "+" else -value
        if not along > 0:
            wanted = "positive" if demand[0] == "+" else "negative"
            raise InputError(
                f"spacecraft {spacecraft.name}: axis_pairs.{demand} (branch {branch})",
                f"thrusters whose torque about {demand[1]} is {wanted}",
                f"{value:.3g} N m per newton",
                "swap the pairs of this axis, or check positions and directions",
            )
