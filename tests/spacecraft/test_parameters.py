"""The catalogue of parameter names: complete, consistent in units, without values."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest

from cassini_bayes.spacecraft import load_spacecraft
from cassini_bayes.spacecraft.parameters import BLOCKS, ParameterSpec, generic_parameters

FILES = ("cassini", Path(__file__).parents[1] / "data" / "spacecraft" / "twelve.toml")

# What a name must end with in each unit, longest first where one contains the other.
SUFFIXES = {
    "N": "_n",
    "s": "_s",
    "m": "_m",
    "kg m2": "_kg_m2",
    "N m s0.5": "_n_m_s05",
    "N m": "_n_m",
    "rad/s": "_rad_s",
    "rad": "_rad",
    "rpm": "_rpm",
    "kg": "_kg",
    "m/s": "_m_s",
    "m/s2": "_m_s2",
    "1": "_factor",
    "N/year": "_n_per_year",
    "1/year": "_per_year",
}
PLAIN_NUMBERS = ("_share", "_exponent", "_probability")
"""Endings of further dimensionless parameters."""

EXPECTED = {
    *("thrust_common_n", "thrust_individual_n", "thrust_event_n", "thrust_jitter_n"),
    *("tau_delay_s", "tau_rise_s", "tau_fall_s", "close_pulse_share", "late_pulse_factor"),
    "close_pulse_factor",
    "open_counter_factor",
    *("cm_x_m", "cm_y_m", "cm_z_m"),
    *(f"inertia_{e}_kg_m2" for e in ("xx", "yy", "zz", "xy", "xz", "yz")),
    *(f"external_torque_{a}_n_m" for a in "xyz"),
    *(f"rate_bias_{a}_rad_s" for a in "xyz"),
    *("mass_kg", "mass_factor"),
    *("rate_noise_rad_s", "wheel_noise_rpm", "wheel_resolution_rpm", "attitude_noise_rad"),
    *("on_time_resolution_s", "hold_rate_rad_s", "hold_attitude_rad"),
    "torque_noise_n_m_s05",
    *("delta_v_noise_m_s", "delta_v_resolution_m_s"),
    *("accelerometer_scale_m_s", "accelerometer_bias_m_s2"),
    *("fsw_acceleration_factor", "fsw_impulse_offset_s"),
    *("thrust_drift_n_per_year", "thrust_ageing_n_per_year", "thrust_intercept_share"),
    *("thrust_loss_share", "failing_probability", "hydrazine_used_factor"),
    *("tail_pressure_exponent", "tail_ageing_per_year"),
}


def wrong_units(specs: tuple[ParameterSpec, ...]) -> list[str]:
    """Names whose ending is not that of their unit: the longest ending that fits counts."""
    longest = {
        spec.name: max((s for s in SUFFIXES.values() if spec.name.endswith(s)), key=len, default="")
        for spec in specs
    }
    return [
        spec.name
        for spec in specs
        if longest[spec.name] != SUFFIXES.get(spec.unit)
        and not (spec.unit == "1" and spec.name.endswith(PLAIN_NUMBERS))
    ]


def test_the_catalogue_is_complete_and_names_are_unique() -> None:
    """Every parameter of the priors format that any spacecraft has, once."""
    names = [spec.name for spec in generic_parameters()]
    assert len(names) == len(set(names))
    assert set(names) == EXPECTED


def test_names_end_with_their_unit() -> None:
    """A name carries its unit; a spec with another unit is caught."""
    assert wrong_units(generic_parameters()) == []
    for offender in (
        ParameterSpec("rate_bias_x_rad_s", "s", "noise", "seconds hidden in rad/s"),
        ParameterSpec("external_torque_x_n_m", "m", "torque", "metres hidden in N m"),
        ParameterSpec("mass", "kg", "mass", "no unit in the name"),
    ):
        assert wrong_units((offender,)) == [offender.name]


@pytest.mark.parametrize("file", FILES, ids=["cassini", "twelve"])
def test_a_spacecraft_adds_names_of_its_own_under_the_same_rules(file: str | Path) -> None:
    """Geometry and wheels come from the file, hide no generic name and end with their unit."""
    own = load_spacecraft(file).parameters
    assert not {spec.name for spec in own} & {spec.name for spec in generic_parameters()}
    assert wrong_units(own) == []
    assert {spec.block for spec in own} == {"geometry", "wheel inertia", "wheel alignment"}


def test_every_block_is_known_and_used() -> None:
    """Blocks are those of the list, and none of the list is idle."""
    own = [spec for file in FILES for spec in load_spacecraft(file).parameters]
    assert {spec.block for spec in (*generic_parameters(), *own)} == set(BLOCKS)
    assert len(set(BLOCKS)) == len(BLOCKS)


def test_meanings_are_one_line_and_tell_parameters_apart() -> None:
    """Each meaning is a single line of its own."""
    meanings = [spec.meaning for spec in generic_parameters()]
    assert all(text and "\n" not in text for text in meanings)
    assert len(set(meanings)) == len(meanings)


def test_a_spec_cannot_be_changed() -> None:
    """Specs are frozen, and the catalogue is the same one on every call."""
    with pytest.raises(dataclasses.FrozenInstanceError):
        generic_parameters()[0].unit = "lbf"  # type: ignore[misc]
    assert generic_parameters() == generic_parameters()
