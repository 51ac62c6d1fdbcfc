"""What every kind of effect does to the physics, against oracles of its own."""

from __future__ import annotations

import ast
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from spacecraft_cases import priors_of

import cassini_bayes
from cassini_bayes.balance.physics import Physics, physics_of
from cassini_bayes.balance.statistics import RowContext, Samples, reduce_chunks
from cassini_bayes.balance.statistics.columns import Carry, settle
from cassini_bayes.effects.catalogue import read_catalogue
from cassini_bayes.effects.pulse_shape import OFFSET_SD_S
from cassini_bayes.effects.registry import KINDS, standard
from cassini_bayes.effects.thrust_warmup import (
    LEAST_S,
    MOST_S,
    NODES_S,
    node_weights,
    on_time_column,
    on_time_lost,
    tail_column,
)
from cassini_bayes.effects.time_offset import hat_weights
from cassini_bayes.model.event_reduction import reduce_samples, sampling_of
from cassini_bayes.priors.reader import read_priors

ROOT = Path(__file__).parents[2]
PRIORS = read_priors(ROOT / "priors" / "cassini_b_branch_telemetry.toml")
CATALOGUE = read_catalogue(PRIORS, (1, 2, 4), ("telemetry", "totals"))


def centre() -> dict[str, np.ndarray]:
    """Prior means as one point."""
    values = {}
    for name, prior in PRIORS.parameters.items():
        value = prior.fixed if prior.distribution is None else prior.distribution.mean()
        values[name] = np.array([value], dtype=float)
    return values


@pytest.mark.parametrize(
    ("name", "baseline"),
    [
        ("center_of_mass:x", "cm_x_m"),
        ("inertia:xy", "inertia_xy_kg_m2"),
        ("wheel_inertia:2", "rwa2_inertia_kg_m2"),
        ("tail_off", "tau_fall_s"),
    ],
)
def test_departure_is_the_baseline_parameter_moved(name: str, baseline: str) -> None:
    """An effect on a parameter of the baseline does what moving that parameter does."""
    effect = CATALOGUE.effect(name)
    point = {**centre(), effect.parameters[0].name: np.array([0.013])}
    modify = effect.modifier(PRIORS.spacecraft, PRIORS.branch)
    found = physics_of(PRIORS.spacecraft, PRIORS.branch, point, (modify,))
    moved = {**centre(), baseline: centre()[baseline] + 0.013}
    wanted = physics_of(PRIORS.spacecraft, PRIORS.branch, moved)
    assert found.arms_m == pytest.approx(wanted.arms_m)
    assert found.inertia_kg_m2 == pytest.approx(wanted.inertia_kg_m2)
    assert found.wheel_weights == pytest.approx(wanted.wheel_weights)
    assert found.tau_s[2] == pytest.approx(wanted.tau_s[2])


