"""Which measurement would tell two confounded causes apart."""

from __future__ import annotations

from typing import Final

BY_KINDS: Final[dict[frozenset[str], str]] = {
    frozenset({"external_torque", "thruster_leak"}): (
        "a quiescent period at another attitude, or with the other branch's valves closed: a leak "
        "stays in body axes and goes with its latch valve, a solar torque turns with the Sun"
    ),
    frozenset({"tail_off", "pulse_shape"}): (
        "pulses of different widths: only there do a tail-off and an offset per pulse differ"
    ),
    frozenset({"tail_off", "thrust_scale"}): (
        "a long firing (delta-V) beside short pulses: thrust counts seconds, tails count pulses"
    ),
    frozenset({"pulse_shape", "thrust_scale"}): (
        "a long firing (delta-V) beside short pulses: thrust counts seconds, offsets count pulses"
    ),
    frozenset({"thruster_misalignment", "thruster_degraded"}): (
        "an accelerometer or Doppler velocity change: a weaker thruster pushes less, a canted one "
        "pushes elsewhere"
    ),
    frozenset({"center_of_mass", "thruster_degraded"}): (
        "a measured velocity change per thruster pair: the centre of mass moves torque, not force"
    ),
    frozenset({"center_of_mass", "thrust_scale"}): (
        "a measured velocity change: the centre of mass moves torque, not force"
    ),
    frozenset({"rate_scale", "inertia"}): (
        "attitude from the star tracker against integrated rates over a large turn"
    ),
    frozenset({"wheel_inertia", "thrust_scale"}): (
        "a slew on wheels alone: thrust plays no part there"
    ),
    frozenset({"wheel_inertia", "inertia"}): (
        "slews about several axes and a measured velocity change during a bias"
    ),
}
SAME_COUPLE: Final = (
    "nothing that fires them together: fire one thruster of the couple alone, or use its own "
    "chamber pressure or temperature"
)
OTHERWISE: Final = "events with other wheel rates, so that other thrusters do the work"


def separating_measurement(first: str, second: str, couples: tuple[tuple[str, ...], ...]) -> str:
    """The measurement that would separate two causes, in words.

    Parameters
    ----------
    first, second
        Names of causes.
    couples
        Names of thrusters that only ever fire together.
    """
    (kind, _, target), (other, _, other_target) = first.partition(":"), second.partition(":")
    if target and other_target and target != other_target:
        for couple in couples:
            if target in couple and other_target in couple:
                return SAME_COUPLE
    return BY_KINDS.get(frozenset({kind, other}), OTHERWISE)
