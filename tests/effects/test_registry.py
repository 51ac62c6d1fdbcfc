"""The tables of effects: what is in them, what a user may change, what is refused in one line."""

from __future__ import annotations

from pathlib import Path

import pytest
from totals_cases import ROOT

from cassini_bayes.effects.catalogue import Catalogue, read_catalogue
from cassini_bayes.effects.registry import KINDS, read_kinds, standard
from cassini_bayes.errors import InputError
from cassini_bayes.priors.reader import read_priors

PRIORS = read_priors(ROOT / "priors" / "cassini_b_branch_telemetry.toml")


def changed(folder: Path, text: str) -> Catalogue:
    """The catalogue of telemetry with what a user's file changes."""
    path = folder / "changes.toml"
    path.write_text(text, encoding="utf-8")
    return read_catalogue(PRIORS, (1, 2, 4), ("telemetry",), read_kinds([path]))


def test_every_kind_has_its_table_beside_it() -> None:
    """One file and one table a kind, of the same name; no table without a kind."""
    folder = ROOT / "cassini_bayes" / "effects"
    tables = {path.stem for path in folder.glob("*.toml")} - {"causes"}
    assert tables == {kind.name for kind in KINDS}
    assert all((folder / f"{name}.py").is_file() for name in tables)


def test_a_users_table_changes_what_it_says_and_nothing_else(tmp_path: Path) -> None:
    """Another width of the leak's prior; every other effect and every probability stays."""
    text = '[effects.thruster_leak.parameters.leak_n]\nrole = "value"\ndist = "halfnorm"\n'
    own = changed(tmp_path, text + 'scale = 1.0e-4\nunit = "N"\n')
    plain = read_catalogue(PRIORS, (1, 2, 4), ("telemetry",))
    for effect, other in zip(own.effects, plain.effects, strict=True):
        assert (effect == other) == (effect.kind.name != "thruster_leak")
    assert own.effect("thruster_leak:z3").parameters[0].distribution.keywords["scale"] == 1.0e-4
    assert own.odds == plain.odds


def test_an_effect_without_inputs_is_left_out(tmp_path: Path) -> None:
    """Its share of the prior probability goes to the others."""
    own = changed(tmp_path, "[effects.time_offset]\ninputs = []\n")
    assert "time_offset" not in own.names
    total = sum(effect.prior_probability for effect in own.effects)
    assert total == pytest.approx(own.odds.catalogued)


def test_probabilities_before_the_data_can_be_changed_together(tmp_path: Path) -> None:
    """Three that add up to one are taken; two thirds of them are not."""
    own = changed(tmp_path, "[causes]\nnone = 0.8\ncatalogued = 0.15\nunknown = 0.05\n")
    assert own.odds.none == 0.8
    with pytest.raises(InputError, match="add up to 1"):
        changed(tmp_path, "[causes]\nnone = 0.8\n")


