"""Effects that a user brings: the worked example of the docs, and every mistake in one line."""

from __future__ import annotations

import json
import shutil
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from totals_cases import ROOT

from cassini_bayes.diagnosis import read
from cassini_bayes.diagnosis.balance_case import BalanceCase
from cassini_bayes.diagnosis.events import Events, prepare
from cassini_bayes.diagnosis.hypotheses import compact, extend, none_hypothesis
from cassini_bayes.diagnosis.verdict import weigh
from cassini_bayes.diagnosis.visible import no_effect, prior_width
from cassini_bayes.effects.effect import Kind
from cassini_bayes.effects.registry import Kinds, read_kinds
from cassini_bayes.errors import InputError
from cassini_bayes.events.totals import TotalsEvent, read_totals
from cassini_bayes.model import ReducedEvent
from cassini_bayes.priors.reader import Priors, read_priors
from cassini_bayes.report import diagnosis_pictures
from cassini_bayes.studies.scenario import simulate_scenario, simulated_sides

EXAMPLE = ROOT / "docs" / "examples" / "plume.py"
PRIORS = read_priors(ROOT / "priors" / "cassini_b_branch_2010.toml")
FLIGHT = ROOT / "cassini_bayes" / "published" / "flight_2009_2010.csv"
SCENARIO = ROOT / "runs" / "scenarios" / "calibration.toml"
LEVER_M = 0.3
FEW = ("plume:z3", "thruster_degraded:z3", "thruster_misalignment:z3", "center_of_mass:y")


def scenario(folder: Path) -> Path:
    """One bias and the slews with a plume of Z3."""
    head, *events = SCENARIO.read_text(encoding="utf-8").split("[[event]]\n")
    kept = [event for event in events if not event.startswith('id = "bias-2"')]
    ends = "to_rpm = [700.0, -300.0, 400.0]"
    assert ends in kept[0]
    kept[0] = kept[0].replace(ends, "to_rpm = [-100.0, 250.0, 450.0]")  # half as far, half as long
    effect = f'[[effect]]\nname = "plume:z3"\n[effect.parameters]\nlever_m = {LEVER_M}\n'
    head = head.replace("../../priors", str(ROOT / "priors"))
    head = head.replace("mass_kg = ", "rate_noise_rad_s = 2e-6\nmass_kg = ")
    path = folder / "scenario.toml"
    path.write_text("[[event]]\n".join([head, *kept]) + "\n" + effect, encoding="utf-8")
    return path


def with_few_causes(
    telemetry: Sequence[ReducedEvent],
    known: Priors,
    rows: Sequence[TotalsEvent],
    kinds: Kinds | None,
) -> Events:
    """Events with the plume, where there is one, and causes that act much as it does."""
    events = prepare(telemetry, known, rows, kinds)
    chosen = tuple(own for own in events.catalogue.effects if own.name in FEW)
    return replace(events, catalogue=replace(events.catalogue, effects=chosen))


