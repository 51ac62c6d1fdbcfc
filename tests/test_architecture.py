"""The shape of the package: which way imports go, and what no module may contain.

The rules are the tables below. Each is a plain function from a parsed module to the offences in it,
so that a made-up offender can prove that the rule bites.
"""

from __future__ import annotations

import ast
import graphlib
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Final

import pytest

import cassini_bayes

PACKAGE: Final = "cassini_bayes"
ROOT: Final = Path(cassini_bayes.__file__).parent

# From the bottom up. A package may import from lines above its own in this table, never from its
# own line or from one below; modules inside one package may import each other, without cycles. A
# name that is missing here is an error.
LAYERS: Final[tuple[tuple[str, ...], ...]] = (
    ("errors",),
    ("computing",),
    ("files",),
    ("spacecraft", "published"),
    ("priors",),
    ("events", "simulation"),
    ("balance",),
    ("effects",),
    ("model", "sampling"),
    ("results",),
    ("prediction", "sweep"),
    ("diagnosis",),
    ("report",),
    ("studies", "pipeline"),
    ("cli",),
)

# Packages that know less than their line would let them: the simulation is what inference is tested
# against, so it shares the physics, the way to compile, and nothing else.
MAY_ONLY_IMPORT: Final[Mapping[str, frozenset[str]]] = {
    "simulation": frozenset({"errors", "computing", "files", "spacecraft"}),
}

# And who may know of it: those that put inference to the test, from this line on.
ONLY_FROM: Final[Mapping[str, str]] = {"simulation": "report"}

# Libraries with one door into the package.
ONLY_IN: Final[Mapping[str, frozenset[str]]] = {
    "emcee": frozenset({"sampling"}),
    "matplotlib": frozenset({"report"}),
    "corner": frozenset({"report"}),
    "jinja2": frozenset({"report"}),
    "typer": frozenset({"cli"}),
    "rich": frozenset({"cli"}),
    "tomllib": frozenset({"files"}),
    "zipfile": frozenset({"files"}),
    "h5netcdf": frozenset(),
    "h5py": frozenset({"files"}),
}

# Ways to read a file that only `files` may take: there sizes are looked at first. Telemetry, which
# may have any length, is streamed by a reader of its own.
READING_CALLS: Final = frozenset({"np.load", "xr.open_dataset", "csv.reader", "csv.DictReader"})
READING_IN: Final = frozenset({"files", "events.telemetry.csv_file"})

# Not anywhere: code hidden in data, other machines, a random stream that is nobody's argument.
FORBIDDEN_IMPORTS: Final = frozenset(
    {"pickle", "cloudpickle", "dill", "marshal", "shelve", "joblib", "yaml"}
    | {"socket", "urllib", "http", "requests", "httpx", "ftplib"}
    | {"random"}
)
FORBIDDEN_CALLS: Final = frozenset({"eval", "exec", "compile", "__import__"})

# emcee 3.1.6: the snooker move samples another distribution, the Gaussian move with a covariance
# gives every walker the same step.
FORBIDDEN_NAMES: Final = frozenset({"DESnookerMove", "GaussianMove"})

PRINTING: Final = frozenset({"cli"})
LEGACY_RANDOM_IN: Final = frozenset({"sampling"})  # emcee takes nothing newer
MODERN_RANDOM: Final = frozenset(
    {"Generator", "SeedSequence", "BitGenerator", "default_rng", "PCG64", "PCG64DXSM", "Philox"}
)

# Heavy or fussy imports (arviz takes two seconds and writes into the user's cache folder).
NOT_ON_IMPORT: Final = (
    *("arviz", "matplotlib", "corner", "emcee", "numba", "jinja2"),
    *("numpy", "scipy", "pandas", "xarray", "pydantic", "h5py", "distributed"),
)
# What the package's own start loads: Python's library and little else.
MOST_MODULES: Final = {"import cassini_bayes": 80, "from cassini_bayes.cli import app": 300}


@dataclass(frozen=True)
class Module:
    """One source file: its dotted name below the package ("" for the package itself) and tree."""

    name: str
    tree: ast.Module
    is_package: bool = False

    @property
    def top(self) -> str:
        """The module or package that the tables name."""
        return self.name.split(".", 1)[0]


def parse(name: str, source: str) -> Module:
    """Return a module made of a source text."""
    return Module(name, ast.parse(source))


@cache
def package_modules() -> tuple[Module, ...]:
    """Every source file of the package, parsed once by the first test that asks."""
    modules = []
    for path in sorted(ROOT.rglob("*.py")):
        parts = path.relative_to(ROOT).with_suffix("").parts
        is_package = parts[-1] == "__init__"
        name = ".".join(parts[:-1] if is_package else parts)
        modules.append(Module(name, ast.parse(path.read_text("utf-8")), is_package))
    return tuple(modules)