LEAK = """[effects.thruster_leak.parameters.leak_n]
role = "value"
dist = "halfnorm"
unit = "N"
"""
CENTRE = """[effects.center_of_mass.parameters."cm_{target}_m"]
role = "departure"
dist = "norm"
unit = "m"
"""


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("[effects.flexibel_mode]\ninputs = []\n", "effects.flexibel_mode.*did you mean"),
        ('[effects.time_offset]\ninputs = ["telemetri"]\n', "time_offset.inputs.*'telemetry'"),
        ('[effects.time_offset]\ninputs = "telemetry"\n', "a list of inputs"),
        (
            '[effects.time_offset]\ntargets = "thrusters"\n',
            "line 2: effects.time_offset.targets: .*inputs, source",
        ),
        ("[effects.time_offset]\ntarget = 1\n", "line 2: effects.time_offset.target: "),
        ("[effects.time_offset.parameters]\nlate_s = 1\n", "late_s.*known: time_offset_s"),
        ("[effects.time_offset.parameters]\ntime_offset_s = 1\n", "time_offset_s.*a table"),
        ('[effects.time_offset.parameters.time_offset_s]\nrole = "size"\n', "role"),
        ("[effects.thrust_warmup]\nform_error = 3\n", "form_error.*a table"),
        ("[effects.thrust_warmup.form_error]\nwarmup_tme_s = 0.1\n", "'warmup_time_s'"),
        ("[effects.thrust_warmup.form_error]\nwarmup_time_s = 7\n", "a share of the size"),
        ("[effects.thrust_warmup.form_error]\nwarmup_time_s = true\n", "a share of the size"),
        ("[effects.thrust_warmup.form_error]\ndamping = 0.1\n", "a size of the effect"),
        ("[effects.tail_off.late_form_error]\ntau_fall_s = 7\n", "late_form_error.*a share"),
        ("[cause]\nnone = 1\n", "changes.toml, line 1: cause: .*'causes'"),
        ("none = [", "valid TOML"),
        ("[effects]\nthruster_leak = 5\n", "line 2: effects.thruster_leak: .*a table"),
        ("effects = 5\n", "line 1: effects: .*a table"),
        ("[effects.thrust_warmup]\nparameters = 3\n", "line 2: .*parameters: .*a table"),
        ("[effects.thrust_warmup]\nsource = 3\n", "line 2: .*source: expected a text"),
        ('[effects.rate_bias]\ninputs = ["estimates"]\n', "line 2: .*doubt"),
        ("causes = 5\n", "line 1: causes: .*a table"),
        ('[causes]\nnone = "half"\n', "line 2: causes.none: .*a finite number"),
        ("[causes]\nnone = 2.0\ncatalogued = -1.0\nunknown = 0.0\n", "line 1: causes: "),
        ("[unknown]\nestimate_sd = 0.0\n", "line 2: unknown.estimate_sd: .*positive"),
        ("[unknown]\nestimate_sd = nan\n", "line 2: unknown.estimate_sd: .*finite"),
        (
            "[unknown]\nlever_most_m = 0.004\n",
            "line 2: unknown.lever_most_m: .*more than lever_least_m",
        ),
        ("a = " + "[" * 3_000, "at most 32 levels"),
        ("a = " + "9" * 5_000, "at most 400 characters"),
        (LEAK + "scale = -1.0\n", "line 1: .*leak_n.scale: .*above 0"),
        (LEAK + 'scale = "wide"\n', "leak_n.scale.*a finite number"),
        (LEAK + "scale = 1.0\nlow = true\n", "leak_n.low.*a finite number"),
        (LEAK + "scale = 1.0\nlow = 2.0\nhigh = 1.0\n", "leak_n"),
        (LEAK + "times_prior = 5.0\n", "line 5: .*times_prior: .*departure"),
        (CENTRE + "times_prior = -5.0\n", "line 5: .*times_prior: .*a positive number"),
        (CENTRE + 'times_prior = "5"\n', "line 5: .*times_prior: .*a finite number"),
        (CENTRE + "times_prior = 5.0\nscale = 1.0\n", "line 5: .*no other keyword"),
    ],
)
def test_mistakes_in_a_users_table_are_one_line(tmp_path: Path, text: str, told: str) -> None:
    """File, dotted key and the nearest known name."""
    with pytest.raises(InputError, match=told) as caught:
        changed(tmp_path, text)
    assert "\n" not in str(caught.value)
    assert "changes.toml" in str(caught.value)


@pytest.mark.parametrize("unit", ["newton", "N/furlong", ""])
def test_units_that_are_none_are_refused(tmp_path: Path, unit: str) -> None:
    """A unit is a product of known symbols; 'N/K', 'kg m2' and 'N m s0.5' are."""
    text = '[effects.thruster_leak.parameters.leak_n]\nrole = "value"\ndist = "halfnorm"\n'
    with pytest.raises(InputError, match=r"parameters\.leak_n\.unit"):
        changed(tmp_path, f'{text}scale = 1.0\nunit = "{unit}"\n')
    for known in ("N/K", "kg m2", "N m s0.5", "1"):
        changed(tmp_path, f'{text}scale = 1.0\nunit = "{known}"\n')


def test_a_departure_has_the_unit_of_its_parameter(tmp_path: Path) -> None:
    """A wheel's inertia in another unit is refused: it is added to the baseline's."""
    text = '[effects.wheel_inertia.parameters."rwa{target}_inertia_kg_m2"]\nrole = "departure"\n'
    with pytest.raises(InputError, match="kg m2, that of rwa1_inertia_kg_m2"):
        changed(tmp_path, text + 'dist = "norm"\ntimes_prior = 5.0\nunit = "N"\n')


def test_every_kind_that_another_names_is_there() -> None:
    """Advice on telling causes apart names kinds that exist, once for a pair."""
    names = {kind.name for kind in KINDS}
    pairs = [frozenset((kind.name, other)) for kind in KINDS for other in kind.separation]
    assert set().union(*pairs) <= names
    assert len(set(pairs)) == len(pairs)
    known = standard()
    assert known.separation("thruster_leak", "external_torque") == known.separation(
        "external_torque", "thruster_leak"
    )
    assert known.separation("inertia", "time_offset") is None
