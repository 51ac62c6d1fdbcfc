"""A priors file is checked at the door and becomes an ordered space walked in standard normals."""

from __future__ import annotations

import copy
import hashlib
import math
import re
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mission_cases import mixed_events
from scipy import stats

from cassini_bayes.errors import InputError
from cassini_bayes.model import build_model
from cassini_bayes.priors.distributions import Distribution
from cassini_bayes.priors.reader import (
    ParameterPrior,
    ParameterSpace,
    Priors,
    known_parameters,
    read_priors,
)
from cassini_bayes.spacecraft.parameters import CLOSE_SHARE, THRUST_LEVELS, ParameterSpec

FOLDER = Path(__file__).parents[2] / "priors"
B_BRANCH = FOLDER / "cassini_b_branch_2010.toml"
A_BRANCH = FOLDER / "cassini_a_branch_2005.toml"

TEXT = """\
[spacecraft]
name = "cassini"
branch = "B"
wheels = [1, 2, 4]

[parameters.cm_x_m]
dist = "norm"
loc = 0.13
scale = 0.013
unit = "m"
source = "paper 004"

[parameters.thrust_individual_n]
dist = "norm"
loc = 0.0
scale = 0.02
unit = "N"
source = "paper 003"

[parameters.tau_fall_s]
dist = "norm"
loc = 0.050
scale = 0.020
low = 0.0
unit = "s"
source = "paper 000"

[parameters.hold_rate_rad_s]
dist = "lognorm"
s = 0.5
scale = 4e-5
unit = "rad/s"
source = "minimum pulse"

[parameters.tau_rise_s]
fixed = 0.020
unit = "s"
source = "paper 000"
"""
NAMES = ("cm_x_m", "tau_fall_s", "hold_rate_rad_s", "tau_rise_s")


def write(folder: Path, text: str) -> Path:
    """A priors file with this text."""
    path = folder / "priors.toml"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.fixture
def priors(tmp_path: Path) -> Priors:
    """The small file above, read."""
    return read_priors(write(tmp_path, TEXT))


def test_reading_keeps_what_the_file_says(tmp_path: Path) -> None:
    """Branch, wheels, every value, unit and source, the path and the digest of the bytes."""
    path = write(tmp_path, TEXT)
    priors = read_priors(path)
    assert (priors.spacecraft.name, priors.branch, priors.wheels) == ("cassini", "B", (1, 2, 4))
    cm = priors.parameters["cm_x_m"]
    assert cm.distribution == Distribution("norm", {"loc": 0.13, "scale": 0.013})
    assert (cm.spec.unit, cm.source, cm.fixed) == ("m", "paper 004", None)
    assert priors.parameters["tau_rise_s"].fixed == 0.020
    assert priors.parameters["tau_rise_s"].distribution is None
    assert priors.parameters["tau_fall_s"].distribution.low == 0.0
    assert priors.path == str(path)
    assert priors.digest == hashlib.sha256(path.read_bytes()).hexdigest()


@pytest.mark.parametrize(
    ("value", "said"),
    [
        ('dist = "norm"\nloc = -0.76\nscale = 0.05', "-0.76"),
        ("fixed = -0.76", "-0.76"),
        ("fixed = 0.0", "a value above 0, got 0.0"),
    ],
)
def test_a_thrust_that_does_not_push_is_refused(tmp_path: Path, value: str, said: str) -> None:
    """Its sign is that of the direction in the spacecraft file; the reader blames no counter."""
    table = f'\n[parameters.thrust_common_n]\n{value}\nunit = "N"\nsource = "x"\n'
    with pytest.raises(InputError, match=rf"parameters\.thrust_common_n.*{re.escape(said)}"):
        read_priors(write(tmp_path, TEXT + table))


def test_bom_and_crlf_are_tolerated(tmp_path: Path, priors: Priors) -> None:
    """A file saved by another editor says the same."""
    path = tmp_path / "windows.toml"
    path.write_bytes(b"\xef\xbb\xbf" + TEXT.replace("\n", "\r\n").encode())
    assert read_priors(path).parameters == priors.parameters


