"""Frozen description of a spacecraft: the content of a spacecraft file, checked and in arrays."""

from __future__ import annotations

from collections.abc import Collection, Container, Iterable, Mapping
from dataclasses import dataclass, fields, replace
from types import MappingProxyType
from typing import Final

import numpy as np

from cassini_bayes.computing.arrays import Array
from cassini_bayes.computing.cached import cached_property
from cassini_bayes.errors import InputError
from cassini_bayes.files.checks import check_known
from cassini_bayes.spacecraft.parameters import ParameterSpec

CONTROL_CYCLE_S: Final = 0.125
"""Where a spacecraft file does not say: paper 001 section III."""
HIGHEST_RATE_RAD_S: Final = 0.05
"""Where a file does not say: ten times the fastest slew of Cassini on thrusters; a slew in deg/s
exceeds it."""
HIGHEST_WHEEL_RPM: Final = 4000.0
PLANNED_WHEEL_RPM: Final = (300.0, 2000.0)
"""Where a file does not say: twice what Cassini's wheels are kept below."""
AXIS_DEMANDS: Final = ("+x", "-x", "+y", "-y", "+z", "-z")

WHEEL_KEYS: Final = (
    "rwa{target}_inertia_kg_m2",
    "rwa{target}_tilt_u_rad",
    "rwa{target}_tilt_v_rad",
    "rwa{target}_articulation_rad",
)
"""What effects call the parameters of wheel ``{target}``, whatever the spacecraft file does."""

CENTRE_OF_MASS: Final = ("cm_x_m", "cm_y_m", "cm_z_m")

# Cross product as a tensor: (a × b)_i = Σ_jk LEVI_CIVITA[i, j, k] a_j b_k.
LEVI_CIVITA: Final = np.array(
    [
        [[0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]],
        [[0.0, 0.0, -1.0], [0.0, 0.0, 0.0], [1.0, 0.0, 0.0]],
        [[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 0.0]],
    ]
)
LEVI_CIVITA.setflags(write=False)


@dataclass(frozen=True, eq=False)
class Platform:
    """A platform that turns a wheel about a body axis ``about`` (3,), a unit vector.

    The wheel's axis in the file is that at ``file_angle_rad``; ``parameter`` names the angle.
    """

    parameter: str
    about: Array
    file_angle_rad: float