def test_the_worked_example_is_flown_and_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Hidden by its simulated side, found by its change of the physics, its lever about right.

    With the catalogue alone another cause takes its place (negative control).
    """
    from typer.testing import CliRunner

    from cassini_bayes.cli import app

    monkeypatch.setattr(read, "prepare", with_few_causes)
    monkeypatch.setattr(diagnosis_pictures, "_drawn", lambda _: None)
    flown = tmp_path / "flown"
    simulate_scenario(scenario(tmp_path), flown, 3, own=simulated_sides([EXAMPLE]))
    truth = json.loads((flown / "truth.json").read_text(encoding="utf-8"))
    assert truth["effects"][0]["name"] == "plume:z3"
    priors = ROOT / "priors" / "cassini_b_branch_telemetry.toml"
    events = [str(flown / name) for name in ("bias-1", "slews")]
    out = tmp_path / "diagnosis"
    command = ["diagnose", *events, "--priors", str(priors), "--out", str(out)]
    command += ["--effects", str(EXAMPLE), "--no-gain", "--quiet", "--seed", "1"]
    done = CliRunner().invoke(app, command)
    assert done.exit_code == 0, done.output
    record = json.loads((out / "diagnosis.json").read_text(encoding="utf-8"))
    best = record["causes"][0]
    assert "plume:z3" in {best["name"], *best["confounded_with"]}
    plume = next(cause for cause in record["causes"] if cause["name"] == "plume:z3")
    low, high = plume["parameters"]["lever_m"]["hdi_90"]
    assert abs(LEVER_M - 0.5 * (low + high)) < high - low  # 3.3 standard deviations
    assert set(record["effects"]) == {str(EXAMPLE), str(EXAMPLE.with_suffix(".toml"))}
    alone = read.read_events(events, priors, "flight")
    without = weigh(BalanceCase(alone), np.random.default_rng(1), pairs=False)
    assert without.best.name in {"unknown", *FEW} - {"plume:z3"}
    assert without.best_cause is not None
    assert without.best_cause.net_evidence < record["extended"]["log_evidence"]


def copied(folder: Path, old: str, new: str, suffix: str = ".py") -> Path:
    """The example with something changed in one of its files."""
    for path in (EXAMPLE, EXAMPLE.with_suffix(".toml")):
        shutil.copy(path, folder / path.name)
    changed = (folder / EXAMPLE.name).with_suffix(suffix)
    text = changed.read_text(encoding="utf-8")
    assert old in text
    changed.write_text(text.replace(old, new), encoding="utf-8")
    return folder / EXAMPLE.name


def weighed(path: Path) -> np.ndarray:
    """The log density of the effect on two flight biases at two points."""
    rows = read_totals(str(FLIGHT), PRIORS.spacecraft, "flight")[:2]
    events = prepare((), PRIORS, rows, read_kinds([path]))
    effect = events.catalogue.effect("plume:z3")
    own = compact(extend(none_hypothesis(events), [effect]))
    return own.log_density(np.zeros((2, own.dimension)))


def test_an_effect_of_no_size_is_the_baseline(tmp_path: Path) -> None:
    """At a lever of zero the density is the baseline's times the prior's of the lever."""
    found = weighed(copied(tmp_path, '"plume"', '"plume"'))
    events = prepare((), PRIORS, read_totals(str(FLIGHT), PRIORS.spacecraft, "flight")[:2])
    none = none_hypothesis(events)
    wanted = none.log_density(np.zeros((1, none.dimension)))[0] - 0.5 * np.log(2.0 * np.pi)
    assert found == pytest.approx([wanted, wanted])


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ('values["lever_m"]', 'values["lever"]', r"plume.py, line \d+: .*KeyError: 'lever'"),
        ("k = setting.thruster", "k = setting.thruster + 'a'", r"line \d+: .*TypeError"),
        ("k = setting.thruster", "k = (", r"line \d+: .*SyntaxError"),
        ("import numpy as np", "import numpi as np", r"line \d+: .*ModuleNotFoundError"),
        ("(physics, parameters, values, setting)", "(physics, values)", r"line \d+: .*change\("),
        (
            "return replace(physics, arms_m=arms)",
            "return arms",
            r"plume.py, line \d+: change: .*a Physics",
        ),
        ("arms_m=arms)", "arms_m=arms[..., :2])", r"change: arms_m: .*\(2, 3, 8\)"),
        ('    "plume",\n', '    "plums",\n', "KIND.name"),
        ("KIND = Kind", "KINDS = Kind", r"KIND = Kind\(\.\.\.\)"),
        ("    change,\n", "", r"line \d+: .*TypeError.*change"),
        ("    change,\n", "    chnage=change,\n", r"line \d+: .*TypeError.*chnage"),
        ("    change,\n", "    5,\n", r"plume.py: expected change\(.*not a callable"),
        ("arms_m=arms)", "arms_m=arms * np.nan)", r"line \d+: change: arms_m: .*finite"),
        ("arms_m=arms)", "arms_m=arms * 1j)", r"line \d+: change: arms_m: .*real numbers"),
        ("arms_m=arms)", "arms_m='wide')", r"line \d+: change: arms_m: .*real numbers"),
        ("arms_m=arms)", "arms_m=[[1.0], 2.0])", r"line \d+: change: arms_m: .*real numbers"),
        ("arms_m=arms)", "tau_s=3)", "change: tau_s: expected three arrays, got int"),
        ("arms_m=arms)", "tau_s=(arms,) * 3)", r"change: tau_s \(delay\): .*an array \(2,\)"),
        (
            "arms_m=arms)",
            "tau_s=(*physics.tau_s[:2], np.array(np.nan)))",
            r"change: tau_s \(fall\): expected finite values",
        ),
        ("arms_m=arms)", "close_share=np.nan)", "change: close_share: expected finite values"),
        ("arms_m=arms)", "pair_factor=arms)", r"change: pair_factor: expected an array \(2,\)"),
        ("arms_m=arms)", "late_factor='a')", "change: late_factor: expected real numbers"),
        ("arms_m=arms)", "open_factor=np.inf)", "change: open_factor: expected finite values"),
        ("arms_m=arms)", "arm_m=arms)", r"line \d+: .*TypeError.*arm_m"),
        ("import numpy as np", "import numpy as np; exit(3)", r"line \d+: .*SystemExit"),
        ("k = setting.thruster", "return k()", r"line \d+: .*UnboundLocalError|NameError"),
        (
            "    separation={",
            "    reported=5,\n    separation={",
            r"line \d+: KIND.reported: .*texts",
        ),
        (
            "    separation={",
            "    known_to=[5],\n    separation={",
            r"line \d+: KIND.known_to: .*steps",
        ),
        (
            "    separation={",
            "    known_to={'a': 1.0},\n    separation={",
            "known_to of plume.*'a'",
        ),
        ("    separation={", "    reported=('a',),\n    separation={", "reported of plume.*'a'"),
        (
            "    separation={",
            "    separation=5) or dict(a={",
            r"line \d+: KIND.separation: .*texts",
        ),
    ],
)
def test_mistakes_in_a_file_are_one_line(tmp_path: Path, old: str, new: str, told: str) -> None:
    """File and line, or what is wrong with the result; nothing is searched with a broken effect."""
    with pytest.raises(InputError, match=told) as caught:
        weighed(copied(tmp_path, old, new))
    assert "\n" not in str(caught.value)
    assert str(tmp_path / "plume") in str(caught.value)


@pytest.mark.parametrize(
    ("new", "told"),
    [
        ('dist = "nrom"\nscale = 0.1', "lever_m.dist: .*'norm'"),
        ('dist = "norm"\nscale = -0.1', "lever_m.scale: .*above 0"),
        ('dist = "norm"\nscale = "a"', "lever_m.scale: .*a finite number"),
    ],
)
def test_a_prior_that_is_none_is_refused_as_the_table_is_read(
    tmp_path: Path, new: str, told: str
) -> None:
    """Also where these events cannot show the effect, or no command has asked for it yet."""
    path = copied(tmp_path, 'dist = "norm"\nloc = 0.0\nscale = 0.1', new, ".toml")
    with pytest.raises(InputError, match=told):
        read_kinds([path])


def test_a_width_left_out_is_one(tmp_path: Path) -> None:
    """As docs/reference/priors-format.md says of ``scale``; the diagnosis asks for it by name."""
    path = copied(tmp_path, "loc = 0.0\nscale = 0.1\n", "", ".toml")
    rows = read_totals(str(FLIGHT), PRIORS.spacecraft, "flight")[:1]
    effect = prepare((), PRIORS, rows, read_kinds([path])).catalogue.effect("plume:z3")
    assert prior_width(effect.parameters[0]) == 1.0
    assert no_effect(effect.parameters[0]) == 0.0


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ('"telemetry"', '"telemetri"', r"plume.toml, line \d+: inputs: .*did you mean 'telemetry'"),
        (
            'targets = "thruster"',
            'targets = "thrusters"',
            r"plume.toml, line \d+: targets: .*'thruster'",
        ),
        ('unit = "m"', 'unit = "metre"', r"plume.toml, line \d+: parameters.lever_m.unit"),
        ('dist = "norm"', 'dist = "nrom"', r"plume.toml, line \d+: parameters.lever_m"),
        ("scale = 0.1", "scael = 0.1", "lever_m.scael"),
        ('role = "value"', 'role = "size"', "lever_m.role"),
        ("source =", "sources =", r"plume.toml, line \d+: sources: .*'source'"),
        ("source =", "source = 5 #", r"plume.toml, line \d+: source: .*a text"),
        ('targets = "thruster"', "targets = 5", r"plume.toml, line \d+: targets: .*got 5"),
        ('targets = "thruster"', 'targets = "axis"', "of these events.*'plume:z'"),
        ("lever_m]", "lever]", r"plume.py, line \d+: .*KeyError: 'lever_m'"),
        ('role = "value"', 'role = "departure"', r"line \d+: parameters.lever_m: .*a departure"),
        ("lever_m]", '"lever/m"]', r"line \d+: parameters.lever/m: .*letters"),
        ('unit = "m"', "unit = 5", r"line \d+: parameters.lever_m.unit: .*a text"),
    ],
)
def test_mistakes_in_its_table_are_one_line(tmp_path: Path, old: str, new: str, told: str) -> None:
    """What was silently never searched before is refused with the nearest known name."""
    with pytest.raises(InputError, match=told) as caught:
        weighed(copied(tmp_path, old, new, ".toml"))
    assert "\n" not in str(caught.value)


def test_a_file_named_from_its_folder_has_its_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A relative path names the same line; a fault of a module that it imports names its own."""
    copied(tmp_path, "k = setting.thruster", "k = 1 / 0")
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match=r"^plume.py, line \d+: .*ZeroDivisionError"):
        weighed(Path("plume.py"))
    (tmp_path / "helper_of_a_plume.py").write_text("a = (\n")
    monkeypatch.syspath_prepend(tmp_path)
    copied(tmp_path, "import numpy as np", "import numpy as np\nimport helper_of_a_plume")
    wanted = EXAMPLE.read_text().splitlines().index("import numpy as np") + 2
    with pytest.raises(InputError, match=rf"^plume.py, line {wanted}: .*SyntaxError"):
        weighed(Path("plume.py"))