@pytest.mark.parametrize("path", [B_BRANCH, A_BRANCH], ids=lambda path: path.stem)
def test_shipped_files_are_complete(path: Path) -> None:
    """Every value has a source, and all that a totals model asks for is there."""
    priors = read_priors(path)
    assert all(len(prior.source) > 20 for prior in priors.parameters.values())
    wheels = [wheel for wheel in priors.spacecraft.wheels if wheel.number in priors.wheels]
    needed = [
        *("thrust_common_n", *THRUST_LEVELS, "tau_delay_s", "tau_rise_s", "tau_fall_s"),
        *(f"cm_{axis}_m" for axis in "xyz"),
        *(f"external_torque_{axis}_n_m" for axis in "xyz"),
        *(f"thruster_{length}_m" for length in ("lx", "ly", "lzz", "lzy")),
        *(f"inertia_{element}_kg_m2" for element in ("xx", "yy", "zz", "xy", "xz", "yz")),
        *(wheel.inertia_parameter for wheel in wheels),
        *(name for wheel in wheels for name in wheel.tilt_parameters or ()),
        *("hold_rate_rad_s", "hold_attitude_rad", "on_time_resolution_s", "wheel_resolution_rpm"),
    ]
    priors.require(needed, "the totals model")


def test_shipped_values_are_those_of_the_papers() -> None:
    """Figures typed here again from the papers, not copied from the files."""
    b, a = read_priors(B_BRANCH), read_priors(A_BRANCH)
    assert (b.branch, b.wheels) == ("B", (1, 2, 4))
    assert (a.branch, a.wheels) == ("A", (1, 2, 3))

    def mean_sd(priors: Priors, name: str) -> tuple[float, float]:
        distribution = priors.parameters[name].distribution
        return distribution.mean(), distribution.sd()

    paper_004 = {"cm_x_m": 0.13, "cm_y_m": 0.057, "cm_z_m": 1.064}
    for name, value in paper_004.items():
        assert mean_sd(b, name) == pytest.approx((value, 0.1 * value))
    for name, value in zip(("xx", "yy", "zz"), (6558, 5393, 3518), strict=True):
        assert mean_sd(b, f"inertia_{name}_kg_m2") == pytest.approx((value, 0.05 * value))
    for name, value in zip(("xx", "yy", "zz"), (7362, 6130, 3750), strict=True):
        assert mean_sd(a, f"inertia_{name}_kg_m2") == pytest.approx((value, 0.05 * value), rel=1e-3)
    for priors in (a, b):
        for name, value in zip(("xy", "xz", "yz"), (-164, -12, 149), strict=True):
            assert mean_sd(priors, f"inertia_{name}_kg_m2") == (value, 75.0)
        for axis, value in zip("xyz", (-0.53e-6, -2.11e-6, 1.83e-6), strict=True):
            assert mean_sd(priors, f"external_torque_{axis}_n_m")[0] == pytest.approx(value)
        for number, value in ((1, 0.161), (2, 0.160), (3, 0.161)):
            expected = (value, 0.01 * value)
            assert mean_sd(priors, f"rwa{number}_inertia_kg_m2") == pytest.approx(expected)
        assert priors.parameters["tau_delay_s"].fixed == 0.005
    lengths = {"lx": (1.234, 1.234), "ly": (1.580, 1.610), "lzy": (2.880, 2.880)}
    for name, values in lengths.items():
        for priors, value in zip((a, b), values, strict=True):
            assert mean_sd(priors, f"thruster_{name}_m") == pytest.approx((value, 0.01 * value))


