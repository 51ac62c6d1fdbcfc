"""Digests of code follow the imports: what a result depends on, no more and no less."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

from cassini_bayes.files import code


def test_a_likelihood_is_reached_with_its_compiled_part() -> None:
    """Repetitions of telemetry depend on kernel, terms and parameters; not on pages and figures."""
    reached = code.reached("studies.telemetry_calibration")
    assert {"balance.kernel", "balance.telemetry_balance", "spacecraft.parameters"} <= reached
    assert {"simulation.kernel", "priors.quantiles", "sampling.warmstart"} <= reached
    assert not any(name.split(".")[0] in ("report", "cli") for name in reached)


def test_imports_inside_functions_count() -> None:
    """The command line loads what it needs when a command is called."""
    assert "results.fitting" in code.reached("cli")


def test_no_import_is_missed() -> None:
    """Names are those of a module's whole syntax tree, wherever a statement stands."""
    folders = ("balance", "cli", "pipeline")  # the latter import much inside functions
    for path in [path for folder in folders for path in (code.ROOT / folder).rglob("*.py")]:
        tree = ast.walk(ast.parse(path.read_bytes()))
        named = {
            f"{node.module}.{alias.name}".removeprefix("cassini_bayes.")
            for node in tree
            if isinstance(node, ast.ImportFrom) and str(node.module).startswith("cassini_bayes.")
            for alias in node.names
        }
        module = ".".join(path.relative_to(code.ROOT).with_suffix("").parts)
        found = code.imports(module.removesuffix(".__init__"))
        assert all(name in found or name.rpartition(".")[0] in found for name in named), module
        assert all(
            any(name == one or name.startswith(f"{one}.") for name in named) for one in found
        ), module


def test_a_changed_module_changes_the_digest(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One byte in a module that is imported, or in a table beside it, gives another digest."""
    (tmp_path / "a.py").write_text("from cassini_bayes.b.c import f\n")
    (tmp_path / "b").mkdir()
    (tmp_path / "b" / "__init__.py").write_text("")
    (tmp_path / "b" / "c.py").write_text("def f(): ...\n")
    (tmp_path / "b" / "table.toml").write_text("x = 1\n")
    (tmp_path / "d.py").write_text("nobody imports this\n")
    monkeypatch.setattr(code, "ROOT", tmp_path)
    code.imports.cache_clear()
    seen = [code.code_digest("a")]
    for path, text in (
        ("d.py", "still nobody\n"),
        ("b/c.py", "def f(): pass\n"),
        ("b/table.toml", "x = 2\n"),
        ("b/__init__.py", "'''B.'''\n"),
    ):
        (tmp_path / path).write_text(text)
        code.imports.cache_clear()
        seen.append(code.code_digest("a"))
    code.imports.cache_clear()
    assert seen[0] == seen[1]
    assert len(set(seen)) == 4


def test_a_missing_module_is_an_error() -> None:
    """A name that is no module is not digested as nothing."""
    with pytest.raises(OSError, match="nowhere"):
        code.code_digest("nowhere")
