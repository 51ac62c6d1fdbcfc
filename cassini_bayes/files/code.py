"""What code a result depends on: a digest of a module and of all that it imports.

Finished repetitions of a campaign, cached reductions and checkpoints are worth keeping only as long
as the code that made them is the same. Which code that is follows from the imports, so no list of
modules can go out of date.
"""

from __future__ import annotations

import ast
import hashlib
import json
import re
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import Final

from cassini_bayes.files.storage import digest

PACKAGE: Final = "cassini_bayes"
ROOT: Final = Path(__file__).parents[1]
DATA: Final = ("*.toml", "*.csv")  # read by the modules beside them
_IMPORT: Final = re.compile(
    rb"^[ \t]*((?:from|import)[ \t]+cassini_bayes\b[^\n(]*(?:\([^)]*\))?)", re.MULTILINE
)
"""An import of the package: to parse whole modules takes every command most of a second."""


def code_digest(*modules: str) -> str:
    """SHA-256 over the sources of modules and of everything of this package that they import.

    Imports inside functions count; the package's face, which shows a bit of everything, does not.
    Tables that lie beside a module belong to it.

    Parameters
    ----------
    modules
        Dotted names below the package, ``results.fitting``.
    """
    total = hashlib.sha256()
    for path in sorted({path for name in sorted(reached(*modules)) for path in _files(name)}):
        total.update(path.relative_to(ROOT).as_posix().encode())
        total.update(path.read_bytes())
    return total.hexdigest()


def identity(settings: object, inputs: Sequence[str | Path], *modules: str) -> str:
    """Hash of all that a result depends on: settings (plain JSON types), input files, code."""
    depends_on = [settings, [digest(Path(path)) for path in inputs], code_digest(*modules)]
    return hashlib.sha256(json.dumps(depends_on).encode()).hexdigest()


def reached(*modules: str) -> frozenset[str]:
    """Names of some modules and of all modules of the package that they import, at any remove."""
    result: set[str] = set()
    waiting = list(modules)
    while waiting:
        name = waiting.pop()
        if name and name not in result:
            result.add(name)
            waiting += [*imports(name), name.rpartition(".")[0]]
    return frozenset(result)


@cache
def imports(module: str) -> frozenset[str]:
    """Modules of the package that one of them imports, anywhere in its source."""
    statements = ast.parse(b"\n".join(_IMPORT.findall(_source(module).read_bytes()))).body
    return frozenset(name for node in statements for name in _named(node) if name)


def _named(node: ast.stmt) -> Iterator[str]:
    """Modules that an import statement names; ``from a import b``: b may be a module."""
    if isinstance(node, ast.Import):
        full = [alias.name for alias in node.names]
    elif isinstance(node, ast.ImportFrom) and node.module is not None:
        full = [f"{node.module}.{alias.name}" for alias in node.names]
    else:
        return
    for name in full:
        below = name.removeprefix(f"{PACKAGE}.")
        if below != name:
            yield below if _is_module(below) else below.rpartition(".")[0]


def _is_module(name: str) -> bool:
    place = ROOT.joinpath(*name.split("."))
    return place.with_suffix(".py").is_file() or (place / "__init__.py").is_file()


def _source(name: str) -> Path:
    place = ROOT.joinpath(*name.split("."))
    return place / "__init__.py" if place.is_dir() else place.with_suffix(".py")


def _files(name: str) -> Iterator[Path]:
    source = _source(name)
    yield source
    for pattern in DATA:
        yield from source.parent.glob(pattern)
