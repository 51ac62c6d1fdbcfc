"""The calibration campaign of telemetry: all variants and controls, one verdict, one page."""

from __future__ import annotations

import platform
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import pandas as pd

from cassini_bayes import __version__
from cassini_bayes.files.storage import write_bytes, write_text
from cassini_bayes.report.plots import encode
from cassini_bayes.report.plots.envelopes import envelope_figure
from cassini_bayes.results.ranks import (
    Ranks,
    coverage_p_values,
    envelope_p_values,
    holm,
    read_ranks,
    run_repetitions,
)
from cassini_bayes.studies.telemetry_calibration import (
    CONTROLS,
    VARIANTS,
    TelemetryCampaign,
    Variant,
    model_code_digest,
)

LEVEL: Final = 0.01
REPETITIONS: Final[Mapping[str, int]] = {
    **{variant.name: 100 for variant in VARIANTS},
    **{control.name: 30 for control in CONTROLS},
    "joint": 300,
    "quiet-wheels": 50,
    "noisy-wheels": 50,
}
ENOUGH: Final = 50
"""Repetitions of a variant from which its not being rejected says something."""
QUICK: Final[Mapping[str, int]] = dict.fromkeys(REPETITIONS, 15) | {"joint": 40}


@dataclass(frozen=True)
class Judgement:
    """All variants judged together.

    ``table`` has one row per variant and parameter: coverage of 90 % intervals, p-values of the
    ranks' ECDF envelope and of the coverage, and both after Holm's adjustment over all variants.
    """

    table: pd.DataFrame
    passed: bool


def calibrate_telemetry(
    scenario: str,
    priors: str,
    *,
    seed: int,
    repetitions: Mapping[str, int],
    folder: Path,
    page: Path,
    jobs: int,
    command: Sequence[str],
    progress: Callable[[str, int, int], None],
) -> bool:
    """Run all variants and controls and write page, tables and figures.

    Returns whether every variant passes and every control fails.
    """
    collected: dict[str, Ranks] = {}
    variants = (*VARIANTS, *CONTROLS)
    for variant in variants:
        campaign = TelemetryCampaign(scenario, priors, seed, variant)
        number = repetitions[variant.name]
        for done, total in run_repetitions(campaign, number, folder / variant.name, jobs):
            progress(variant.label, done, total)
        collected[variant.name] = read_ranks(campaign, number, folder / variant.name)
    main = judge({v.name: collected[v.name] for v in VARIANTS})
    controls = {v.name: judge({v.name: collected[v.name]}) for v in CONTROLS}
    figure = envelope_figure({v.label: collected[v.name] for v in variants}, 1.0 - LEVEL)
    write_bytes(page.with_suffix(".png"), encode(figure, "png"))
    table = pd.concat([main.table, *(control.table for control in controls.values())])
    write_text(page.with_suffix(".csv"), table.to_csv(index=False, float_format="%.4g"))
    text = _page(page.stem, collected, main, controls, seed, command)
    write_text(page, text)
    return main.passed and not any(control.passed for control in controls.values())


def judge(collected: Mapping[str, Ranks]) -> Judgement:
    """Ranks against the simultaneous envelope and coverage against the binomial, Holm over all."""
    parts = []
    for name, ranks in collected.items():
        n = len(ranks.ranks)
        coverage = ranks.coverage()
        parts.append(
            pd.DataFrame(
                {
                    "variant": name,
                    "parameter": ranks.names,
                    "repetitions": n,
                    "mean_rank": ranks.ranks.mean(0),
                    "coverage_90": coverage,
                    "p_envelope": envelope_p_values(ranks.ranks),
                    "p_coverage": coverage_p_values(coverage, n),
                }
            )
        )
    table = pd.concat(parts, ignore_index=True)
    table["p_envelope_holm"] = holm(table["p_envelope"].to_numpy())
    table["p_coverage_holm"] = holm(table["p_coverage"].to_numpy())
    least = min(table["p_envelope_holm"].min(), table["p_coverage_holm"].min())
    return Judgement(table, bool(least > LEVEL))


def _row(variant: Variant, ranks: Ranks, judgement: Judgement) -> str:
    table = judgement.table[judgement.table["variant"] == variant.name]
    outside = (table["p_envelope_holm"] <= LEVEL) | (table["p_coverage_holm"] <= LEVEL)
    worst = table.loc[table["p_envelope"].idxmin()]
    return (
        f"| {variant.label} | {len(ranks.ranks)} | {len(table)} "
        f"| {table['coverage_90'].min():.3f} … {table['coverage_90'].max():.3f} "
        f"| {table['p_envelope_holm'].min():.2g} | {table['p_coverage_holm'].min():.2g} "
        f"| {int(outside.sum())} | {worst['parameter']} (mean rank {worst['mean_rank']:.2f}) "
        f"| {int(ranks.by_chain.sum())} | {ranks.pareto_k.max():.2f} |"
    )


def _page(
    stem: str,
    collected: Mapping[str, Ranks],
    main: Judgement,
    controls: Mapping[str, Judgement],
    seed: int,
    command: Sequence[str],
) -> str:
    rows = [_row(v, collected[v.name], main) for v in VARIANTS]
    rows += [_row(v, collected[v.name], controls[v.name]) for v in CONTROLS]
    failed = [v.label for v in CONTROLS if not controls[v.name].passed]
    verdict = "passes" if main.passed else "FAILS"
    least = min(len(collected[v.name].ranks) for v in VARIANTS)
    if main.passed and least < ENOUGH:
        verdict = f"is not rejected (with {least} repetitions only gross faults would be)"
    return f"""# Calibration of the joint model on telemetry

Parameters drawn from the priors, wheel rates drawn anew, two wheel biases and a set of slews flown
in closed loop by the [simulation](../simulation.md), telemetry reduced and fitted with the
[joint model](../telemetry-likelihood.md), the rank of each true value among 999 posterior draws
kept. All ranks together have to stay inside the simultaneous {1 - LEVEL:.0%} ECDF envelope, and
90 % central intervals have to cover, both after Holm's adjustment over all parameters of all
variants. Each control is judged alone and has to fail.

**The model {verdict}; {len(failed)} of {len(CONTROLS)} controls fail as they must.**

| variant | repetitions | parameters | coverage of 90 % intervals, lowest … highest \
| smallest p, envelope (Holm) | smallest p, coverage (Holm) | parameters rejected \
| most extreme | chains | largest Pareto k̂ |
| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |
{chr(10).join(rows)}

![Rank distributions in their simultaneous envelopes]({stem}.png)

Every parameter: [{stem}.csv]({stem}.csv). Draws are importance draws where Pareto k̂ < 0.5, else a
chain. Of the torques, which all events of a repetition share in truth and each fit has per event,
the first event's are ranked.

Seed {seed}, stated before the run. Made by `{" ".join(command)}` with cassini_bayes {__version__},
Python {platform.python_version()}; SHA-256 of the model's code `{model_code_digest()[:16]}…`.
"""
