"""Frozen description of a spacecraft: what a spacecraft file says, checked and in arrays."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cassini_bayes.errors import InputError
from cassini_bayes.parameters import ParameterSpec

Array = NDArray[np.float64]

AXIS_DEMANDS: Final = ("+x", "-x", "+y", "-y", "+z", "-z")


@dataclass(frozen=True, eq=False)
class Wheel:
    """A reaction wheel: number, name (telemetry prefix), nominal spin axis in body axes (3,)."""

    number: int
    name: str
    axis: Array
    inertia_parameter: str
    tilt_parameters: tuple[str, str] | None


@dataclass(frozen=True, eq=False)
class Thruster:
    """A thruster: position as numbers or (sign, parameter name) per body axis, force direction."""

    name: str
    branches: tuple[str, ...]
    position: tuple[float | tuple[float, str], ...]
    direction: Array

    @property
    def position_parameters(self) -> tuple[str, ...]:
        """Names of the parameters its position depends on."""
        return tuple(entry[1] for entry in self.position if isinstance(entry, tuple))


@dataclass(frozen=True, eq=False)
class BranchGeometry:
    """One branch's thrusters as arrays: position = constant + Σ_j weights[..., j] p_j (J names)."""

    names: tuple[str, ...]
    parameters: tuple[str, ...]
    constant: Array  # (3, K) m
    weights: Array  # (3, K, J)
    directions: Array  # (3, K) unit force directions

    @classmethod
    def of(cls, thrusters: tuple[Thruster, ...]) -> BranchGeometry:
        """Build the arrays from the thrusters of one branch."""
        names = tuple(
            dict.fromkeys(name for thruster in thrusters for name in thruster.position_parameters)
        )
        constant = np.zeros((3, len(thrusters)))
        weights = np.zeros((3, len(thrusters), len(names)))
        for k, thruster in enumerate(thrusters):
            for axis, entry in enumerate(thruster.position):
                if isinstance(entry, tuple):
                    weights[axis, k, names.index(entry[1])] = entry[0]
                else:
                    constant[axis, k] = entry
        directions = np.stack([thruster.direction for thruster in thrusters], axis=-1)
        for array in (constant, weights, directions):
            array.setflags(write=False)
        return cls(tuple(t.name for t in thrusters), names, constant, weights, directions)


@dataclass(frozen=True, eq=False)
class Spacecraft:
    """Wheels, thrusters, branches, controller mapping and own parameters of a spacecraft.

    ``axis_pairs`` maps a torque demand (``"+x"`` … ``"-z"``) to the thrusters fired together for
    it; ``parameters`` are the spacecraft's own (geometry, wheels); ``digest`` is the SHA-256 of the
    file it was read from.
    """

    name: str
    wheels: tuple[Wheel, ...]
    thrusters: tuple[Thruster, ...]
    branches: tuple[str, ...]
    axis_pairs: Mapping[str, tuple[str, ...]]
    parameters: tuple[ParameterSpec, ...]
    geometry: Mapping[str, BranchGeometry]
    digest: str

    def thrusters_of(self, branch: str) -> tuple[Thruster, ...]:
        """Thrusters of a branch in file order.

        Raises
        ------
        InputError
            The spacecraft has no such branch.
        """
        if branch not in self.branches:
            raise InputError(
                f"spacecraft {self.name}: branch",
                f"one of {', '.join(self.branches)}",
                repr(branch),
                "choose a branch of this spacecraft",
            )
        return tuple(thruster for thruster in self.thrusters if branch in thruster.branches)

    def thruster_names(self, branch: str) -> tuple[str, ...]:
        """Names of a branch's thrusters in file order."""
        return tuple(thruster.name for thruster in self.thrusters_of(branch))

    def wheel(self, number: int) -> Wheel:
        """The wheel with a number.

        Raises
        ------
        InputError
            The spacecraft has no such wheel.
        """
        for wheel in self.wheels:
            if wheel.number == number:
                return wheel
        raise InputError(
            f"spacecraft {self.name}: wheel",
            f"one of {[wheel.number for wheel in self.wheels]}",
            str(number),
            "choose a wheel of this spacecraft",
        )
