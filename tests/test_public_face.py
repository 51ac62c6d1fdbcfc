"""The public face: its names, what it loads, and the examples of its page, run in order."""

from __future__ import annotations

import inspect
import re
import subprocess
import sys
import warnings
from pathlib import Path

import pytest
from totals_cases import ROOT

import cassini_bayes as cb

pytestmark = pytest.mark.usefixtures("short_warm_start")
PAGE = ROOT / "docs" / "reference" / "api.md"
VERBS = (
    *("read_priors", "read_totals", "read_fit", "build_model", "check", "fit", "report"),
    *("diagnose", "predict", "plan", "sweep", "trend", "simulate"),
    *("causes", "parameters", "quantities"),
)
OLDER = ("fit_model", "summarise", "convergence_table", "error_budget", "save_fit", "figures_of")
BLOCK = re.compile(r"^```python\n(.*?)^```", re.MULTILINE | re.DOTALL)


def examples() -> list[str]:
    """The Python blocks of the page."""
    return BLOCK.findall(PAGE.read_text("utf-8"))


@pytest.mark.parametrize("name", [*VERBS, *OLDER])
def test_a_name_is_there(name: str) -> None:
    """Verbs, and names of earlier versions, are in ``dir`` and have a docstring."""
    assert name in dir(cb)
    own = getattr(cb, name)
    assert callable(own)
    assert inspect.getdoc(own)
    assert inspect.signature(own).parameters


def test_another_name_is_refused() -> None:
    """Negative control: not everything is there."""
    assert "measure" not in dir(cb)
    with pytest.raises(AttributeError, match="measure"):
        cb.measure  # noqa: B018


def test_parts_of_the_package_hide_no_verb() -> None:
    """``report`` and ``sweep`` are parts of the package, too: whichever comes first, both work."""
    program = (
        "import cassini_bayes as cb, inspect\n"
        "first = inspect.signature(cb.report)\n"
        "from cassini_bayes.report import sections_of\n"
        "import cassini_bayes.sweep.weights as weights\n"
        "assert inspect.signature(cb.report) == first and cb.report.sections_of is sections_of\n"
        "assert callable(cb.sweep) and cb.sweep.weights is weights\n"
    )
    subprocess.run([sys.executable, "-c", program], check=True, timeout=60)


def test_every_verb_has_an_example() -> None:
    """The page uses each verb in a block that runs, or in one line of text."""
    text = PAGE.read_text("utf-8")
    assert [name for name in VERBS if f"cb.{name}(" not in text] == []


def run_all(blocks: list[str], space: dict[str, object]) -> None:
    """Every block, in one namespace."""
    for block in blocks:
        exec(block, space)  # noqa: S102


def test_the_examples_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """All blocks of the page, from top to bottom, in a folder that has the shipped files."""
    import matplotlib.pyplot as plt

    for name in ("priors", "cassini_bayes", "runs"):
        (tmp_path / name).symlink_to(ROOT / name)
    (tmp_path / "work").mkdir()
    monkeypatch.chdir(tmp_path)
    space: dict[str, object] = {}
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Estimated shape parameter of Pareto")  # of two events
        run_all(examples(), space)
    plt.close("all")
    fit, again = space["fit"], space["again"]
    assert fit.events == again.events
    assert (fit.posterior["tau_fall_s"].values == again.posterior["tau_fall_s"].values).all()
