"""Reading spacecraft files: a mistake gets one line that mends it; any spacecraft can be fitted."""

from __future__ import annotations

import hashlib
import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import tomli_w
from spacecraft_cases import CASSINI, FILES, PRIORS, TWELVE, balanced_events, priors_of, table

from cassini_bayes.computing.arrays import Array
from cassini_bayes.errors import InputError
from cassini_bayes.events.totals import TotalsEvent, read_totals, write_totals
from cassini_bayes.model import Model, build_model, draw, log_posterior
from cassini_bayes.sampling.warmstart import warm_start
from cassini_bayes.spacecraft import AXIS_DEMANDS, Spacecraft, lever_arms, load_spacecraft

TEXT = TWELVE.read_text(encoding="utf-8")

# what is changed: (old, new) in the made-up file, and what the message must name
MISTAKES = {
    "unknown key": (('name = "twelve"', 'nmae = "twelve"'), ["nmae", "did you mean 'name'"]),
    "unknown table": (("[axis_pairs]", "[axis_pears]"), ["axis_pears", "'axis_pairs'"]),
    "unknown wheel key": (("axis = [0.6", "axes = [0.6"), ["wheel.w1.axes", "'axis'"]),
    "unknown thruster key": (
        ("direction = [0.36, 0.48", "directoin = [0.36, 0.48"),
        ["thruster.p1.directoin", "'direction'"],
    ),
    "unknown parameter key": (('block = "geometry"', 'blok = "geometry"'), ["arm_m.blok", "block"]),
    "no name": (('name = "twelve"\n', ""), ["name", "nothing"]),
    "empty name": (('name = "twelve"', 'name = ""'), ["name", "''"]),
    "name is a number": (('name = "twelve"', "name = 12"), ["name", "12"]),
    "no branches": (('branches = ["P", "R"]\n\n', "branches = []\n\n"), ["branches", "[]"]),
    "repeated branch": (('= ["P", "R"]\n\n', '= ["P", "R", "P"]\n\n'), ["branches", "'P' twice"]),
    "branch without thrusters": (
        ('= ["P", "R"]\n\n', '= ["P", "R", "S"]\n\n'),
        ["branches", "'S'"],
    ),
    "branch in another folder": (
        ('= ["P", "R"]\n\n', '= ["P", "../R"]\n\n'),
        ["branches[2]", "../R"],
    ),
    "branch with a line end": (
        ('= ["P", "R"]\n\n', '= ["P", "R\\n"]\n\n'),
        ["branches[2]", "a name of letters, digits"],
    ),
    "branch without a name": (('= ["P", "R"]\n\n', '= ["P", ""]\n\n'), ["branches[2]", "''"]),
    "branch is a number": (('= ["P", "R"]\n\n', "= [1]\n\n"), ["branches", "1"]),
    "a limit of nothing": (
        ("highest_wheel_rpm = 10000.0", "highest_wheel_rpm = 0.0"),
        ["highest_wheel_rpm", "0.0"],
    ),
    "planned beyond the limit": (
        (
            "highest_wheel_rpm = 10000.0",
            "highest_wheel_rpm = 10000.0\nplanned_wheel_rpm = [0, 2e4]",
        ),
        ["planned_wheel_rpm", "highest_wheel_rpm, 10000 rev/min", "[0, 20000]"],
    ),
    "planned the wrong way round": (
        ("highest_wheel_rpm = 10000.0", "highest_wheel_rpm = 1e4\nplanned_wheel_rpm = [9, 3]"),
        ["planned_wheel_rpm", "the smaller first", "[9, 3]"],
    ),
    "undeclared branch": (
        ('branches = ["P"]', 'branches = ["Q"]'),
        ["thruster.r1.branches", "'Q'"],
    ),
    "repeated own branch": (
        ('branches = ["P"]', 'branches = ["P", "P"]'),
        ["thruster.r1.branches", "'P' twice"],
    ),
    "thruster without branch": (
        ('branches = ["P"]', "branches = []"),
        ["thruster.r1.branches", "[]"],
    ),
    "axis too long": (
        ("axis = [0.6, 0.0, 0.8]", "axis = [0.6, 0.0, 0.9]"),
        ["wheel.w1.axis", "1.08"],
    ),
    "zero axis": (("axis = [0.6, 0.0, 0.8]", "axis = [0, 0, 0]"), ["wheel.w1.axis", "norm 0"]),
    "axis of two": (("axis = [0.6, 0.0, 0.8]", "axis = [0.6, 0.8]"), ["wheel.w1.axis", "3"]),
    "axis of four": (("axis = [0.6, 0.0, 0.8]", "axis = [0.6, 0.8, 0, 0]"), ["wheel.w1.axis", "3"]),
    "axis of truths": (
        ("axis = [0.6, 0.0, 0.8]", "axis = [false, false, true]"),
        ["wheel.w1.axis[1]", "False"],
    ),
    "axis of text": (
        ("axis = [0.6, 0.0, 0.8]", 'axis = ["0.6", 0.0, 0.8]'),
        ["wheel.w1.axis[1]", "'0.6'"],
    ),
    "axis is nan": (
        ("axis = [0.6, 0.0, 0.8]", "axis = [nan, 0.0, 0.8]"),
        ["wheel.w1.axis[1]", "nan"],
    ),
    "axis is a number": (("axis = [0.6, 0.0, 0.8]", "axis = 1.0"), ["wheel.w1.axis", "1.0"]),
    "direction too short": (
        ("direction = [0.36, 0.48, 0.8]", "direction = [0.36, 0.48, 0.7]"),
        ["thruster.p1.direction", "norm 0.92"],
    ),
    "direction is infinite": (
        ("direction = [0.36, 0.48, 0.8]", "direction = [inf, 0.48, 0.8]"),
        ["thruster.p1.direction[1]", "inf"],
    ),
    "tilt along z": (
        ("axis = [0.0, 0.6, 0.8]", "axis = [0.0, 0.0, 1.0]"),
        ["wheel.w2.tilt", "not along Z"],
    ),
    "tilt of one": (
        ('tilt = ["w2_tilt_u_rad", "w2_tilt_v_rad"]', 'tilt = ["w2_tilt_u_rad"]'),
        ["wheel.w2.tilt", "2"],
    ),
    "same tilt twice": (
        ('"w2_tilt_u_rad", "w2_tilt_v_rad"]', '"w2_tilt_u_rad", "w2_tilt_u_rad"]'),
        ["wheel.w2.tilt", "twice"],
    ),
    "unknown tilt": (
        ('["w2_tilt_u_rad"', '["w2_tlit_u_rad"'),
        ["wheel.w2.tilt", "'w2_tilt_u_rad'"],
    ),
    "tilt in kg m2": (('["w2_tilt_u_rad"', '["w3_inertia_kg_m2"'), ["wheel.w2.tilt", "rad"]),
    "unknown inertia": (
        ('inertia = "w3_inertia_kg_m2"', 'inertia = "w4_inertia_kg_m2"'),
        ["wheel.w3.inertia", "'w4_inertia_kg_m2'", "did you mean"],
    ),
    "inertia in m": (
        ('inertia = "w3_inertia_kg_m2"', 'inertia = "arm_m"'),
        ["wheel.w3.inertia", "kg m2"],
    ),
    "inertia is a number": (
        ('inertia = "w3_inertia_kg_m2"', "inertia = 0.05"),
        ["w3.inertia", "0.05"],
    ),
    "no inertia": (('inertia = "w3_inertia_kg_m2"\n', ""), ["wheel.w3.inertia", "nothing"]),
    "wheel number 0": (("number = 3", "number = 0"), ["wheel.w3.number", "0"]),
    "wheel number true": (("number = 3", "number = true"), ["wheel.w3.number", "True"]),
    "wheel number as text": (("number = 3", 'number = "3"'), ["wheel.w3.number", "'3'"]),
    "wheel number a fraction": (("number = 3", "number = 3.5"), ["wheel.w3.number", "3.5"]),
    "repeated wheel number": (("number = 3", "number = 2"), ["wheel.number", "2 twice"]),
    "repeated wheel name": (('name = "w3"', 'name = "w2"'), ["wheel.name", "'w2' twice"]),
    "wheel name in capitals": (('name = "w3"', 'name = "W 3"'), ["wheel", "name", "'W 3'"]),
    "repeated thruster": (('name = "p2"', 'name = "p1"'), ["thruster.name", "'p1' twice"]),
    "thruster without name": (('name = "p1"\n', ""), ["thruster[1].name", "nothing"]),
    "unknown position": (('["+arm_m", "+g', '["+amr_m", "+g'), ["p1.position[1]", "'arm_m'"]),
    "two signs": (('["+arm_m", "+g', '["+-arm_m", "+g'), ["p1.position[1]", "'arm_m'"]),
    "position in rad": (('["+arm_m", "+g', '["w2_tilt_u_rad", "+g'), ["p1.position[1]", "in m"]),
    "position is generic": (('["+arm_m", "+g', '["cm_x_m", "+g'), ["p1.position[1]", "cm_x_m"]),
    "position is text": (('["+arm_m", "+g', '["1.2", "+g'), ["p1.position[1]", "1.2"]),
    "position is empty": (('["+arm_m", "+g', '["", "+g'), ["p1.position[1]", "''"]),
    "position is true": (('["+arm_m", "+g', '[true, "+g'), ["p1.position[1]", "True"]),
    "position is infinite": (('["+arm_m", "+g', '[inf, "+g'), ["p1.position[1]", "inf"]),
    "position is nan": (('["+arm_m", "+g', '[nan, "+g'), ["p1.position[1]", "nan"]),
    "position of two": (('["+arm_m", "+g', '["+g'), ["thruster.p1.position", "3"]),
    "pair of an unknown thruster": (
        ('"+x" = ["p1"', '"+x" = ["p9"'),
        ["axis_pairs.+x", "'p9'", "'p"],
    ),
    "pair names one twice": (
        ('"+x" = ["p1", "p2"]', '"+x" = ["p1", "p1"]'),
        ["axis_pairs.+x", "'p1' twice"],
    ),
    "pair on both sides": (
        ('"+x" = ["p1", "p2"]', '"+x" = ["p1", "p3"]'),
        ["axis_pairs.+x", "'p3'"],
    ),
    "empty pair": (('"+x" = ["p1", "p2"]', '"+x" = []'), ["axis_pairs.+x", "nothing"]),
    "missing demand": (('"+x" = ["p1", "p2"]\n', ""), ["axis_pairs.+x", "nothing"]),
    "unknown demand": (('"+x" = ["p1"', '"+w" = ["p1"'), ["axis_pairs.+w", "choose one of them"]),
    "pair is no list": (('"+x" = ["p1", "p2"]', '"+x" = "p1"'), ["axis_pairs.+x", "'p1'"]),
    "branch without the demand": (('"r1", "r2", "s1"', '"s1"'), ["axis_pairs.+z", "branch 'P'"]),
    "unknown block": (('block = "geometry"', 'block = "geometri"'), ["arm_m.block", "'geometry'"]),
    "no unit": (('unit = "m"\n', ""), ["parameters.arm_m.unit", "nothing"]),
    "unit is a number": (('unit = "m"\n', "unit = 1\n"), ["parameters.arm_m.unit", "1"]),
    "no meaning": (('meaning = "half distance of the pods along X"\n', ""), ["arm_m.meaning"]),
    "generic name": (
        ("[parameters.arm_m]", "[parameters.cm_x_m]"),
        ["parameters.cm_x_m", "every spacecraft"],
    ),
    "parameter in capitals": (("[parameters.arm_m]", "[parameters.Arm]"), ["parameters", "'Arm'"]),
    "parameter is no table": (
        ("[parameters.arm_m]", "[parameters]\nx_m = 3\n[parameters.arm_m]"),
        ["x_m"],
    ),
    "bad TOML": (("branches = [", "branches = [["), ["TOML"]),
    "twice in TOML": (('name = "twelve"', 'name = "twelve"\nname = "x"'), ["TOML", "line"]),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_every_mistake_is_one_line_that_names_file_and_key(mistake: str, tmp_path: Path) -> None:
    """One line: the file, the dotted key, what was expected, what was found, what to do."""
    (old, new), words = MISTAKES[mistake]
    assert old in TEXT, "the mistake must change the file"
    path = tmp_path / "mine.toml"
    path.write_text(TEXT.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(InputError) as caught:
        load_spacecraft(path)
    message = str(caught.value)
    assert message.startswith(str(path))
    assert "\n" not in message
    assert "expected" in message
    assert "got" in message
    for word in words:
        assert word in message
    assert "pydantic" not in message
    assert "Error" not in message


@pytest.mark.parametrize("key", ["branches", "wheel", "thruster", "parameters", "axis_pairs"])
def test_a_missing_table_is_named(key: str, tmp_path: Path) -> None:
    """Each top-level entry is obligatory."""
    path = tmp_path / "short.toml"
    path.write_text(tomli_w.dumps({k: v for k, v in table("twelve").items() if k != key}))
    with pytest.raises(InputError, match=rf"short\.toml: {key}: .*nothing.*add {key}"):
        load_spacecraft(path)
    path.write_text(tomli_w.dumps(table("twelve")))
    assert load_spacecraft(path).name == "twelve"


def test_references_that_lead_nowhere(tmp_path: Path) -> None:
    """An unknown built-in, a missing file, a folder, bytes that are no text, a null byte."""
    with pytest.raises(InputError, match="did you mean 'cassini'"):
        load_spacecraft("cassinni")
    with pytest.raises(InputError, match=r"built-in.*or the path of a \.toml"):
        load_spacecraft("")
    with pytest.raises(InputError, match="built-in"):
        load_spacecraft("../spacecraft/cassini")
    with pytest.raises(InputError, match=r"none\.toml.*No such file|none\.toml.*no such file"):
        load_spacecraft(tmp_path / "none.toml")
    (tmp_path / "folder.toml").mkdir()
    with pytest.raises(InputError, match=r"folder\.toml"):
        load_spacecraft(tmp_path / "folder.toml")
    (tmp_path / "latin.toml").write_bytes(b'name = "\xb5"\n')
    with pytest.raises(InputError, match="UTF-8"):
        load_spacecraft(tmp_path / "latin.toml")
    with pytest.raises(InputError, match="null"):
        load_spacecraft("null\0.toml")


@pytest.mark.parametrize("name", FILES)
def test_what_was_read_is_what_the_file_says(name: str) -> None:
    """Wheels, thrusters, branches and pairs against tomllib; arrays cannot be written to."""
    craft, file = load_spacecraft(FILES[name]), table(name)
    assert craft.name == name
    assert craft.digest == hashlib.sha256(FILES[name].read_bytes()).hexdigest()
    assert [w.number for w in craft.wheels] == [w["number"] for w in file["wheel"]]
    for wheel, raw in zip(craft.wheels, file["wheel"], strict=True):
        np.testing.assert_allclose(wheel.axis, raw["axis"], atol=1e-9)
        assert np.linalg.norm(wheel.axis) == pytest.approx(1.0, abs=1e-15)
        assert wheel.tilt_parameters == (tuple(raw["tilt"]) if "tilt" in raw else None)
        assert craft.wheel(raw["number"]) is wheel
        with pytest.raises(ValueError, match="read-only"):
            wheel.axis[0] = 2.0
    for branch in craft.branches:
        own = tuple(t["name"] for t in file["thruster"] if branch in t["branches"])
        assert craft.thruster_names(branch) == own
        assert tuple(t.name for t in craft.thrusters_of(branch)) == own
    assert {d: list(craft.axis_pairs[d]) for d in AXIS_DEMANDS} == file["axis_pairs"]
    assert [s.name for s in craft.parameters] == list(file["parameters"])
    with pytest.raises(InputError, match="wheel: expected one of"):
        craft.wheel(77)


def test_built_in_and_path_are_the_same_spacecraft(tmp_path: Path) -> None:
    """By name, by path, with Windows line ends and byte-order mark."""
    by_name, by_path = load_spacecraft("cassini"), load_spacecraft(CASSINI)
    assert by_name.digest == by_path.digest
    windows = tmp_path / "windows.toml"
    windows.write_bytes(b"\xef\xbb\xbf" + CASSINI.read_bytes().replace(b"\n", b"\r\n"))
    assert load_spacecraft(windows).thruster_names("A") == by_name.thruster_names("A")


@pytest.mark.parametrize("name", FILES)
def test_a_spacecraft_travels_to_worker_processes(name: str) -> None:
    """A pickled copy has the same geometry (the package itself never writes a pickle)."""
    craft = load_spacecraft(FILES[name])
    copy: Spacecraft = pickle.loads(pickle.dumps(craft))  # noqa: S301
    assert copy.digest == craft.digest
    values = {n: 1.5 for b in craft.branches for n in craft.geometry[b].parameters}
    values.update({f"cm_{axis}_m": 0.1 for axis in "xyz"})
    for branch in craft.branches:
        np.testing.assert_array_equal(
            lever_arms(copy, branch, values), lever_arms(craft, branch, values)
        )


@pytest.mark.parametrize("name", FILES)
def test_what_was_read_is_frozen(name: str) -> None:
    """No table and no array of a branch, wheel or thruster can be written to."""
    craft = load_spacecraft(FILES[name])
    for mapping in (craft.axis_pairs, craft.geometry):
        with pytest.raises(TypeError, match="item assignment"):
            mapping["+x"] = ()  # type: ignore[index]
    arrays = [thruster.direction for thruster in craft.thrusters]
    arrays += [wheel.tilt_axes for wheel in craft.wheels if wheel.tilt_parameters]
    for geometry in craft.geometry.values():
        own = [value for value in vars(geometry).values() if isinstance(value, np.ndarray)]
        assert len(own) == 5
        arrays += own
    for array in arrays:
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0.0


def test_only_rounding_is_normalised_away(tmp_path: Path) -> None:
    """A norm 2e-7 off one becomes one; 1.6e-6 off is an error that states the norm."""
    path = tmp_path / "rounded.toml"
    path.write_text(TEXT.replace("axis = [0.6, 0.0, 0.8]", "axis = [0.6000003, 0.0, 0.8]"))
    axis = load_spacecraft(path).wheel(1).axis
    assert axis[0] != 0.6
    assert np.linalg.norm(axis) == pytest.approx(1.0, abs=1e-15)
    path.write_text(TEXT.replace("axis = [0.6, 0.0, 0.8]", "axis = [0.6, 0.0, 0.800002]"))
    with pytest.raises(InputError, match=r"wheel\.w1\.axis.*got norm 1\.0000016"):
        load_spacecraft(path)


# ---- any spacecraft, from its file to the posterior ---------------------------------------------


def made_up(name: str, seed: int) -> tuple[tuple[TotalsEvent, ...], Array]:
    """Six balanced events of parameters and thrusts drawn from the priors, and those thrusts."""
    priors = priors_of(name)
    rng = np.random.default_rng(seed)
    space = priors.space(tuple(n for n in priors.parameters if not n.startswith("thrust_")))
    drawn = space.to_parameters(0.7 * space.sample(rng, 1))
    values = {key: float(np.asarray(value).reshape(-1)[0]) for key, value in drawn.items()}

    def normal(parameter: str, *shape: int) -> Array:
        distribution = priors.parameters[parameter].distribution
        assert distribution is not None
        return distribution.mean() + distribution.sd() * rng.standard_normal(shape)

    n, k = 6, len(priors.spacecraft.thrusters_of(priors.branch))
    thrust = normal("thrust_common_n") + normal("thrust_individual_n", k)
    thrust = thrust + normal("thrust_event_n", n, 1) + normal("thrust_jitter_n", n, k)
    return balanced_events(name, priors.branch, values, thrust, rng, n), thrust


def posterior_thrust(model: Model) -> tuple[Array, Array]:
    """Mean and standard deviation (E, K) of every thrust, all nuisances integrated over."""
    rng = np.random.default_rng(5)
    warm = warm_start(lambda z: log_posterior(model, z), len(model.space.names), rng)
    assert warm.draws.pareto_k < 0.7
    z = warm.draws.resample(rng, 1500)
    thrust = draw(model, z, rng).thrusts.thrust_n
    return thrust.mean(0), thrust.std(0)


@pytest.mark.parametrize("name", FILES)
def test_thrusts_of_any_spacecraft_are_recovered(name: str, tmp_path: Path) -> None:
    """File → events → CSV → model → posterior, for Cassini and for the made-up spacecraft alike."""
    events, truth = made_up(name, seed=8)
    priors = priors_of(name)
    path = tmp_path / "events.csv"
    write_totals(path, events, priors.spacecraft)
    model = build_model(read_totals(path, priors.spacecraft, "simulation"), priors)
    z = model.space.sample(np.random.default_rng(3), 50)
    assert np.isfinite(log_posterior(model, z)).all()
    mean, sd = posterior_thrust(model)
    score = (mean - truth) / sd
    assert np.abs(score).max() < 4.0
    # the scores share one common scale: their mean scatters like a single standard normal
    assert 0.3 < np.sqrt(np.mean(score**2)) < 2.5
    prior_sd = np.hypot(
        model.thrust_prior.common_sd_n,
        np.sqrt(np.diag(model.thrust_prior.departures @ model.thrust_prior.departures.T)),
    )
    assert np.median(sd / np.hypot(prior_sd, model.thrust_prior.individual_sd_n)) < 0.6
    # negative control: on-times recorded half again too long cannot pass for these thrusts
    longer = tuple(replace(event, on_time_s=1.5 * event.on_time_s) for event in events)
    wrong, spread = posterior_thrust(build_model(longer, priors))
    assert np.median(np.abs(wrong - truth) / spread) > 4.0


def test_priors_name_the_made_up_spacecraft_alone() -> None:
    """Its priors file mentions no Cassini parameter, and loads through spacecraft.file."""
    priors = priors_of("twelve")
    assert priors.spacecraft.name == "twelve"
    own = {spec.name for spec in load_spacecraft("cassini").parameters}
    assert not own & set(priors.parameters) - {s.name for s in priors.spacecraft.parameters}
    assert "cassini" not in PRIORS["twelve"].read_text(encoding="utf-8").lower()