def test_a_turned_platform_is_its_angle_moved_and_nearly_a_tilt() -> None:
    """A departure of the angle does what the baseline's angle does, and to first order the tilt
    u = sin 54.7° δθ; priors without the angle have no such cause.
    """
    priors = read_priors(ROOT / "priors" / "cassini_hybrid_2012.toml")
    catalogue = read_catalogue(priors, priors.wheels, ("telemetry",))
    means = {name: np.array([value]) for name, value in priors.means().items()}
    idle = dict.fromkeys(priors.spacecraft.wheel_parameters(), np.zeros(1))
    point = {**idle, **means}

    def weights(added: dict[str, float], *names: str) -> np.ndarray:
        moved = {**point, **{k: point.get(k, np.zeros(1)) + v for k, v in added.items()}}
        modifiers = tuple(
            catalogue.effect(name).modifier(priors.spacecraft, priors.branch) for name in names
        )
        return physics_of(priors.spacecraft, priors.branch, moved, modifiers).wheel_weights

    angle = "rwa4_articulation_rad"
    turn, tilt = (
        {p.key: p.name for p in catalogue.effect(f"{kind}:4").parameters}
        for kind in ("wheel_articulation", "wheel_alignment")
    )
    found = weights({turn[angle]: 0.05}, "wheel_articulation:4")
    np.testing.assert_allclose(found, weights({angle: 0.05}), atol=1e-15)
    small = weights({turn[angle]: 1e-5}, "wheel_articulation:4") - weights({})
    alike = {tilt["rwa4_tilt_u_rad"]: np.sqrt(2 / 3) * 1e-5, tilt["rwa4_tilt_v_rad"]: 0.0}
    np.testing.assert_allclose(
        small,
        weights(alike, "wheel_alignment:4") - weights({}),
        atol=1e-9 * np.abs(small).max() + 1e-10,
    )
    across = {tilt["rwa4_tilt_u_rad"]: 0.0, tilt["rwa4_tilt_v_rad"]: np.sqrt(2 / 3) * 1e-5}
    other = weights(across, "wheel_alignment:4") - weights({})
    assert np.abs(small - other).max() > 0.1 * np.abs(small).max()  # negative control
    both = {turn[angle]: 1e-3, **across}
    together = weights(both, "wheel_articulation:4", "wheel_alignment:4")
    alone = weights(both, "wheel_articulation:4") + weights(both, "wheel_alignment:4") - weights({})
    np.testing.assert_allclose(together, alone, atol=1e-8)  # neither takes the other's place
    assert not any(name.startswith("wheel_articulation") for name in CATALOGUE.names)


def test_effects_on_a_wheel_find_what_the_spacecraft_file_calls_its_parameters() -> None:
    """Twelve's wheels 1 and 2 share an inertia: the cause is one of them alone, as wide as that.
    Wheel 5 tilts under names of its own; wheels 1 and 3 cannot tilt, and have no such cause.
    """
    priors = priors_of("twelve")
    craft, numbers = priors.spacecraft, priors.spacecraft.wheel_numbers
    catalogue = read_catalogue(priors, numbers, ("telemetry",))
    tilting = [name for name in catalogue.names if name.startswith("wheel_alignment")]
    assert tilting == ["wheel_alignment:2", "wheel_alignment:5"]
    point = {name: np.array([value]) for name, value in priors.means().items()}
    plain = physics_of(craft, priors.branch, point)

    def changed(name: str, value: float) -> Physics:
        effect = catalogue.effect(name)
        own = dict.fromkeys((p.name for p in effect.parameters), np.zeros(1))
        own[effect.parameters[0].name] = np.array([value])
        modify = effect.modifier(craft, priors.branch)
        return physics_of(craft, priors.branch, {**point, **own}, (modify,))

    heavier = changed("wheel_inertia:1", 0.01).wheel_inertia_kg_m2 - plain.wheel_inertia_kg_m2
    np.testing.assert_allclose(heavier, 0.01 * np.eye(4)[:1], atol=1e-15)
    width = catalogue.effect("wheel_inertia:1").parameters[0].distribution.sd()
    assert width == pytest.approx(5 * priors.parameters["old_wheel_inertia_kg_m2"].sd)
    tilted = changed("wheel_alignment:5", 0.02).wheel_axes
    moved = {**point, "w5_tilt_u_rad": point["w5_tilt_u_rad"] + 0.02}
    wanted = physics_of(craft, priors.branch, moved).wheel_axes
    np.testing.assert_allclose(tilted, wanted, rtol=1e-14)
    assert np.abs(tilted - plain.wheel_axes).max() > 0.01


def test_a_tilt_that_wheels_share_is_that_of_the_target_alone() -> None:
    """Wheel 2 with the tilts of wheel 5 in the file: an effect on wheel 5 leaves wheel 2."""
    priors = priors_of("twelve")
    given = priors.spacecraft
    tilts = given.wheel(5).tilt_parameters
    wheels = [replace(w, tilt_parameters=tilts) if w.number == 2 else w for w in given.wheels]
    craft = replace(given, wheels=tuple(wheels))
    effect = read_catalogue(
        replace(priors, spacecraft=craft), given.wheel_numbers, ("telemetry",)
    ).effect("wheel_alignment:5")
    point = {name: np.array([value]) for name, value in priors.means().items()}
    point |= {p.name: np.array([0.02]) for p in effect.parameters}
    plain = physics_of(craft, priors.branch, point)
    found = physics_of(craft, priors.branch, point, (effect.modifier(craft, priors.branch),))
    differs = np.abs(found.wheel_axes - plain.wheel_axes).max(axis=(0, 1)) > 0.01
    assert differs.tolist() == [False, False, False, True]