@pytest.mark.parametrize("name", ["none", "plume-of-z3", "2plumes"])
def test_a_file_has_a_name_that_an_effect_can_have(tmp_path: Path, name: str) -> None:
    """No name that a diagnosis gives to something else, or that no variable can have."""
    shutil.copy(EXAMPLE, tmp_path / f"{name}.py")
    with pytest.raises(InputError, match="letters, digits and _"):
        read_kinds([tmp_path / f"{name}.py"])


def kind_of(path: Path) -> Kind:
    """The kind of a copy of the example."""
    return next(kind for kind, _ in read_kinds([path]).kinds if kind.name == "plume")


SEARCH = """
from types import SimpleNamespace

def settled(**given):
    usual = dict(prior_scales={{}}, said="", record={{}}, log_start_of=lambda samples: 0.0)
    return SimpleNamespace(**(usual | dict(log_gain=1.0, log_looks=0.0, columns=tuple) | given))

class Slotted(SimpleNamespace):
    @property
    def columns(self):
        return tuple

def search(remainder, priors):
    return {result}

"""


@pytest.mark.parametrize(
    ("result", "told"),
    [
        ("5", r"plume.py, line \d+: search: expected a result with log_gain, got 5"),
        ("1 / 0", r"plume.py, line \d+: .*ZeroDivisionError"),
        (
            "settled(log_gain='a', columns=None)",
            "search: log_gain: .*number",
        ),
        ("settled(columns=lambda s: s.x)", "AttributeError"),
        ("settled(columns=lambda s: [])", "a tuple, got list"),
        (
            "SimpleNamespace(log_gain=1.0, log_looks=0.0, columns=tuple)",
            "search: expected a result with prior_scales, .*inherit from SearchResult",
        ),
        ("settled(said=5)", "search: said: expected a str, got int"),
        ("settled(prior_scales=[1.0])", "search: prior_scales: expected a Mapping, got list"),
        ("settled(prior_scales={'a': 0.0})", r"prior_scales\['a'\]: expected a factor above 0"),
        ("settled(record={'a': {1j}})", "search: record: expected texts and plain numbers"),
        (
            "Slotted(**{k: v for k, v in vars(settled()).items() if k != 'columns'})",
            "search: expected an object whose functions can be replaced",
        ),
    ],
)
def test_what_a_search_settled_is_checked(tmp_path: Path, result: str, told: str) -> None:
    """Its figures at once, its columns when they are asked for."""
    path = copied(tmp_path, "KIND = Kind(", SEARCH.format(result=result) + "KIND = Kind(")
    path.write_text(path.read_text().replace("    change,\n", "    change,\n    search=search,\n"))
    kind = kind_of(path)
    assert kind.search is not None

    def searched() -> object:
        return kind.search(None, {}).columns(None)  # type: ignore[misc, arg-type, union-attr]

    with pytest.raises(InputError, match=told):
        searched()


