"""Long calibration campaigns: run them resumably, write their tables, figure and page."""

from __future__ import annotations

import platform
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from cassini_bayes import __version__
from cassini_bayes.files.storage import write_bytes, write_text
from cassini_bayes.report.plots import encode
from cassini_bayes.report.plots.calibration import coverage_figure
from cassini_bayes.results.ranks import Ranks, read_ranks, run_repetitions
from cassini_bayes.studies.totals_calibration import (
    CONTROLS,
    Campaign,
    Control,
    Verdict,
    judge,
    model_code_digest,
)

HEADER = (
    "| fit | repetitions | coverage, lowest … highest | parameters outside "
    "| tolerance | smallest rank-uniformity p (Holm) | verdict |"
)
LABELS: dict[Control, str] = {
    "none": "the model",
    "hold-rates-ignored": "control: hold rates ignored",
    "rectangular-pulses": "control: pulses taken as rectangular",
}


def calibrate_totals(
    events: str,
    priors: str,
    *,
    seed: int,
    repetitions: int,
    control_repetitions: int,
    folder: Path,
    page: Path,
    jobs: int,
    command: Sequence[str],
    progress: Callable[[str, int, int], None],
) -> bool:
    """Run the totals calibration with both negative controls and write its results.

    ``folder`` keeps the finished repetitions (a killed campaign goes on from there), ``page`` is
    the markdown page; the figure and the coverage table go beside it. Returns whether the model
    passes and both controls fail.
    """
    collected: dict[Control, Ranks] = {}
    for control in CONTROLS:
        campaign = Campaign(events, priors, seed, control)
        number = repetitions if control == "none" else control_repetitions
        for done, total in run_repetitions(campaign, number, folder / control, jobs):
            progress(LABELS[control], done, total)
        collected[control] = read_ranks(campaign, number, folder / control)
    verdicts = {control: judge(ranks) for control, ranks in collected.items()}
    figure = coverage_figure(
        {LABELS[control]: ranks for control, ranks in collected.items()},
        {LABELS[control]: verdict.tolerance for control, verdict in verdicts.items()},
    )
    write_bytes(page.with_suffix(".png"), encode(figure, "png"))
    coverage = pd.DataFrame(
        {"parameter": collected["none"].names}
        | {
            # a parameter that the control fixes has no coverage
            control: np.where(np.isfinite(ranks.ranks).all(0), ranks.coverage().round(4), np.nan)
            for control, ranks in collected.items()
        }
    )
    write_text(page.with_suffix(".csv"), coverage.to_csv(index=False))
    write_text(page, _page(page.stem, collected, verdicts, seed, command))
    return verdicts["none"].passed and not any(
        verdicts[control].passed for control in CONTROLS if control != "none"
    )


def _page(
    stem: str,
    collected: dict[Control, Ranks],
    verdicts: dict[Control, Verdict],
    seed: int,
    command: Sequence[str],
) -> str:
    rows = "\n".join(
        f"| {LABELS[control]} | {len(ranks.ranks)} | {verdicts[control].lowest:.3f} … "
        f"{verdicts[control].highest:.3f} | {len(verdicts[control].failing)} of "
        f"{len(ranks.of_fitted().names)} | ± {verdicts[control].tolerance:.3f} | "
        f"{verdicts[control].smallest_p_value:.2g} | "
        f"{'passes' if verdicts[control].passed else 'fails'} |"
        for control, ranks in collected.items()
    )
    main = collected["none"]
    chains = int(main.by_chain.sum())
    return f"""# Calibration of the totals model

Parameters drawn from the priors, the eight wheel biases of 2009-10 flown again by the mechanism of
[the likelihood's derivation](../totals-likelihood.md) §3, every set fitted, and the rank of each
true value kept. A 90 % interval (central) has to hold the truth in 90 ± 3 % of the repetitions, for
every parameter (wider where few repetitions scatter more than that), and no rank distribution may
be skewed; the negative controls have to fail.

{HEADER}
| --- | --- | --- | --- | --- | --- | --- |
{rows}

![Coverage and rank distributions]({stem}.png)

Coverage of every parameter: [{stem}.csv]({stem}.csv). Draws are importance draws where Pareto k̂
is below 0.5 (largest k̂ of the model's fits {main.pareto_k.max():.2f}), else a chain ({chains} of
{len(main.ranks)} fits).

The velocity change is simulated and fitted as computed on board; taking it as measured is not part
of this campaign. A control's own fixed parameter is left out of its row.

Made by `{" ".join(command)}` (seed {seed}) with cassini_bayes {__version__}, Python
{platform.python_version()}; SHA-256 of the model's code `{model_code_digest()[:16]}…`.
"""