def test_cant_turns_the_force() -> None:
    """A canted thruster's arm is (r − e) × unit(d + a e1 + b e2)."""
    effect = CATALOGUE.effect("thruster_misalignment:y2")
    point = centre()
    for parameter, value in zip(effect.parameters, (0.04, -0.03), strict=True):
        point[parameter.name] = np.array([value])
    modify = effect.modifier(PRIORS.spacecraft, PRIORS.branch)
    arms = physics_of(PRIORS.spacecraft, PRIORS.branch, point, (modify,)).arms_m[0]
    k = PRIORS.spacecraft.thruster_names(PRIORS.branch).index("y2")
    force = np.array([0.04, -1.0, -0.03]) / np.sqrt(1.0 + 0.04**2 + 0.03**2)
    place = np.array([-1.234, 1.610, 2.880]) - np.array([0.13, 0.057, 1.064])
    assert arms[:, k] == pytest.approx(np.cross(place, force))


def test_warm_up_between_the_nodes_loses_what_it_should() -> None:
    """On-time lost is right to 0.25 % of t_w and to 26 ms at any on-time, tails to 1 %."""
    constants = np.geomspace(LEAST_S, MOST_S, 41)
    on_time = np.concatenate([np.linspace(0.0, 40.0, 401), np.geomspace(40.0, 400.0, 50)])
    nodes = np.array(NODES_S)
    wanted = on_time_lost(on_time[:, None], constants)
    weights = node_weights(constants)
    found = on_time_lost(on_time[:, None], nodes) @ weights.T
    assert np.abs((found - wanted) / constants).max() < 0.0025
    assert np.abs(found - wanted).max() < 0.026
    pulses = 0.1 * np.arange(1.0, 3_000.0)[:, None]
    lost = np.exp(-pulses / constants).sum(axis=0)
    tails = np.exp(-pulses / nodes).sum(axis=0) @ weights.T
    assert np.abs(tails / lost - 1.0).max() < 0.01
    # negative control: as many that are even in the logarithm
    even = on_time_lost(on_time[:, None], np.geomspace(LEAST_S, MOST_S, len(nodes)))
    nearest = even @ np.linalg.lstsq(even, wanted, rcond=None)[0]
    assert np.abs(nearest - wanted).max() > 0.05


def test_time_shift_is_linear_between_nodes() -> None:
    """Half of the way between two nodes has half of each."""
    assert hat_weights(np.array([0.25]), np.array([-1.0, 0.0, 1.0])) == pytest.approx(
        np.array([[0.0, 0.75, 0.25]])
    )


