"""Every notebook runs from top to bottom; what is stored with it is what it gives."""

from __future__ import annotations

import re
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient
from totals_cases import ROOT

FIRST = "from_your_csv"
"""The only one of telemetry, whose calculations are compiled in a new clone: for half a minute, in
which another worker should not have to compile the same."""
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"), key=lambda path: path.stem != FIRST)
EXECUTED = ("diagnosis",)  # findings to be read without running them
# What a test puts in place of a notebook's parameters: every cell runs, on less.
SHORT = {
    "flight_biases": """number = 2
sampler = {"seed": 1, "ensembles": 2, "first_check": 100, "max_steps": 100, "target_ess": 100}""",
    "from_your_csv": """seed = 1
settings = {
    "sampler": {
        "ensembles": 2, "walkers": 64, "first_check": 100, "max_steps": 100, "target_ess": 100,
    },
    "draws_per_ensemble": 200,
    "prior_draws": 200,
}
gain = False""",
}
# Run before a notebook that stores no findings: garbage is collected as rarely as by the command
# line, fewer draws are made and kept, and a few of the causes weighed. That all of them are weighed
# on the same recording, and the right one is named, is what the tutorial shows.
LESS = """
import gc
from dataclasses import replace

from cassini_bayes.diagnosis import read
from cassini_bayes.pipeline.fits import fit
from cassini_bayes.sampling.warmstart import warm_start

gc.set_threshold(100_000)
warm_start.__kwdefaults__["draws"] = 1_000
fit.__kwdefaults__ |= {"draws_per_ensemble": 500, "prior_draws": 500}

def few(*arguments, prepare=read.prepare):
    events = prepare(*arguments)
    effects = tuple(e for e in events.catalogue.effects if e.name.startswith("thruster_degraded"))
    assert effects
    return replace(events, catalogue=replace(events.catalogue, effects=effects))

read.prepare = few
"""
NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e-?\d+)?")


def texts(notebook: nbformat.NotebookNode) -> list[str]:
    """What the code cells print and show as text."""
    outputs = [o for cell in notebook.cells if cell.cell_type == "code" for o in cell.outputs]
    shown = [
        own.text if own.output_type == "stream" else own.data.get("text/markdown", "")
        for own in outputs
    ]
    return [text for text in shown if text]


def same_text(one: str, other: str) -> bool:
    """Equal words, and numbers within 5 % or 0.05."""
    if NUMBER.sub("#", one) != NUMBER.sub("#", other):
        return False
    pairs = zip(map(float, NUMBER.findall(one)), map(float, NUMBER.findall(other)), strict=True)
    return all(abs(a - b) <= max(0.05, 0.05 * abs(b)) for a, b in pairs)


def shortened(notebook: nbformat.NotebookNode, parameters: str) -> None:
    """Put other parameters in place of the notebook's own, which have to have the same names."""
    cells = [cell for cell in notebook.cells if "parameters" in cell.metadata.get("tags", ())]
    assert len(cells) == 1
    names = [re.findall(r"^(\w+) =", text, re.MULTILINE) for text in (cells[0].source, parameters)]
    assert names[0] == names[1]
    cells[0].source = parameters


def test_there_are_notebooks() -> None:
    """The folder is where the next test looks."""
    assert {path.stem for path in NOTEBOOKS} > set(EXECUTED)


def test_changed_findings_are_seen() -> None:
    """Another word or another number is not the same text."""
    assert same_text("`none` (0.67) of 48", "`none` (0.68) of 48")
    assert not same_text("`none` (0.67) of 48", "`unknown` (0.67) of 48")
    assert not same_text("`none` (0.67) of 48", "`none` (0.67) of 40")


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_is_stored_clean_or_as_executed(path: Path) -> None:
    """Findings are stored with their figures; elsewhere outputs would go stale."""
    cells = [c for c in nbformat.read(path, as_version=4).cells if c.cell_type == "code"]
    if path.stem in EXECUTED:
        assert [cell.execution_count for cell in cells] == list(range(1, len(cells) + 1))
        figures = [o for c in cells for o in c.outputs if "image/png" in o.get("data", {})]
        assert len(figures) == 5  # of cases (a) to (e)
        return
    assert not any(cell.outputs for cell in cells)
    assert all(cell.execution_count is None for cell in cells)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_runs(path: Path) -> None:
    """All cells execute in a fresh kernel without error, to what is stored with them."""
    notebook = nbformat.read(path, as_version=4)
    stored = texts(notebook)
    if path.stem in SHORT:
        shortened(notebook, SHORT[path.stem])
        notebook.cells.insert(0, nbformat.v4.new_code_cell(LESS))
    NotebookClient(notebook, timeout=300, resources={"metadata": {"path": str(ROOT)}}).execute()
    assert all(cell.execution_count for cell in notebook.cells if cell.cell_type == "code")
    if path.stem in EXECUTED:
        found = texts(notebook)
        assert len(found) == len(stored)
        for own, before in zip(found, stored, strict=True):
            assert same_text(own, before), own