@pytest.mark.parametrize(
    ("cost", "told"),
    [("samples.x", r"plume.py, line \d+: .*AttributeError"), ("'a'", "log_start_of: .*number")],
)
def test_what_a_search_costs_in_an_event_is_checked(tmp_path: Path, cost: str, told: str) -> None:
    """When it is asked for; one that is a number is that number (negative control)."""

    def cost_of(text: str) -> float:
        result = f"settled(log_start_of=lambda samples: {text})"
        path = copied(tmp_path, "KIND = Kind(", SEARCH.format(result=result) + "KIND = Kind(")
        text = path.read_text().replace("    change,\n", "    change,\n    search=search,\n")
        path.write_text(text)
        search = kind_of(path).search
        return search(None, {}).log_start_of(None)  # type: ignore[misc, arg-type, union-attr]

    assert cost_of("0.5") == 0.5
    with pytest.raises(InputError, match=told):
        cost_of(cost)


DRAWN = """
def drawn(setting, rng, n):
    return {result}

"""


@pytest.mark.parametrize(
    ("result", "told"),
    [
        ("5", r"plume.py, line \d+: drawn: expected a dict, got int"),
        ("1 / 0", r"plume.py, line \d+: .*ZeroDivisionError"),
        ("{'lever_m': rng.standard_normal(n + 1)}", r"drawn: lever_m: expected an array \(7,\)"),
        ("{'lever_m': rng.standard_normal(n) / 0}", "drawn: lever_m: expected finite values"),
        ("{'lever': rng.standard_normal(n)}", r"drawn: .*KIND.reported names, \['lever_m'\]"),
    ],
)
@pytest.mark.filterwarnings("ignore:divide by zero")
def test_draws_of_sizes_are_checked(tmp_path: Path, result: str, told: str) -> None:
    """Finite numbers for every draw, of sizes that there are; one number is that of all draws."""

    def draws(text: str) -> np.ndarray:
        path = copied(tmp_path, "KIND = Kind(", DRAWN.format(result=text) + "KIND = Kind(")
        own = "    change,\n    drawn=drawn,\n    reported=('lever_m',),\n"
        path.write_text(path.read_text().replace("    change,\n", own))
        drawn = kind_of(path).drawn
        return drawn(None, np.random.default_rng(1), 7)["lever_m"]  # type: ignore[misc, arg-type]

    assert draws("{'lever_m': 0.5}") == pytest.approx(np.full(7, 0.5))
    with pytest.raises(InputError, match=told):
        draws(result)