@dataclass(frozen=True, eq=False)
class Wheel:
    """A reaction wheel.

    ``name`` is the prefix of its telemetry columns, ``axis`` its nominal spin axis (3,), a unit
    vector in body axes. ``tilt_parameters`` are the names of (u, v), or None for a wheel whose axis
    is taken as known. ``platform`` is what can turn the wheel, None where it is bolted down. Its
    angle is a parameter only where ``is_turned`` (:meth:`Spacecraft.with_platforms`); else it stays
    where the file has it.
    """

    number: int
    name: str
    axis: Array
    inertia_parameter: str
    tilt_parameters: tuple[str, str] | None
    platform: Platform | None = None
    is_turned: bool = False

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of its parameters: spin inertia, tilts of its axis, angle of its platform."""
        turned = self.platform if self.is_turned else None
        angle = () if turned is None else (turned.parameter,)
        return (self.inertia_parameter, *(self.tilt_parameters or ()), *angle)

    @property
    def by_key(self) -> dict[str, str]:
        """Names of its parameters by what effects call them (``WHEEL_KEYS``)."""
        tilts = self.tilt_parameters or (None, None)
        angle = self.platform.parameter if self.platform is not None and self.is_turned else None
        names = (self.inertia_parameter, *tilts, angle)
        keys = (key.format(target=self.number) for key in WHEEL_KEYS)
        return {key: name for key, name in zip(keys, names, strict=True) if name is not None}

    @cached_property
    def tilt_axes(self) -> Array:
        """The directions of u and v as rows (2, 3): e1 = unit(ẑ × a), e2 = a × e1.

        e1 turns the axis about +Z (u > 0: growing azimuth), e2 raises it towards +Z (v > 0). Not
        defined for an axis along Z, which the reader refuses to tilt.
        """
        x, y, _ = self.axis
        e1 = np.array([-y, x, 0.0]) / np.hypot(x, y)
        axes = np.stack([e1, np.cross(self.axis, e1)])
        axes.setflags(write=False)
        return axes


@dataclass(frozen=True, eq=False)
class Thruster:
    """A thruster: position and direction of the force on the spacecraft, in body axes.

    Each coordinate of ``position`` is a number in m, or a sign and the name of a parameter in m.
    ``direction`` (3,) is a unit vector.
    """

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
    """One branch's thrusters as linear maps, made once so that a batch costs a matrix product.

    With p the J values of ``parameters`` and e the centre of mass, positions are
    ``position_constant + Σ_j p_j position_weights[j]`` and lever arms
    ``arm_constant + Σ_j (p, e)_j arm_weights[j]``: (r − e) × d is linear in r and in e.
    """

    names: tuple[str, ...]
    parameters: tuple[str, ...]
    directions: Array  # (3, K) unit force directions
    position_constant: Array  # (3, K) m
    position_weights: Array  # (J, 3, K)
    arm_constant: Array  # (3, K) m
    arm_weights: Array  # (J + 3, 3, K), the last three for the centre of mass

    @classmethod
    def of(cls, thrusters: tuple[Thruster, ...]) -> BranchGeometry:
        """Build the arrays from the thrusters of one branch."""
        names = tuple(dict.fromkeys(n for each in thrusters for n in each.position_parameters))
        constant = np.zeros((3, len(thrusters)))
        weights = np.zeros((len(names), 3, len(thrusters)))
        for k, thruster in enumerate(thrusters):
            for axis, entry in enumerate(thruster.position):
                if isinstance(entry, tuple):
                    weights[names.index(entry[1]), axis, k] = entry[0]
                else:
                    constant[axis, k] = entry
        directions = np.stack([thruster.direction for thruster in thrusters], axis=-1)
        centre = -np.eye(3)[:, :, None] * np.ones(len(thrusters))
        cross = "ijl,...jk,lk->...ik"
        arrays = (
            directions,
            constant,
            weights,
            np.einsum(cross, LEVI_CIVITA, constant, directions),
            np.einsum(cross, LEVI_CIVITA, np.concatenate([weights, centre]), directions),
        )
        for array in arrays:
            array.setflags(write=False)
        return cls(tuple(thruster.name for thruster in thrusters), names, *arrays)


@dataclass(frozen=True, eq=False)
class Spacecraft:
    """Wheels, thrusters, branches, controller mapping and own parameters of a spacecraft.

    ``axis_pairs`` maps a torque demand (``"+x"`` … ``"-z"``) to the thrusters fired together for
    it; ``parameters`` are the spacecraft's own (geometry, wheels); ``geometry`` maps a branch to
    its arrays; ``digest`` is the SHA-256 of the file it was read from. Pulses start with control
    cycles of ``control_cycle_s``. Body rates beyond ``highest_rate_rad_s`` about an axis and wheel
    rates beyond ``highest_wheel_rpm`` are mistakes. Wheels are planned to end at sizes within
    ``planned_wheel_rpm``: slower ones wear their bearings, faster ones are beyond their limit.
    """

    name: str
    wheels: tuple[Wheel, ...]
    thrusters: tuple[Thruster, ...]
    branches: tuple[str, ...]
    axis_pairs: Mapping[str, tuple[str, ...]]
    parameters: tuple[ParameterSpec, ...]
    geometry: Mapping[str, BranchGeometry]
    digest: str
    control_cycle_s: float = CONTROL_CYCLE_S
    highest_rate_rad_s: float = HIGHEST_RATE_RAD_S
    highest_wheel_rpm: float = HIGHEST_WHEEL_RPM
    planned_wheel_rpm: tuple[float, float] = PLANNED_WHEEL_RPM

    def __post_init__(self) -> None:
        for name in ("axis_pairs", "geometry"):
            object.__setattr__(self, name, MappingProxyType(dict(getattr(self, name))))

    def __reduce__(self) -> tuple[object, ...]:
        # a mapping proxy cannot go to another process, the dictionary behind it can
        values = (getattr(self, field.name) for field in fields(self))
        plain = tuple(dict(v) if isinstance(v, MappingProxyType) else v for v in values)
        return Spacecraft, plain

    def with_platforms(self, given: Container[str]) -> Spacecraft:
        """The spacecraft with the platforms turned whose angle is among the parameters ``given``.

        The others stay where the file has them, and their angle is no parameter.
        """
        wheels = tuple(
            replace(wheel, is_turned=wheel.platform.parameter in given)
            if wheel.platform is not None
            else wheel
            for wheel in self.wheels
        )
        return replace(self, wheels=wheels)

    def with_own_parameters(self, number: int, keys: Container[str]) -> Spacecraft:
        """The spacecraft with those of a wheel's parameters that are in ``keys`` named so.

        ``keys`` are what effects call them (``WHEEL_KEYS``): no other wheel shares them then.
        """
        inertia, *tilts, angle = (key.format(target=number) for key in WHEEL_KEYS)

        def own(wheel: Wheel) -> Wheel:
            platform = wheel.platform
            if platform is not None and angle in keys:
                platform = replace(platform, parameter=angle)
            return replace(
                wheel,
                inertia_parameter=inertia if inertia in keys else wheel.inertia_parameter,
                tilt_parameters=(tilts[0], tilts[1]) if tilts[0] in keys else wheel.tilt_parameters,
                platform=platform,
            )

        wheels = tuple(own(wheel) if wheel.number == number else wheel for wheel in self.wheels)
        return replace(self, wheels=wheels)

    def check_platforms(self, wheels: Collection[int], where: str) -> None:
        """Check that every platform that is turned carries one of the prime ``wheels``.

        Raises
        ------
        InputError
            The angle of a platform is given, and its wheel is not in use.
        """
        for wheel in self.wheels:
            if wheel.platform is not None and wheel.is_turned and wheel.number not in wheels:
                raise InputError(
                    f"{where}.{wheel.platform.parameter}",
                    f"wheel {wheel.number}, which this platform turns, among the wheels",
                    f"wheels {list(wheels)}",
                    f"add {wheel.number} to spacecraft.wheels, or leave the angle out",
                )

    @property
    def wheel_numbers(self) -> list[int]:
        """Numbers of all wheels, in file order."""
        return [wheel.number for wheel in self.wheels]

    def check_branch(self, where: str, branch: str) -> None:
        """Check that the spacecraft has a thruster branch.

        Raises
        ------
        InputError
            It has not; ``where`` is the place that names it.
        """
        check_known(where, branch, self.branches, f"a thruster branch of {self.name}")

    def geometry_of(self, branch: str) -> BranchGeometry:
        """Arrays of a branch's thrusters.

        Raises
        ------
        InputError
            The spacecraft has no such branch.
        """
        try:
            return self.geometry[branch]
        except KeyError as error:
            raise InputError(
                f"spacecraft {self.name}: branch",
                f"one of {', '.join(self.branches)}",
                repr(branch),
                "choose a branch of this spacecraft",
            ) from error

    def thrusters_of(self, branch: str) -> tuple[Thruster, ...]:
        """Thrusters of a branch in file order.

        Raises
        ------
        InputError
            The spacecraft has no such branch.
        """
        members = set(self.geometry_of(branch).names)
        return tuple(thruster for thruster in self.thrusters if thruster.name in members)

    def thruster_names(self, branch: str) -> tuple[str, ...]:
        """Names of a branch's thrusters in file order.

        Raises
        ------
        InputError
            The spacecraft has no such branch.
        """
        return self.geometry_of(branch).names

    def wheel_parameters(self, numbers: Iterable[int] | None = None) -> tuple[str, ...]:
        """Names of the parameters of some wheels, or of all, in file order."""
        chosen = set(self.wheel_numbers if numbers is None else numbers)
        return tuple(
            name for wheel in self.wheels if wheel.number in chosen for name in wheel.parameters
        )

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
            f"one of {', '.join(map(str, self.wheel_numbers))}",
            str(number),
            "choose a wheel of this spacecraft",
        )