def test_space_keeps_the_order_and_counts_each_name_once(priors: Priors) -> None:
    """Free parameters in the order asked for, repeats dropped, fixed ones carried apart."""
    space = priors.space((*NAMES, "cm_x_m"))
    assert space.names == ("cm_x_m", "tau_fall_s", "hold_rate_rad_s")
    assert dict(space.fixed) == {"tau_rise_s": 0.020}
    assert space.blocks == ("centre of mass", "tail-off", "noise")
    assert space.dimension == 3
    assert np.all(space.log_prior_terms(np.zeros(3)) == stats.norm.logpdf(0.0))
    assert priors.space(()).to_parameters(np.empty((4, 0))) == {}
    twice = (space.distributions[0],) * 2
    with pytest.raises(ValueError, match="twice"):
        ParameterSpace(("cm_x_m", "cm_x_m"), {}, twice, ("centre of mass",) * 2)
    with pytest.raises(ValueError, match="twice"):
        ParameterSpace(("cm_x_m",), {"cm_x_m": 0.1}, twice[:1], ("centre of mass",))
    with pytest.raises(ValueError, match="length"):
        ParameterSpace(("cm_x_m",), {}, twice, ("centre of mass",))


@pytest.mark.parametrize("shape", [(), (7,), (5, 3)])
def test_to_parameters_is_the_quantile_of_each_prior(
    priors: Priors, shape: tuple[int, ...]
) -> None:
    """θ = F⁻¹(Φ(z)) for any leading shape, by scipy's ppf; to_standard undoes it."""
    space = priors.space(NAMES)
    z = np.random.default_rng(3).standard_normal((*shape, 3))
    parameters = space.to_parameters(z)
    probability = stats.norm.cdf(z)
    expected = {
        "cm_x_m": stats.norm(0.13, 0.013).ppf(probability[..., 0]),
        "tau_fall_s": stats.truncnorm(-2.5, math.inf, 0.05, 0.02).ppf(probability[..., 1]),
        "hold_rate_rad_s": stats.lognorm(0.5, scale=4e-5).ppf(probability[..., 2]),
    }
    assert list(parameters) == ["tau_rise_s", *expected]
    for name, values in expected.items():
        assert np.shape(parameters[name]) == shape
        np.testing.assert_allclose(parameters[name], values, rtol=1e-9)
    assert parameters["tau_rise_s"] == 0.020
    np.testing.assert_allclose(space.to_standard(parameters), z, atol=1e-9)


def test_shape_mistakes_are_programming_errors(priors: Priors) -> None:
    """A z of the wrong length raises instead of broadcasting."""
    space = priors.space(NAMES)
    for wrong in (np.zeros((5, 4)), np.zeros(1), np.float64(0.0)):
        with pytest.raises(ValueError, match="expected z of shape"):
            space.to_parameters(wrong)


def test_log_prior_is_the_density_of_the_parameters(priors: Priors) -> None:
    """Σ log p(θ) + Σ log dθ/dz equals the standard normal density in z, by scipy's pdfs."""
    space, step = priors.space(NAMES), 1e-5
    z = np.random.default_rng(5).uniform(-2, 2, (20, 3))
    theta = space.to_parameters(z)
    slopes = [
        (space.to_parameters(z + step)[name] - space.to_parameters(z - step)[name]) / (2 * step)
        for name in space.names
    ]
    physical = (
        stats.norm(0.13, 0.013).logpdf(theta["cm_x_m"])
        + stats.truncnorm(-2.5, math.inf, 0.05, 0.02).logpdf(theta["tau_fall_s"])
        + stats.lognorm(0.5, scale=4e-5).logpdf(theta["hold_rate_rad_s"])
    )
    walked = physical + sum(np.log(slope) for slope in slopes)
    np.testing.assert_allclose(space.log_prior_terms(z).sum(-1), walked, atol=1e-7)


def test_log_prior_by_block_adds_up() -> None:
    """Blocks partition the parameters: their sum is the whole log prior, block by block."""
    priors = read_priors(B_BRANCH)
    space = priors.space(priors.parameters)
    z = space.sample(np.random.default_rng(1), 6)
    blocks = space.log_prior_by_block(z)
    np.testing.assert_allclose(sum(blocks.values()), space.log_prior_terms(z).sum(-1))
    np.testing.assert_allclose(
        blocks["centre of mass"],
        stats.norm.logpdf(z[:, [i for i, n in enumerate(space.names) if n.startswith("cm_")]]).sum(
            -1
        ),
    )


