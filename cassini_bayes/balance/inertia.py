"""The inertia tensor both ways, and whether a rigid body can have it.

*With the wheels* is the tensor of the telemetry format and of the papers: about the centre of mass,
wheels included as if not spinning relative to the body; the momentum is then
``I ω + Σ_w I_w ρ_w a_w`` with ρ relative to the body (paper 000 eqs. 1-6). *Without the wheels'
spin inertia* it is ``I − Σ_w I_w a_w a_wᵀ`` over the wheels in use: the tensor that goes with wheel
momenta counted at inertial spin rates ρ + aᵀω, as in Basilisk's equations for balanced wheels. The
wheels' mass and transverse inertia, and a wheel that is switched off, stay in both.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from cassini_bayes.balance.physics import Physics
from cassini_bayes.computing.arrays import Array
from cassini_bayes.spacecraft import Spacecraft

ELEMENTS: Final = ("xx", "yy", "zz", "xy", "xz", "yz")
PLACES: Final = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
WITH_WHEELS: Final = "inertia_{}_kg_m2"
WITHOUT_WHEELS: Final = "inertia_without_wheels_{}_kg_m2"


@dataclass(frozen=True)
class Physicality:
    """Shares of draws that no rigid body can have."""

    not_positive: float
    breaks_triangle: float

    @property
    def is_broken(self) -> bool:
        """Whether there is any such draw."""
        return self.not_positive > 0.0 or self.breaks_triangle > 0.0

    @property
    def sentence(self) -> str:
        """The two shares in words."""
        if not self.is_broken:
            return (
                "Every draw of the inertia tensor is one that a rigid body can have: positive "
                "definite, no principal moment larger than the sum of the other two."
            )
        return (
            f"Of the draws of the inertia tensor {self.not_positive:.2%} are not positive definite "
            f"and {self.breaks_triangle:.2%} have a principal moment larger than the sum of the "
            "other two: no rigid body has such a tensor, so tighten the inertia priors."
        )


def elements_of(tensor: Array) -> Array:
    """Six elements xx, yy, zz, xy, xz, yz (..., 6) of tensors (..., 3, 3), kg m²."""
    return np.stack([tensor[..., i, j] for i, j in PLACES], axis=-1)


def tensor_of(elements: Array) -> Array:
    """Inverse of :func:`elements_of`: (..., 6) → (..., 3, 3)."""
    tensor = np.empty((*elements.shape[:-1], 3, 3))
    for place, (i, j) in enumerate(PLACES):
        tensor[..., i, j] = tensor[..., j, i] = elements[..., place]
    return tensor


def without_wheels(physics: Physics, spacecraft: Spacecraft, wheels: tuple[int, ...]) -> Array:
    """I − Σ_w I_w a_w a_wᵀ over the wheels named, body axes, (..., 3, 3) kg m²."""
    places = [i for i, wheel in enumerate(spacecraft.wheels) if wheel.number in wheels]
    axes = physics.wheel_axes[..., places]
    spin = physics.wheel_weights[..., places] @ np.swapaxes(axes, -1, -2)
    return np.asarray(physics.inertia_kg_m2 - spin)


def physicality(tensor: Array) -> Physicality:
    """Shares of tensors (n, 3, 3) that are not positive definite or break the triangle rule.

    For principal moments a ≤ b ≤ c of a rigid body, 0 < a and c ≤ a + b.
    """
    moments = np.linalg.eigvalsh(tensor)
    return Physicality(
        float((moments[:, 0] <= 0).mean()),
        float((moments[:, 2] > moments[:, 0] + moments[:, 1]).mean()),
    )
