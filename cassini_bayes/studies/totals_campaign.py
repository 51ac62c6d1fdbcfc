"""The calibration of the totals model: it and two negative controls, one verdict, one page."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd

from cassini_bayes.report.plots.calibration import coverage_figure
from cassini_bayes.report.study_page import markdown_table
from cassini_bayes.results.ranks import Ranks, ranks_of
from cassini_bayes.studies.study import Study
from cassini_bayes.studies.totals_calibration import (
    CONTROLS,
    MODULE,
    Campaign,
    Control,
    Verdict,
    judge,
)

FULL: Final[Mapping[str, int]] = {c: 2_000 if c == "none" else 200 for c in CONTROLS}
QUICK: Final[Mapping[str, int]] = {c: 200 if c == "none" else 60 for c in CONTROLS}
"""Repetitions of the model and of each control."""
HEADER: Final = (
    *("fit", "repetitions", "coverage, lowest … highest", "parameters outside"),
    *("tolerance", "smallest rank-uniformity p (Holm)", "verdict"),
)
LABELS: Final[Mapping[Control, str]] = {
    "none": "the model",
    "hold-rates-ignored": "control: hold rates ignored",
    "rectangular-pulses": "control: pulses taken as rectangular",
}


def calibrate_totals(study: Study, events: Path, priors: Path, numbers: Mapping[str, int]) -> bool:
    """Run the totals calibration with both negative controls and write its results.

    ``numbers`` are repetitions as in :data:`FULL`. Returns whether the model passes and both
    controls fail.
    """
    collected: dict[Control, Ranks] = {}
    for control in CONTROLS:
        campaign = Campaign(events, priors, control, seed=study.seed)
        result = study.repeat(control, LABELS[control], campaign, numbers[control])
        collected[control] = ranks_of(campaign.names(), result)
    verdicts = {control: judge(ranks) for control, ranks in collected.items()}
    figure = coverage_figure(
        {LABELS[control]: ranks for control, ranks in collected.items()},
        {LABELS[control]: verdict.tolerance for control, verdict in verdicts.items()},
    )
    coverage = pd.DataFrame(
        {"parameter": collected["none"].names}
        | {
            # a parameter that the control fixes has no coverage
            control: np.where(np.isfinite(ranks.ranks).all(0), ranks.coverage().round(4), np.nan)
            for control, ranks in collected.items()
        }
    )
    title, body = "Calibration of the totals model", _body(study.page.stem, collected, verdicts)
    study.publish(title, body, MODULE, {"": coverage}, {"": figure})
    return verdicts["none"].passed and not any(
        verdicts[control].passed for control in CONTROLS if control != "none"
    )


def _body(
    stem: str, collected: Mapping[Control, Ranks], verdicts: Mapping[Control, Verdict]
) -> str:
    rows = []
    for control, ranks in collected.items():
        verdict = verdicts[control]
        failing = f"{len(verdict.failing)} of {len(ranks.of_fitted().names)}"
        coverage = f"{verdict.lowest:.3f} … {verdict.highest:.3f}"
        fit = (LABELS[control], str(len(ranks.ranks)), coverage, failing)
        p_value, word = f"{verdict.smallest_p_value:.2g}", "passes" if verdict.passed else "fails"
        rows.append((*fit, f"± {verdict.tolerance:.3f}", p_value, word))
    main = collected["none"]
    chains = int(main.by_chain.sum())
    return f"""\
Parameters drawn from the priors, the eight wheel biases of 2009-10 flown again by the mechanism of
[the likelihood's derivation](../topics/totals-likelihood.md) §3, every set fitted, and the rank of
each true value kept. A 90 % interval (central) has to hold the truth in 90 ± 3 % of the
repetitions, for every parameter (wider where few repetitions scatter more than that), and no rank
distribution may be skewed; the negative controls have to fail.

{markdown_table(HEADER, rows)}

![Coverage and rank distributions]({stem}.png)

Coverage of every parameter: [{stem}.csv]({stem}.csv). Draws are importance draws where Pareto k̂
is below 0.5 (largest k̂ of the model's fits {main.pareto_k.max():.2f}), else a chain ({chains} of
{len(main.ranks)} fits).

The velocity change is simulated and fitted as computed on board; taking it as measured is not part
of this campaign. A control's own fixed parameter is left out of its row."""
