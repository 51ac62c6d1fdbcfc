"""What a parameter name means: unit, block and meaning. No values; those are in priors files."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

BLOCKS: Final = (
    "thrust",
    "tail-off",
    "centre of mass",
    "geometry",
    "wheel inertia",
    "wheel alignment",
    "inertia",
    "torque",
    "mass",
    "noise",
    "flight software",
)
EFFECT_BLOCK: Final = "effect"
"""Of parameters that no spacecraft has by itself: sizes of effects beyond the standard physics."""


THRUST_COMMON: Final = "thrust_common_n"
THRUST_LEVELS: Final = ("thrust_individual_n", "thrust_event_n", "thrust_jitter_n")
TORQUES: Final = tuple(f"external_torque_{axis}_n_m" for axis in "xyz")
SOFTWARE: Final = ("fsw_acceleration_factor", "fsw_impulse_offset_s")
"""Of the ΔV that is computed on board."""
CLOSE_SHARE: Final = "close_pulse_share"
PAIR_FACTOR: Final = "close_pulse_factor"
LATE_FACTOR: Final = "late_pulse_factor"
OPEN_FACTOR: Final = "open_counter_factor"
NOISE_LEVELS: Final = (
    "rate_noise_rad_s",
    "wheel_noise_rpm",
    "attitude_noise_rad",
    "torque_noise_n_m_s05",
)
"""Of telemetry: its channels, and the torque that no term explains."""


@dataclass(frozen=True)
class ParameterSpec:
    """Name, unit (``"1"`` when dimensionless), block and meaning.

    The block is one of :data:`BLOCKS`, or :data:`EFFECT_BLOCK`.
    """

    name: str
    unit: str
    block: str
    meaning: str


def _specs(block: str, unit: str, **meanings: str) -> tuple[ParameterSpec, ...]:
    return tuple(ParameterSpec(name, unit, block, text) for name, text in meanings.items())


def _by_axis(name: str, meaning: str) -> dict[str, str]:
    """Names and meanings of a parameter of each body axis."""
    return {name.format(axis): meaning.format(axis.upper()) for axis in "xyz"}


_GENERIC: Final = (
    *_specs(
        "thrust",
        "N",
        thrust_common_n="thrust level common to all thrusters and events",
        thrust_individual_n="a thruster's own departure from the common level, same in every event",
        thrust_event_n="an event's departure, the same for all thrusters (tank pressure)",
        thrust_jitter_n="departure of one thruster in one event",
    ),
    *_specs(
        "thrust",
        "N/year",
        thrust_drift_n_per_year="steady change common to a branch's thrusters at given pressure",
        thrust_ageing_n_per_year="steady change of one thruster's thrust beyond the common one",
    ),
    *_specs(
        "thrust",
        "1",
        thrust_intercept_share="share of the thrust at the reference pressure that pressure leaves",
        thrust_loss_share="thrust that a failing thruster loses at its onset, as a share",
        failing_probability="probability that one thruster of a branch fails during the mission",
    ),
    *_specs(
        "tail-off",
        "1",
        tail_pressure_exponent="tail-off goes as (pressure / reference) to minus this power",
    ),
    *_specs(
        "tail-off", "1/year", tail_ageing_per_year="relative change of the tail-off time a year"
    ),
    *_specs(
        "tail-off",
        "s",
        tau_delay_s="valve delay between command and thrust",
        tau_rise_s="time constant of the thrust's rise",
        tau_fall_s="time constant of the thrust's tail-off",
    ),
    *_specs(
        "centre of mass",
        "m",
        **_by_axis("cm_{}_m", "centre of mass, {}, in the frame of the thruster positions"),
    ),
    *_specs(
        "tail-off",
        "1",
        close_pulse_share="share of pulses within a second that start one control cycle apart",
        close_pulse_factor="variance of what pairs of pulses lose, over that of independent draws "
        "of gaps as single pulses leave them; where rows lie between firings",
        late_pulse_factor="variance of what is still to be delivered when counters are read, over "
        "that of pulses at any time; where hardly a row is without firing",
        open_counter_factor="variance of on-times that rounded counters leave open, over what "
        "their readings say of it; where counters have coarse steps",
    ),
    *_specs(
        "inertia",
        "kg m2",
        inertia_xx_kg_m2="inertia matrix element xx, with the stationary wheels",
        inertia_yy_kg_m2="inertia matrix element yy, with the stationary wheels",
        inertia_zz_kg_m2="inertia matrix element zz, with the stationary wheels",
        inertia_xy_kg_m2="inertia matrix element xy (sign as in the matrix)",
        inertia_xz_kg_m2="inertia matrix element xz (sign as in the matrix)",
        inertia_yz_kg_m2="inertia matrix element yz (sign as in the matrix)",
    ),
    *_specs(
        "torque",
        "N m",
        **_by_axis("external_torque_{}_n_m", "steady external torque about body {}"),
    ),
    *_specs(
        "noise",
        "rad/s",
        **_by_axis("rate_bias_{}_rad_s", "gyro bias about body {}, measured minus true"),
        rate_noise_rad_s="white noise of a rate sample, 1 sigma",
        hold_rate_rad_s="body rate left in the dead-band at either end of a bias, 1 sigma per axis",
    ),
    *_specs(
        "noise",
        "N m s0.5",
        torque_noise_n_m_s05="momentum gained from white torque noise in 1 s, 1 sigma per axis",
    ),
    *_specs("mass", "kg", mass_kg="wet mass"),
    *_specs(
        "mass",
        "1",
        hydrazine_used_factor="true over tabulated mass of hydrazine used",
        mass_factor="factor common to the table masses of all events",
    ),
    *_specs(
        "noise",
        "rpm",
        wheel_noise_rpm="white noise of a wheel-rate sample, 1 sigma",
        wheel_resolution_rpm="least step of a wheel rate",
    ),
    *_specs(
        "noise",
        "rad",
        attitude_noise_rad="white noise of an attitude sample, 1 sigma per axis",
        hold_attitude_rad="attitude error left in the dead-band at either end, 1 sigma per axis",
    ),
    *_specs("noise", "s", on_time_resolution_s="least step of a thruster on-time"),
    *_specs(
        "noise",
        "m/s",
        delta_v_noise_m_s="noise of a velocity change beyond its printed step, 1 sigma",
        delta_v_resolution_m_s="least step of a velocity change",
        accelerometer_scale_m_s="velocity change per accelerometer count",
    ),
    *_specs(
        "noise",
        "m/s2",
        accelerometer_bias_m_s2="acceleration to add to what the accelerometer counts",
    ),
    *_specs(
        "flight software",
        "1",
        fsw_acceleration_factor="factor on the tables' thrust over mass in a computed ΔV",
    ),
    *_specs(
        "flight software",
        "s",
        fsw_impulse_offset_s="on-time the on-board ΔV computation adds per pulse",
    ),
)


def generic_parameters() -> tuple[ParameterSpec, ...]:
    """Parameters that any spacecraft has; its own (geometry, wheels) are in the spacecraft file."""
    return _GENERIC
