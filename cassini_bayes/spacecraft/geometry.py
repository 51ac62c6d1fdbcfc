"""Geometry of wheels and thrusters at given parameters, vectorised over leading batch axes.

``parameters`` maps names to floats or arrays of any broadcastable leading shape ``(...)``, e.g. a
batch of sampler walkers. Everything is in body axes, metres, radians.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cassini_bayes.errors import InputError
from cassini_bayes.spacecraft.description import AXIS_DEMANDS, Spacecraft

Array = NDArray[np.float64]
Parameters = Mapping[str, ArrayLike]


def _stack(parameters: Parameters, names: tuple[str, ...]) -> Array:
    """Values of several parameters on a last axis: (..., len(names))."""
    values = [np.asarray(parameters[name], dtype=np.float64) for name in names]
    return np.stack(np.broadcast_arrays(*values), axis=-1)


def wheel_axes(spacecraft: Spacecraft, parameters: Parameters) -> Array:
    """Spin axes of all wheels in file order, the columns of T: (..., 3, W).

    A wheel with tilt parameters (u, v) spins about unit(a + u e1 + v e2), with a its nominal axis,
    e1 = unit(ẑ × a), e2 = a × e1.
    """
    columns = []
    for wheel in spacecraft.wheels:
        if wheel.tilt_parameters is None:
            columns.append(wheel.axis)
            continue
        e1 = np.cross([0.0, 0.0, 1.0], wheel.axis)
        e1 = e1 / np.linalg.norm(e1)
        e2 = np.cross(wheel.axis, e1)
        tilt = _stack(parameters, wheel.tilt_parameters)
        axis = wheel.axis + tilt[..., :1] * e1 + tilt[..., 1:] * e2
        columns.append(axis / np.linalg.norm(axis, axis=-1, keepdims=True))
    return np.stack(np.broadcast_arrays(*columns), axis=-1)


def wheel_inertias(spacecraft: Spacecraft, parameters: Parameters) -> Array:
    """Spin inertias of all wheels in file order, (..., W) kg m²."""
    return _stack(parameters, tuple(wheel.inertia_parameter for wheel in spacecraft.wheels))


def centre_of_mass(parameters: Parameters) -> Array:
    """Centre of mass (..., 3) m, in the frame of the thruster positions."""
    return _stack(parameters, ("cm_x_m", "cm_y_m", "cm_z_m"))


def inertia_tensor(parameters: Parameters) -> Array:
    """Inertia matrix (..., 3, 3) kg m² about the centre of mass, with the stationary wheels."""
    order = ("xx", "xy", "xz", "xy", "yy", "yz", "xz", "yz", "zz")
    flat = _stack(parameters, tuple(f"inertia_{element}_kg_m2" for element in order))
    return flat.reshape(*flat.shape[:-1], 3, 3)


def thruster_positions(spacecraft: Spacecraft, branch: str, parameters: Parameters) -> Array:
    """Thruster positions (..., 3, K) m."""
    geometry = spacecraft.geometry[branch]
    if not geometry.parameters:
        return geometry.constant
    values = _stack(parameters, geometry.parameters)
    return np.asarray(geometry.constant + np.tensordot(values, geometry.weights, axes=(-1, -1)))


def thruster_directions(spacecraft: Spacecraft, branch: str) -> Array:
    """Unit force directions (3, K)."""
    return spacecraft.geometry[branch].directions


def lever_arms(spacecraft: Spacecraft, branch: str, parameters: Parameters) -> Array:
    """Torque per newton q_k = (r_k − e) × d_k of every thruster about the centre of mass.

    Returns (..., 3, K) in m. Paper 000 eq. (16) for Cassini.
    """
    centre = centre_of_mass(parameters)[..., None]
    x, y, z = np.moveaxis(thruster_positions(spacecraft, branch, parameters) - centre, -2, 0)
    dx, dy, dz = spacecraft.geometry[branch].directions
    return np.stack([y * dz - z * dy, z * dx - x * dz, x * dy - y * dx], axis=-2)


def pair_indicator(spacecraft: Spacecraft, branch: str) -> Array:
    """(6, K) indicator of the thrusters fired for +x, −x, +y, −y, +z, −z."""
    names = spacecraft.geometry[branch].names
    return np.array(
        [[float(name in spacecraft.axis_pairs[demand]) for name in names] for demand in AXIS_DEMANDS]
    )


def couples(spacecraft: Spacecraft, branch: str) -> tuple[tuple[str, ...], ...]:
    """Groups of thrusters that only ever fire together: in exactly the same axis demands."""
    membership = pair_indicator(spacecraft, branch).T
    groups: dict[bytes, list[str]] = {}
    for name, row in zip(spacecraft.geometry[branch].names, membership, strict=True):
        groups.setdefault(row.tobytes(), []).append(name)
    return tuple(tuple(group) for group in groups.values())


def check_axis_pairs(spacecraft: Spacecraft, branch: str, parameters: Mapping[str, float]) -> None:
    """Check that every axis pair's torque points along its stated axis and sign.

    Raises
    ------
    InputError
        A pair's summed torque about the given centre of mass has the wrong sign.
    """
    torque = pair_indicator(spacecraft, branch) @ lever_arms(spacecraft, branch, parameters).T
    for row, demand in enumerate(AXIS_DEMANDS):
        sign = 1.0 if demand[0] == "+" else -1.0
        value = float(torque[row, row // 2])
        if sign * value <= 0:
            raise InputError(
                f"spacecraft {spacecraft.name}: axis_pairs.{demand}",
                f"thrusters whose torque about {demand[1]} is {'positive' if sign > 0 else 'negative'}",
                f"{value:.3g} N m per newton",
                "swap the pairs of this axis, or check positions and directions",
            )
