"""`report` as a command: what it says last, and how it ends."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import pytest
from run_cases import command


@pytest.mark.parametrize("converged", [True, False])
def test_a_page_made_again_repeats_what_its_run_said(
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    converged: bool,
) -> None:
    """Contradictions and a fit that has not converged, last, and the status as then."""
    stored = SimpleNamespace(review=SimpleNamespace(warnings=("cm_x_m: pulled",)))
    page = tmp_path / "report.html"
    monkeypatch.setattr("cassini_bayes.pipeline.fits.read_fit", lambda *_, **__: stored)
    monkeypatch.setattr("cassini_bayes.pipeline.fits.report", lambda *_, **__: page)
    monkeypatch.setattr("cassini_bayes.results.review.is_converged", lambda _: converged)
    assert command(["report", str(tmp_path), "--quiet"]) == (0 if converged else 1)
    shown = capsys.readouterr()
    assert shown.out == f"{page}\n"
    *before, last = shown.err.splitlines()
    assert last == "warning: cm_x_m: pulled"
    wanted = [] if converged else ["not converged"]
    assert [line.partition(":")[0] for line in before] == wanted