@pytest.mark.statistical
def test_sample_draws_from_the_prior(priors: Priors) -> None:
    """Draws pushed to parameters follow scipy's priors; the same seed gives the same draws."""
    space = priors.space(NAMES)
    z = space.sample(np.random.default_rng(2), 4000)
    assert np.array_equal(z, space.sample(np.random.default_rng(2), 4000))
    theta = space.to_parameters(z)
    assert stats.kstest(theta["cm_x_m"], stats.norm(0.13, 0.013).cdf).pvalue > 1e-3
    truncated = stats.truncnorm(-2.5, math.inf, 0.05, 0.02)
    assert stats.kstest(theta["tau_fall_s"], truncated.cdf).pvalue > 1e-3


def test_variants_are_new_objects(priors: Priors) -> None:
    """with_distribution, with_fixed and scaled change one prior of a copy and nothing else."""
    wide = Distribution("norm", {"loc": 0.13, "scale": 0.05})
    changed = priors.with_distribution("cm_x_m", wide)
    assert changed.parameters["cm_x_m"].distribution == wide
    assert changed.parameters["cm_x_m"].source == "paper 004"
    assert priors.parameters["cm_x_m"].distribution.sd() == 0.013
    assert {n: p for n, p in changed.parameters.items() if n != "cm_x_m"} == {
        n: p for n, p in priors.parameters.items() if n != "cm_x_m"
    }
    assert priors.with_fixed("cm_x_m", 0.1).space(NAMES).fixed["cm_x_m"] == 0.1
    assert changed.with_distribution("tau_rise_s", wide).space(["tau_rise_s"]).dimension == 1
    scaled = priors.scaled(["cm_x_m", "tau_rise_s"], width=2.0, shift=1.0)
    assert scaled.parameters["cm_x_m"].distribution.mean() == pytest.approx(0.143)
    assert scaled.parameters["cm_x_m"].distribution.sd() == pytest.approx(0.026)
    assert scaled.parameters["tau_rise_s"] == priors.parameters["tau_rise_s"]
    with pytest.raises(InputError, match="cm_q_m"):
        priors.with_distribution("cm_q_m", wide)
    with pytest.raises(InputError, match="finite"):
        priors.with_fixed("cm_x_m", math.nan)
    with pytest.raises(TypeError):
        priors.parameters["cm_x_m"] = changed.parameters["cm_x_m"]  # type: ignore[index]


def test_priors_of_a_branch_are_those_of_a_fit_of_it(tmp_path: Path) -> None:
    """A file that names branch A gives the A branch's own priors to a model of A; either file gives
    a mission the same of both branches, and what one branch alone has is no prior of the other.
    """
    text = (FOLDER / "cassini_mission.toml").read_text("utf-8")
    tables = tomllib.loads(text)
    alone = '[branch.A.parameters.mass_kg]\nfixed = 2500.0\nunit = "kg"\nsource = "made up"\n'
    files = {}
    for branch in "AB":
        path = tmp_path / f"{branch}.toml"
        path.write_text(text.replace('branch = "B"', f'branch = "{branch}"') + alone, "utf-8")
        files[branch] = read_priors(path)
    for branch, own in files.items():
        loc = {"A": tables["branch"]["A"]["parameters"], "B": tables["parameters"]}[branch]
        for name in ("thrust_common_n", "thruster_ly_m", "tau_fall_s"):
            found = own.parameters[name].distribution
            assert found is not None
            assert found.loc == loc[name]["loc"]
        assert own.parameters["cm_x_m"] == files["B"].parameters["cm_x_m"]
        assert ("mass_kg" in own.parameters) == (branch == "A")
        for other in "AB":
            assert dict(own.for_branch(other).parameters) == dict(files[other].parameters)
            assert dict(own.for_branch(other).for_branch(branch).parameters) == dict(own.parameters)
    wide = files["A"].scaled(["thruster_ly_m"], width=2.0)
    assert wide.for_branch("A") == wide
    space = build_model(mixed_events()[:2], replace(files["A"], wheels=(1, 2, 3))).space
    model = dict(zip(space.names, space.distributions, strict=True))
    assert model["thruster_ly_m"].loc == 1.58


