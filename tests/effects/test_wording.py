"""Sizes in words: rounded by their error, in engineering units, by the effect's own sentence."""

from __future__ import annotations

from pathlib import Path

import pytest

from cassini_bayes.effects.registry import read_kinds, standard
from cassini_bayes.effects.wording import Stated, rounded

ROOT = Path(__file__).parents[2]
PLUME = ROOT / "docs" / "examples" / "plume.py"


@pytest.mark.parametrize(
    ("mean", "sd", "said"),
    [
        (0.827, 0.119, "0.83 ± 0.12"),  # the examples of the Particle Data Group's rule
        (0.827, 0.367, "0.8 ± 0.4"),
        (0.827, 0.096, "0.83 ± 0.10"),
        (7412.0, 42.0, "7,410 ± 40"),
        (-0.0301, 0.004, "−0.030 ± 0.004"),
    ],
)
def test_a_size_is_rounded_by_its_error(mean: float, sd: float, said: str) -> None:
    """Two digits of an error up to 3.5, one above, as printed examples of the rule have it."""
    assert Stated(mean, sd, mean - sd, mean + sd).said().startswith(said)


def test_a_thruster_s_loss_is_said_in_per_cent_of_its_thrust() -> None:
    """The sentence of the issue that asked for it, from a factor."""
    size = Stated(0.7412, 0.0409, 0.661, 0.802)
    said = standard().says("thruster_degraded:z3", {"thrust_factor": size})
    assert said == "Z3 delivers 74 ± 4 % (90 % HDI 66 to 80 %) of its thrust"


def test_every_effect_of_the_package_has_words_with_all_its_sizes() -> None:
    """Each says its own sizes with their intervals; none falls back to keys."""
    kinds = standard()
    for kind, table in kinds.kinds:
        target = {"thruster": "z3", "wheel": "4", "axis": "x", "element": "xx"}.get(
            table.targets, "4" if "wheel" in table.targets else ""
        )
        name = f"{kind.name}:{target}" if target else kind.name
        keys = kind.reported or [
            parameter.key.replace("{target}", target) for parameter in table.parameters
        ]
        sizes = {key: Stated(0.5, 0.01, 0.48, 0.52) for key in keys}
        said = kinds.says(name, sizes)
        assert kind.says is not None
        assert " acts with " not in said, said
        assert "90 % HDI" in said, said


def test_an_effect_of_a_user_is_said_by_keys_and_units() -> None:
    """Without words of its own: name, key, size, unit of its table; likewise where a size lacks."""
    kinds = read_kinds([PLUME])
    said = kinds.says("plume:z3", {"lever_m": Stated(0.05, 0.01, 0.03, 0.07, "m")})
    assert said == "plume:z3 acts with lever_m = 0.050 ± 0.010 m (90 % HDI 0.030 to 0.070 m)"
    assert kinds.unit("plume:z3", "lever_m") == "m"
    assert standard().says("tail_off", {"other": Stated(1.0, 0.1, 0.8, 1.2)}).startswith("tail_off")


def test_no_minus_zero_is_printed() -> None:
    """What rounds to nothing has no sign."""
    assert rounded(-0.004, 1) == "0.0"