@pytest.mark.parametrize("before", [0.0, 5_000.0])
def test_warm_up_takes_from_the_tails_of_pulses_as_well(before: float) -> None:
    """Pulses of 125 ms with tails of 30 ms: the columns are the sum of what each of them lost.

    Counters may have counted others ``before``.
    """
    width, tail, constant = 0.125, 0.030, NODES_S[1]
    fired = np.arange(40)
    time = np.arange(400.0)
    count = np.minimum(time // 10.0, len(fired))
    counters = (time, (width * (before + count))[:, None], (before + count)[:, None])
    context = RowContext(time, np.zeros((400, 3)), np.zeros((400, 3)), *counters)
    columns = {column.name: column for column in standard().columns(("z1",))}
    commanded = columns[on_time_column("z1", constant)].values(context)
    tails = columns[tail_column("z1", constant)].values(context)
    ends = width * (fired + 1.0)
    of_pulses = constant * (np.exp(-(ends - width) / constant) - np.exp(-ends / constant))
    place = count.astype(int)
    assert commanded == pytest.approx(np.r_[0.0, np.cumsum(of_pulses)][place])
    assert tails == pytest.approx(np.r_[0.0, np.cumsum(np.exp(-ends / constant))][place])
    assert tail * tails[-1] > 0.15 * commanded[-1]


def test_long_events_have_the_columns_of_the_whole_event() -> None:
    """The reduction cuts events into blocks; what an effect adds up has to see all of it."""
    n = 5_000
    time_s = np.arange(0.0, n)
    rng = np.random.default_rng(5)
    attitude = np.tile([0.0, 0.0, 0.0, 1.0], (n, 1))
    pulses = np.floor(time_s / 40.0)[:, None] * np.ones(8)
    rates = 1e-5 * rng.standard_normal((n, 3)), rng.standard_normal((n, 3))
    samples = Samples(time_s, attitude, *rates, 0.125 * pulses, pulses)
    thrusters = PRIORS.spacecraft.thruster_names(PRIORS.branch)
    sampling = sampling_of(PRIORS, thrusters, n - 1.0, "first_order")
    event = reduce_samples("long", "bias", (1, 2, 4), thrusters, samples, sampling)
    event = event.with_columns(standard().columns(thrusters))
    whole, sampling = event.statistics, event.sampling
    rows, _ = settle(samples, Carry.start(whole.layout), whole.layout, sampling, final=True)
    place = whole.layout.scalar.index(tail_column("z1", NODES_S[-1]))
    wanted = float((rows.scalar[:, place] ** 2).sum())
    place += len(whole.layout.vector)
    assert whole.gram[0, 0, place, place] == pytest.approx(wanted)
    in_blocks = reduce_chunks("long", "bias", [samples], whole.layout, sampling)
    assert in_blocks.gram[0, 0, place, place] < 0.99 * wanted  # it begins anew in every block


SOURCES = Path(cassini_bayes.__file__).parent
MAY_NAME_EFFECTS = ("effects", "simulation", "studies")
HOMONYMS = {
    "pulse_shape": "key of a run file and of a reduction: which closed form",
    "inertia": "block of the parameters, figure of a report",
    "external_torque": "variable of fit.nc",
}
"""Names of kinds that mean something else as well, and what."""


def effect_names(source: str) -> list[str]:
    """Strings of a module that name a kind of effect, or one on a target."""
    found = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            kind = node.value.partition(":")[0]
            if kind in {own.name for own in KINDS} - set(HOMONYMS):
                found.append(node.value)
    return found


def test_no_other_module_knows_an_effect_by_name() -> None:
    """An effect is one file: nothing but effects, their simulation and studies names one."""
    offences = {
        str(path.relative_to(SOURCES)): names
        for path in SOURCES.rglob("*.py")
        if path.relative_to(SOURCES).parts[0] not in MAY_NAME_EFFECTS
        and (names := effect_names(path.read_text(encoding="utf-8")))
    }
    assert offences == {}


def test_a_named_effect_is_caught() -> None:
    """Negative control: a module that treats an effect in a way of its own."""
    assert effect_names('if effect.kind.name == "flexible_mode": pass')
    assert effect_names('names = ["thruster_leak:z3"]')
    assert not effect_names('"""What a thruster_leak leaves."""')


def test_figures_in_code_are_those_of_the_tables() -> None:
    """Bounds of warm-ups and the size of an offset: columns and printed estimates need them."""
    warmup, offset = CATALOGUE.effect("thrust_warmup"), CATALOGUE.effect("pulse_shape")
    time = next(p for p in warmup.parameters if p.key == "warmup_time_s")
    assert time.distribution.support == (LEAST_S, MOST_S)
    assert offset.parameters[0].distribution.sd() == pytest.approx(OFFSET_SD_S)
    assert LEAST_S < NODES_S[0] < NODES_S[-1] < MOST_S
