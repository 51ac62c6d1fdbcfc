"""The list of slow tests is true: every entry is there, and every package keeps quick tests."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest
from conftest import slow_tests

TESTS = Path(__file__).parent


def functions(path: Path) -> set[str]:
    """Names of the tests and fixtures of a file, as the list has them."""
    tree = ast.parse(path.read_text("utf-8"))
    names = [node.name for node in tree.body if isinstance(node, ast.FunctionDef)]
    where = path.relative_to(TESTS.parent).as_posix()
    return {f"{where}::{name}" for name in names}


EVERY = {path: functions(path) for path in sorted(TESTS.rglob("test_*.py"))}


def test_every_slow_test_is_there() -> None:
    """A renamed or removed test or fixture leaves the list."""
    assert set(slow_tests()) <= set().union(*EVERY.values())


@pytest.mark.parametrize("package", sorted({path.parent.name for path in EVERY}))
def test_every_package_has_quick_tests(package: str) -> None:
    """``-m quick`` says something about each of them."""
    own = set().union(*(names for path, names in EVERY.items() if path.parent.name == package))
    assert any("::test_" in name for name in own - set(slow_tests()))
