"""Every check of the published tables, and the cells that contradict their own operands."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from cassini_bayes.published.arithmetic_000 import (
    comparison_checks,
    tensor_checks,
    text_checks,
    thrust_checks,
    torque_checks,
)
from cassini_bayes.published.arithmetic_001 import wheel_bias_checks
from cassini_bayes.published.arithmetic_003_004 import (
    observation_checks,
    thrust_comparison_checks,
)
from cassini_bayes.published.checks import Check
from cassini_bayes.published.constants import Constants, published_constants
from cassini_bayes.published.tables import (
    BiasThrust,
    InertiaComparison,
    InertiaTensor,
    ThrustComparison,
    ThrusterPulses,
    TorqueEstimate,
    a_branch_thrusts,
    b_branch_thrusts,
    bias_thrusts,
    day_28_pulses,
    inertia_comparisons,
    inertia_tensors,
    torque_estimates,
)
from cassini_bayes.published.wheel_bias import WheelBiasTable, wheel_bias_tables


@dataclass(frozen=True)
class Published:
    """Everything transcribed that has arithmetic of its own, as the package has it."""

    wheel_bias: Sequence[WheelBiasTable] = field(default_factory=wheel_bias_tables)
    tensors: Sequence[InertiaTensor] = field(default_factory=inertia_tensors)
    comparisons: Sequence[InertiaComparison] = field(default_factory=inertia_comparisons)
    bias_thrusts: Sequence[BiasThrust] = field(default_factory=bias_thrusts)
    day_28: Sequence[ThrusterPulses] = field(default_factory=day_28_pulses)
    torques: Sequence[TorqueEstimate] = field(default_factory=torque_estimates)
    a_branch: Sequence[ThrustComparison] = field(default_factory=a_branch_thrusts)
    b_branch: Sequence[ThrustComparison] = field(default_factory=b_branch_thrusts)
    constants: Constants = field(default_factory=published_constants)


def published() -> Published:
    """Read all published data of the package."""
    return Published()


def all_checks(data: Published) -> tuple[Check, ...]:
    """Re-do the arithmetic of every table; one record per re-computed figure."""
    return (
        *tensor_checks(data.tensors, data.constants),
        *comparison_checks(data.comparisons, data.constants),
        *thrust_checks(data.bias_thrusts, data.day_28, data.constants),
        *torque_checks(data.torques),
        *text_checks(data.bias_thrusts, data.constants),
        *wheel_bias_checks(data.wheel_bias, data.constants),
        *thrust_comparison_checks(data.a_branch, data.b_branch),
        *observation_checks(data.constants),
    )