def test_a_draw_that_is_no_function_is_refused(tmp_path: Path) -> None:
    """When the file is read, as every other function of a kind is."""
    path = copied(tmp_path, "    change,\n", "    change,\n    drawn=3,\n")
    with pytest.raises(InputError, match=r"expected drawn\(setting, rng, n\), .*not a callable"):
        read_kinds([path])


def test_a_file_with_postponed_annotations_is_run(tmp_path: Path) -> None:
    """A dataclass in it looks its module up; one that fails leaves no module behind."""
    path = copied(
        tmp_path,
        "from dataclasses import replace",
        "from __future__ import annotations\nfrom dataclasses import dataclass, replace\n"
        "@dataclass\nclass Line:\n    frequency_hz: float\n",
    )
    assert kind_of(path).name == "plume"
    path.write_text(path.read_text().replace("class Line:", "class Line(Lin):"))
    with pytest.raises(InputError, match="NameError"):
        read_kinds([path])
    assert "effect_plume" not in sys.modules


def test_two_effects_have_columns_of_their_own(tmp_path: Path) -> None:
    """A column of a name that is taken would have stood in the other's place."""
    taken = read_kinds([]).columns(("z1",))[-1].name
    text = COLUMNS.replace("own:ramp", taken).format(values="context.time_s")
    path = copied(tmp_path, "KIND = Kind(", text + "KIND = Kind(")
    path.write_text(path.read_text().replace("    change,\n", "    change, columns=columns,\n"))
    with pytest.raises(InputError, match=r"effect plume: column .*a name of its own"):
        read_kinds([path]).columns(("z1",))
    path.write_text(path.read_text().replace(taken, "ramp@z9"))
    with pytest.raises(InputError, match="ramp@z9: expected a thruster behind @"):
        read_kinds([path]).columns(("z1",))