def test_scaled_priors_stay_where_a_parameter_can_be(priors: Priors) -> None:
    """A uniform of a parameter that is never negative is widened upwards only; one of another
    parameter both ways; a normal that had no bound gets none.
    """
    flat = Distribution("uniform", {"loc": 0.0, "scale": 0.6})
    for name, support in (("tau_rise_s", (0.0, 0.9)), ("cm_x_m", (-0.3, 0.9))):
        wide = priors.with_distribution(name, flat).scaled([name], width=2.0)
        found = wide.parameters[name].distribution
        assert found is not None
        assert found.support == pytest.approx(support)
    plain = Distribution("norm", {"loc": 0.5, "scale": 0.1})
    changed = priors.with_distribution("tau_rise_s", plain).scaled(["tau_rise_s"], width=4.0)
    assert changed.parameters["tau_rise_s"].distribution == plain.scaled(4.0)


@pytest.mark.parametrize("file", ["a_branch_telemetry", "b_branch_telemetry", "hybrid_2012"])
def test_a_share_of_pulses_stays_a_share_in_a_sweep(file: str) -> None:
    """Written in the file or built in: wider or moved it stays between 0 and 1, and bounds at its
    own ends leave it the uniform that it is.
    """
    priors = read_priors(FOLDER / f"cassini_{file}.toml")
    for width, shift in ((2.0, 0.0), (1.0, 1.0), (4.0, -1.0)):
        found = priors.scaled([CLOSE_SHARE], width, shift).parameters[CLOSE_SHARE].distribution
        assert found is not None
        assert found.support[0] >= 0.0
        assert found.support[1] <= 1.0
    own, z = priors.parameters[CLOSE_SHARE].distribution, np.linspace(-9.0, 9.0, 101)
    plain = Distribution("uniform", {"loc": 0.0, "scale": 1.0})
    assert own is not None
    assert np.array_equal(own.quantile_of_standard(z), plain.quantile_of_standard(z))
    shares = own.quantile_of_standard(z)
    assert np.array_equal(own.standard_of(shares), plain.standard_of(shares))
    assert np.array_equal(own.log_density(shares), plain.log_density(shares))
    assert (own.mean(), own.sd()) == (plain.mean(), plain.sd())


def test_priors_and_spaces_can_be_copied_to_workers(priors: Priors) -> None:
    """What a process pool does with its arguments keeps them equal."""
    space = priors.space(NAMES)
    again = copy.deepcopy(space)
    assert again == space
    z = np.ones(3)
    assert again.to_parameters(z) == space.to_parameters(z)
    twin = copy.deepcopy(priors)
    assert (twin.parameters, twin.digest) == (priors.parameters, priors.digest)


def test_a_prior_is_a_distribution_or_a_value() -> None:
    """Neither or both is a programming error."""
    spec = ParameterSpec("cm_x_m", "m", "centre of mass", "centre of mass along X")
    with pytest.raises(ValueError, match="not both"):
        ParameterPrior(spec, None, None, "nowhere")
    with pytest.raises(ValueError, match="not both"):
        ParameterPrior(spec, Distribution("norm", {}), 1.0, "nowhere")


def test_require_names_file_key_and_nearest(priors: Priors) -> None:
    """A parameter the model needs and the file lacks: who needs it and what to add."""
    priors.require(NAMES, "the totals model")
    with pytest.raises(InputError) as caught:
        priors.require(["cm_y_m"], "the totals model")
    for fragment in (
        *(priors.path, "parameters.cm_y_m", "the totals model", "[parameters.cm_y_m]", "cm_x_m"),
        "m (",
    ):
        assert fragment in str(caught.value)
    with pytest.raises(InputError, match=r"cm_yy_m.*did you mean 'cm_y_m'"):
        priors.require(["cm_yy_m"], "a plug-in")
    with pytest.raises(InputError, match="cm_y_m"):
        priors.space(["cm_y_m"])