def imported(module: Module) -> Iterator[tuple[str, int]]:
    """Dotted names that a module imports, anywhere in it, with their lines.

    ``from a import b`` gives ``a.b``: b may be a module.
    """
    for node in ast.walk(module.tree):
        if isinstance(node, ast.Import):
            yield from ((alias.name, node.lineno) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                package = [PACKAGE, *module.name.split(".")] if module.name else [PACKAGE]
                kept = len(package) - node.level + module.is_package
                base = ".".join([*package[:kept], *([base] if base else [])])
            yield from ((f"{base}.{alias.name}", node.lineno) for alias in node.names)


def own_imports(module: Module) -> Iterator[tuple[str, int]]:
    """Names below the package that a module imports; the package's own version is not one."""
    for name, line in imported(module):
        below = name.removeprefix(f"{PACKAGE}.") if name.startswith(f"{PACKAGE}.") else None
        if below is not None and below != "__version__":
            yield below, line


def rank(name: str) -> int | None:
    """Line of a module in the table of layers."""
    return next((line for line, names in enumerate(LAYERS) if name in names), None)


def wrong_way(module: Module) -> Iterator[str]:
    """Imports that go up or sideways, and names that the table does not know."""
    if module.name in ("", "__main__"):
        return  # the package's face and its start may use any part of it
    own = rank(module.top)
    if own is None:
        yield f"{module.name}: not in the table of layers"
        return
    for name, line in own_imports(module):
        top = name.split(".", 1)[0]
        if top == module.top:
            continue
        other = rank(top)
        if other is None:
            yield f"{module.name}:{line}: imports {top}, which is not in the table of layers"
        elif other >= own:
            yield f"{module.name}:{line}: imports {top}, which is not below it"
        elif top not in MAY_ONLY_IMPORT.get(module.top, frozenset({top})):
            yield f"{module.name}:{line}: {module.top} may not know {top}"
        elif top in ONLY_FROM and own < (rank(ONLY_FROM[top]) or 0):
            yield f"{module.name}:{line}: nothing below {ONLY_FROM[top]} may know {top}"


def wrong_libraries(module: Module) -> Iterator[str]:
    """Libraries imported where they have no business."""
    for name, line in imported(module):
        library = name.split(".", 1)[0]
        if library in FORBIDDEN_IMPORTS:
            yield f"{module.name}:{line}: imports {library}"
        elif library in ONLY_IN and module.top not in ONLY_IN[library]:
            yield f"{module.name}:{line}: imports {library}; only {sorted(ONLY_IN[library])} may"


def wrong_calls(module: Module) -> Iterator[str]:
    """Code from text, pickled arrays, printing, and errors swallowed unseen."""
    for node in ast.walk(module.tree):
        if isinstance(node, ast.ExceptHandler) and node.type is None:
            yield f"{module.name}:{node.lineno}: catches everything"
        if not isinstance(node, ast.Call):
            continue
        called = node.func.id if isinstance(node.func, ast.Name) else ""
        if called in FORBIDDEN_CALLS:
            yield f"{module.name}:{node.lineno}: calls {called}"
        if called == "print" and module.top not in PRINTING:
            yield f"{module.name}:{node.lineno}: prints"
        for keyword in node.keywords:
            off = isinstance(keyword.value, ast.Constant) and keyword.value.value is False
            if keyword.arg == "allow_pickle" and not off:
                yield f"{module.name}:{node.lineno}: allows pickled arrays"


def wrong_doors(module: Module) -> Iterator[str]:
    """Files read beside the doors."""
    if READING_IN & {module.top, module.name}:
        return
    for node in ast.walk(module.tree):
        if isinstance(node, ast.Call) and ast.unparse(node.func) in READING_CALLS:
            yield f"{module.name}:{node.lineno}: calls {ast.unparse(node.func)}"


def wrong_names(module: Module) -> Iterator[str]:
    """Legacy random numbers, and library pieces known to be wrong."""
    for node in ast.walk(module.tree):
        name = node.attr if isinstance(node, ast.Attribute) else getattr(node, "id", None)
        if name in FORBIDDEN_NAMES:
            yield f"{module.name}:{node.lineno}: uses {name}"
        if (
            isinstance(node, ast.Attribute)
            and ast.unparse(node.value) in ("np.random", "numpy.random")
            and node.attr not in MODERN_RANDOM
            and module.top not in LEGACY_RANDOM_IN
        ):
            yield f"{module.name}:{node.lineno}: uses np.random.{node.attr}"
    for name, line in imported(module):
        if name.rsplit(".", 1)[-1] in FORBIDDEN_NAMES:
            yield f"{module.name}:{line}: imports {name}"
        numpy_random = name.startswith("numpy.random.")
        if numpy_random and name.rsplit(".", 1)[-1] not in MODERN_RANDOM:
            yield f"{module.name}:{line}: imports {name}"


def undocumented(module: Module) -> Iterator[str]:
    """Public modules, classes, functions and methods without a docstring.

    Classes that share an interface document its methods once: a method is documented if a class of
    the same module documents one of that name.
    """
    if ast.get_docstring(module.tree) is None:
        yield f"{module.name or PACKAGE}: no docstring"
    classes = [node for node in module.tree.body if isinstance(node, ast.ClassDef)]
    methods = [(owner, method) for owner in classes for method in public_functions(owner.body)]
    explained = {method.name for _, method in methods if ast.get_docstring(method)}
    for node in (*classes, *public_functions(module.tree.body)):
        if not node.name.startswith("_") and ast.get_docstring(node) is None:
            yield f"{module.name}:{node.lineno}: {node.name} has no docstring"
    for owner, method in methods:
        if not owner.name.startswith("_") and method.name not in explained:
            yield f"{module.name}:{method.lineno}: {owner.name}.{method.name} has no docstring"


def public_functions(body: list[ast.stmt]) -> list[ast.FunctionDef]:
    """Return the functions of a module's or class's body whose names are public."""
    return [
        node for node in body if isinstance(node, ast.FunctionDef) and not node.name.startswith("_")
    ]


def wrong_cycles(modules: tuple[Module, ...]) -> list[str]:
    """Return one cycle of imports, if there is any."""
    names = {module.name for module in modules}
    graph: dict[str, set[str]] = {}
    for module in modules:
        if not module.name:
            continue
        targets = set()
        for name, _ in own_imports(module):
            # `from a import b`: the module a.b if there is one, otherwise something in a
            found = name if name in names else name.rpartition(".")[0]
            if found in names and found not in ("", module.name):
                targets.add(found)
        graph[module.name] = targets
    try:
        graphlib.TopologicalSorter(graph).prepare()
    except graphlib.CycleError as error:
        return list(error.args[1])
    return []


Rule = Callable[[Module], Iterator[str]]
RULES: Final[tuple[Rule, ...]] = (
    wrong_way,
    wrong_libraries,
    wrong_calls,
    wrong_doors,
    wrong_names,
    undocumented,
)


@pytest.mark.parametrize("rule", RULES, ids=lambda rule: rule.__name__)
def test_the_package_keeps_the_rule(rule: Rule) -> None:
    """No module of the package breaks the rule."""
    offences = [offence for module in package_modules() for offence in rule(module)]
    assert not offences, "\n".join(offences)


def test_imports_have_no_cycles() -> None:
    """Inside packages, too, no module imports itself by a detour."""
    assert wrong_cycles(package_modules()) == []


def test_the_table_names_each_module_once() -> None:
    """A module has one place in the order."""
    names = [name for line in LAYERS for name in line]
    assert len(names) == len(set(names))


def test_all_of_the_package_was_read() -> None:
    """The rules look at the real files: the errors module and the package's face are among them."""
    assert {"", "errors"} <= {module.name for module in package_modules()}
    assert len(package_modules()) >= len([path for path in ROOT.iterdir() if path.suffix == ".py"])


OFFENDERS: Final = (
    (wrong_way, "errors", "from cassini_bayes.model import build_model"),
    (
        wrong_way,
        "balance.terms",
        "def f():\n    from cassini_bayes.model.posterior import collapse",
    ),
    (wrong_way, "balance.terms", "import cassini_bayes.model.posterior as p"),
    (wrong_way, "balance.terms", "from cassini_bayes import model"),
    (wrong_way, "errors", "from . import model"),
    (wrong_way, "spacecraft.frames", "from ..model.posterior import collapse"),
    (wrong_way, "published.tables", "from cassini_bayes.spacecraft import Spacecraft"),
    (wrong_way, "utils", "import math"),
    (wrong_way, "model.build", "from cassini_bayes.utils import helper"),
    (wrong_way, "simulation.loop", "from cassini_bayes.priors import Priors"),
    (wrong_way, "model.build", "from cassini_bayes.simulation import simulate"),
    (wrong_libraries, "model.build", "import emcee"),
    (wrong_libraries, "pipeline.run", "from matplotlib import pyplot"),
    (wrong_libraries, "diagnosis.show", "import jinja2"),
    (wrong_libraries, "files.storage", "import pickle"),
    (wrong_libraries, "published", "from urllib.request import urlopen"),
    (wrong_libraries, "simulation.noise", "import random"),
    (wrong_calls, "priors.reader", "ev" + "al('1 + 1')"),
    (wrong_calls, "model.build", "print('here')"),
    (wrong_calls, "files.checkpoint", "np.load(path, allow_pickle=True)"),
    (wrong_calls, "pipeline.run", "try:\n    f()\nexcept" + ":\n    pass"),
    (wrong_libraries, "priors.reader", "import tomllib"),
    (wrong_doors, "model.cache", "np.load(path, allow_pickle=False)"),
    (wrong_doors, "events.totals", "import csv\nrows = csv.reader(stream)"),
    (wrong_names, "model.build", "np.random.normal(0, 1)"),
    (wrong_names, "model.build", "from numpy.random import RandomState"),
    (wrong_names, "sampling.ensembles", "move = emcee.moves.DESnookerMove"),
    (wrong_names, "sampling.ensembles", "from emcee.moves import DESnookerMove"),
    (undocumented, "model.build", "x = 1"),
    (undocumented, "model.build", "'''Text.'''\ndef public():\n    pass"),
    (undocumented, "model.build", "'''Text.'''\nclass A:\n    '''Text.'''\n    def f(self): ..."),
)

INNOCENTS: Final = (
    (wrong_way, "model.build", "from cassini_bayes.balance.terms import wheel_momentum"),
    (wrong_way, "spacecraft.frames", "from cassini_bayes.spacecraft.wheels import axes"),
    (wrong_way, "spacecraft.frames", "from .wheels import axes"),
    (wrong_way, "studies.blind", "from cassini_bayes.simulation.loop import simulate"),
    (wrong_way, "pipeline.run", "from cassini_bayes import __version__"),
    (wrong_libraries, "sampling.ensembles", "import emcee"),
    (wrong_calls, "cli", "print('done')"),
    (wrong_calls, "files.checkpoint", "np.load(path, allow_pickle=False)"),
    (wrong_doors, "files.cells", "rows = csv.reader(stream)"),
    (wrong_doors, "model.cache", "np.savez(path, x=x)"),
    (wrong_names, "sampling.ensembles", "np.random.RandomState(np.random.MT19937(seed))"),
    (wrong_names, "model.build", "rng: np.random.Generator = np.random.default_rng(1)"),
    (undocumented, "model.build", "'''Text.'''\ndef _private():\n    pass"),
    (
        undocumented,
        "model.build",
        "'''T.'''\nclass P:\n    '''T.'''\n    def f(self): '''T.'''\n"
        "class A:\n    '''T.'''\n    def f(self): ...",
    ),
)


@pytest.mark.parametrize(("rule", "name", "source"), OFFENDERS)
def test_an_offender_is_caught(rule: Rule, name: str, source: str) -> None:
    """Negative control: made-up modules that break a rule are flagged by it."""
    assert len(list(rule(parse(name, source)))) >= 1


@pytest.mark.parametrize(("rule", "name", "source"), INNOCENTS)
def test_the_innocent_are_left_alone(rule: Rule, name: str, source: str) -> None:
    """What the rules allow is not flagged."""
    assert list(rule(parse(name, source))) == []


def test_a_cycle_is_caught() -> None:
    """Negative control: three modules of one package that import each other in a ring."""
    ring = (
        parse("spacecraft.a", "from cassini_bayes.spacecraft.b import f"),
        parse("spacecraft.b", "from cassini_bayes.spacecraft import c"),
        parse("spacecraft.c", "import cassini_bayes.spacecraft.a"),
    )
    assert set(wrong_cycles(ring)) == {"spacecraft.a", "spacecraft.b", "spacecraft.c"}
    assert wrong_cycles(ring[:2]) == []


def loaded_by(statement: str) -> set[str]:
    """Modules that a fresh interpreter has loaded after one statement."""
    program = f"{statement}; import sys; print(*sys.modules)"
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True, timeout=60
    )
    return set(done.stdout.split())


@pytest.mark.parametrize("statement", MOST_MODULES)
def test_the_start_loads_no_heavy_library(statement: str) -> None:
    """Neither `import cassini_bayes` nor the command line's help loads what only a command needs;
    the control shows that a loaded library would be seen.
    """
    loaded = loaded_by(statement)
    assert not loaded & set(NOT_ON_IMPORT)
    assert len(loaded) < MOST_MODULES[statement]
    assert "jinja2" in loaded_by(f"{statement}; import jinja2")