def test_a_table_has_to_be_there(tmp_path: Path) -> None:
    """A file without its table, and one that is neither Python nor TOML."""
    shutil.copy(EXAMPLE, tmp_path / "plume.py")
    with pytest.raises(InputError, match=r"plume\.toml"):
        read_kinds([tmp_path / "plume.py"])
    with pytest.raises(InputError, match=r"\.py or \.toml"):
        read_kinds([tmp_path / "plume.txt"])
    with pytest.raises(InputError, match="a Python file"):
        read_kinds([tmp_path / "plum.py"])


COLUMNS = """
from cassini_bayes.balance.statistics import ExtraColumn

def columns(thrusters):
    return (ExtraColumn("own:ramp", lambda context: {values}),)

"""


@pytest.mark.parametrize(
    ("values", "told"),
    [
        ("context.time_s[:3]", r"own:ramp: expected an array \(4,\)"),
        ("context.time / 2", "AttributeError"),
        ("context.time_s * float('nan')", "finite values"),
    ],
)
def test_columns_are_checked_when_they_are_computed(tmp_path: Path, values: str, told: str) -> None:
    """One finite number for every row."""
    from cassini_bayes.balance.statistics import RowContext

    path = copied(tmp_path, "KIND = Kind(", COLUMNS.format(values=values) + "KIND = Kind(")
    path.write_text(
        path.read_text().replace("    change,\n", "    change,\n    columns=columns,\n")
    )
    (column,) = (own for own in read_kinds([path]).columns(("z1",)) if own.name == "own:ramp")
    time, three, counts = np.arange(4.0), np.zeros((4, 3)), np.zeros((4, 1))
    context = RowContext(time, three, three, time, counts, counts)
    with pytest.raises(InputError, match=told):
        column.values(context)
    path.write_text(path.read_text().replace(values, "context.time_s / 2"))
    (column,) = (own for own in read_kinds([path]).columns(("z1",)) if own.name == "own:ramp")
    assert column.values(context) == pytest.approx(0.5 * np.arange(4.0))