CM = TEXT.split("\n\n")[1]
BAD_FILES = {
    "syntax": (('branch = "B"', "branch = B"), ["TOML", "line 3"]),
    "table twice": (("[parameters.tau_rise_s]", "[parameters.cm_x_m]"), ["TOML", "line"]),
    "unknown top key": (("[spacecraft]", "[spacecarft]"), ["spacecarft", "'spacecraft'"]),
    "loose top key": (("[spacecraft]", "seed = 1\n[spacecraft]"), ["seed", "unknown key"]),
    "unknown spacecraft": (('"cassini"', '"casini"'), ["casini", "cassini"]),
    "unknown spacecraft key": (("branch =", "brunch ="), ["brunch", "did you mean 'branch'"]),
    "name and file": (('name = "cassini"', 'name = "cassini"\nfile = "x.toml"'), ["both"]),
    "no spacecraft name": (('name = "cassini"\n', ""), ["spacecraft", "neither"]),
    "name is a path": (('"cassini"', '"mine.toml"'), ["spacecraft.name", "file ="]),
    "name is a number": (('"cassini"', "3"), ["spacecraft.name", "3"]),
    "unknown branch": (('branch = "B"', 'branch = "C"'), ["spacecraft.branch", "'C'", "A, B"]),
    "no branch": (('branch = "B"\n', ""), ["spacecraft.branch", "nothing"]),
    "branch is a number": (('branch = "B"', "branch = 2"), ["spacecraft.branch", "2"]),
    "unknown wheel": (("[1, 2, 4]", "[1, 2, 7]"), ["spacecraft.wheels[3]", "7", "[1, 2, 3, 4]"]),
    "repeated wheel": (("[1, 2, 4]", "[1, 2, 2]"), ["spacecraft.wheels[3]", "2 twice"]),
    "negative wheel": (("[1, 2, 4]", "[1, -2, 4]"), ["spacecraft.wheels[2]", "-2"]),
    "wheel as text": (("[1, 2, 4]", '[1, "2", 4]'), ["spacecraft.wheels[2]", "'2'"]),
    "wheel is true": (("[1, 2, 4]", "[true, 2, 4]"), ["spacecraft.wheels[1]", "True"]),
    "no wheels": (("[1, 2, 4]", "[]"), ["spacecraft.wheels", "[]"]),
    "wheels no list": (("[1, 2, 4]", "124"), ["spacecraft.wheels", "124"]),
    "misspelt parameter": (("cm_x_m]", "cm_x]"), ["parameters.cm_x", "did you mean 'cm_x_m'"]),
    "parameter no table": ((CM, "[parameters]\ncm_x_m = 0.13"), ["parameters.cm_x_m", "table"]),
    "unknown key": (("scale = 0.013", "scael = 0.013"), ["cm_x_m.scael", "mean 'scale'"]),
    "misspelt source": (('source = "paper 004"', 'suorce = "x"\nsource = "y"'), ["mean 'source'"]),
    "unknown distribution": (('"norm"', '"nrom"'), ["cm_x_m.dist", "'nrom'", "mean 'norm'"]),
    "distribution is a number": (('"norm"', "1"), ["cm_x_m.dist", "1"]),
    "wrong keyword": (("loc = 0.13", "mean = 0.13"), ["cm_x_m.mean", "loc, scale"]),
    "missing shape": (("s = 0.5\n", ""), ["hold_rate_rad_s.s", "lognorm"]),
    "wrong unit": (('unit = "m"', 'unit = "mm"'), ["cm_x_m.unit", "'m'", "'mm'", "convert"]),
    "no unit": (('unit = "m"\n', ""), ["cm_x_m.unit", "nothing"]),
    "no source": (('source = "paper 004"\n', "\n"), ["cm_x_m.source", "nothing"]),
    "blank source": (('source = "paper 004"', 'source = " "'), ["cm_x_m.source", "' '"]),
    "source is a number": (('source = "paper 004"', "source = 4"), ["cm_x_m.source", "4"]),
    "dist and fixed": (("loc = 0.13", "loc = 0.13\nfixed = 0.13"), ["cm_x_m", "both"]),
    "neither": (('dist = "norm"\nloc = 0.13\nscale = 0.013\n', ""), ["cm_x_m", "neither"]),
    "bounds of a value": (("fixed = 0.020", "fixed = 0.020\nlow = 0.0"), ["tau_rise_s.low"]),
    "typo beside fixed": (("fixed = 0.020", "fixed = 0.020\nunti = 1"), ["mean 'unit'"]),
    "fixed as text": (("fixed = 0.020", 'fixed = "0.020"'), ["tau_rise_s.fixed", "quotes"]),
    "fixed is true": (("fixed = 0.020", "fixed = true"), ["tau_rise_s.fixed", "True"]),
    "fixed nan": (("fixed = 0.020", "fixed = nan"), ["tau_rise_s.fixed", "nan"]),
    "fixed inf": (("fixed = 0.020", "fixed = -inf"), ["tau_rise_s.fixed", "-inf"]),
    "fixed negative": (("fixed = 0.020", "fixed = -0.020"), ["tau_rise_s.fixed", "0 or more"]),
    "loc as text": (("loc = 0.13", 'loc = "0.13"'), ["cm_x_m.loc", "without quotes"]),
    "loc is a list": (("loc = 0.13", "loc = [0.13]"), ["cm_x_m.loc", "[0.13]"]),
    "loc nan": (("loc = 0.13", "loc = nan"), ["cm_x_m.loc", "nan"]),
    "scale inf": (("scale = 0.013", "scale = inf"), ["cm_x_m.scale", "inf"]),
    "scale zero": (("scale = 0.013", "scale = 0"), ["cm_x_m.scale", "above 0"]),
    "scale negative": (("scale = 0.013", "scale = -0.013"), ["cm_x_m.scale", "above 0"]),
    "no mean": (('dist = "norm"', 'dist = "cauchy"'), ["cm_x_m.dist", "bound it by low"]),
    "low above high": (("low = 0.0", "low = 0.2\nhigh = 0.1"), ["tau_fall_s.low", "swap"]),
    "low is high": (("low = 0.0", "low = 0.1\nhigh = 0.1"), ["tau_fall_s.low"]),
    "low as text": (("low = 0.0", 'low = "0"'), ["tau_fall_s.low", "number"]),
    "loc below low": (("low = 0.0", "low = 0.06"), ["tau_fall_s.loc", "0.05", "0.06"]),
    "loc above high": (("low = 0.0", "low = 0.0\nhigh = 0.04"), ["tau_fall_s.loc", "0.04"]),
    "no mass": (("s = 0.5", "s = 0.5\nlow = 1.0"), ["hold_rate_rad_s.low", "probability"]),
    "bound forgotten": (("low = 0.0\n", ""), ["tau_fall_s.low", "0.62 %", "add low = 0.0"]),
    "departure off centre": (("loc = 0.0\n", "loc = 0.1\n"), ["thrust_individual_n.loc", "0.1"]),
}


@pytest.mark.parametrize(("change", "fragments"), BAD_FILES.values(), ids=BAD_FILES)
def test_bad_files_say_what_is_wrong(
    tmp_path: Path, change: tuple[str, str], fragments: list[str]
) -> None:
    """Each mistake is refused: the message names the file, the dotted key and the way out."""
    old, new = change
    assert old in TEXT
    path = write(tmp_path, TEXT.replace(old, new, 1))
    with pytest.raises(InputError) as caught:
        read_priors(path)
    message = str(caught.value)
    assert message.startswith(str(path)) or "casini" in fragments
    assert "\n" not in message
    for fragment in fragments:
        assert fragment in message


def test_departures_may_be_fixed_at_zero_only(tmp_path: Path) -> None:
    """thrust_individual_n and its like count from the common thrust, so only 0 can be fixed."""
    table = TEXT.split("\n\n")[2]
    zero = "[parameters.thrust_individual_n]\nfixed = 0.0\nunit = 'N'\nsource = 'x'"
    assert read_priors(write(tmp_path, TEXT.replace(table, zero))).parameters[
        "thrust_individual_n"
    ].fixed == pytest.approx(0.0, abs=0.0)
    with pytest.raises(InputError, match=r"thrust_individual_n\.fixed.*0\.1.*thrust_common_n"):
        read_priors(write(tmp_path, TEXT.replace(table, zero.replace("0.0", "0.1"))))


def test_bounds_may_leave_out_the_edge_of_a_one_sided_family(tmp_path: Path) -> None:
    """loc of a log-normal is its edge, not its middle: a bound above it is no slip."""
    text = TEXT.replace("s = 0.5", "s = 0.5\nlow = 1e-5")
    assert read_priors(write(tmp_path, text)).parameters["hold_rate_rad_s"].distribution.low == 1e-5


@pytest.mark.parametrize("unit", ["kg m2", "kg m²", "kg·m²", "kg m^2", "kg*m^2", " kg  m2 "])
def test_spellings_of_one_unit(tmp_path: Path, unit: str) -> None:
    """A unit may be written as papers or as keyboards do; another unit stays refused."""
    table = "[parameters.inertia_xx_kg_m2]\nfixed = 6558\nunit = '{}'\nsource = 'paper 004'\n"
    priors = read_priors(write(tmp_path, TEXT + table.format(unit)))
    assert priors.parameters["inertia_xx_kg_m2"].fixed == 6558.0
    with pytest.raises(InputError, match=r"inertia_xx_kg_m2\.unit"):
        read_priors(write(tmp_path, TEXT + table.format(unit.replace("kg", "g"))))


@pytest.mark.parametrize(
    "name",
    [
        *("thrust_intercept_share", "thrust_loss_share"),
        *("failing_probability", "hydrazine_used_factor"),
    ],
)
def test_what_all_branches_share_is_in_no_table_of_one(tmp_path: Path, name: str) -> None:
    """It would be ignored, or missing: refused with table and fix. A thrust may differ."""
    table = "\n[branch.A.parameters.{}]\nfixed = 0.7\nunit = '{}'\nsource = 'x'\n"
    path = write(tmp_path, TEXT + table.format(name, "1"))
    fix = rf"branch\.A\.parameters\.{name}: .* write it as \[parameters\.{name}\]"
    with pytest.raises(InputError, match=fix) as refused:
        read_priors(path)
    assert str(refused.value).startswith(str(path))
    priors = read_priors(write(tmp_path, TEXT + table.format("thrust_common_n", "N")))
    assert priors.for_branch("A").parameters["thrust_common_n"].fixed == 0.7


def test_a_gyro_bias_has_a_sign(tmp_path: Path) -> None:
    """Negative control of the rule on negative values: a bias may well be below zero."""
    table = "\n[parameters.rate_bias_x_rad_s]\nfixed = -1e-6\nunit = 'rad/s'\nsource = 'x'\n"
    priors = read_priors(write(tmp_path, TEXT + table))
    assert priors.parameters["rate_bias_x_rad_s"].fixed == -1e-6


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    """Missing (with the nearest name), a folder, or not text: said in one line."""
    write(tmp_path, TEXT)
    with pytest.raises(InputError, match=r"no such file.*did you mean 'priors\.toml'"):
        read_priors(tmp_path / "prior.toml")
    with pytest.raises(InputError, match="a priors file"):
        read_priors(tmp_path)
    (tmp_path / "latin.toml").write_bytes(b"[spacecraft]\n# 5 \xb5N m\n")
    with pytest.raises(InputError, match=r"line 2: expected UTF-8"):
        read_priors(tmp_path / "latin.toml")
    (tmp_path / "empty.toml").write_text("")
    with pytest.raises(InputError, match="spacecraft"):
        read_priors(tmp_path / "empty.toml")


def test_a_spacecraft_file_is_sought_beside_the_priors(tmp_path: Path) -> None:
    """A relative spacecraft.file starts from the priors file's folder."""
    text = TEXT.replace('name = "cassini"', 'file = "no_such_spacecraft.toml"')
    with pytest.raises(InputError) as caught:
        read_priors(write(tmp_path, text))
    assert str(tmp_path / "no_such_spacecraft.toml") in str(caught.value)


def test_parameters_of_the_spacecraft_are_known() -> None:
    """Generic parameters and those that the spacecraft file declares, each under its own name."""
    priors = read_priors(B_BRANCH)
    specs = known_parameters(priors.spacecraft)
    assert {"cm_x_m", "thruster_lx_m", "rwa4_tilt_u_rad"} <= set(specs)
    assert all(name == spec.name for name, spec in specs.items())
