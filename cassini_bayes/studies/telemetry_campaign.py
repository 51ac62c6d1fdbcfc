"""The calibration campaign of telemetry: all variants and controls, one verdict, one page."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd

from cassini_bayes.report.plots.envelopes import envelope_figure
from cassini_bayes.results.ranks import (
    Ranks,
    coverage_p_values,
    envelope_p_values,
    holm,
    ranks_of,
)
from cassini_bayes.studies.study import Study
from cassini_bayes.studies.telemetry_calibration import (
    CONTROLS,
    MODULE,
    VARIANTS,
    TelemetryCampaign,
    Variant,
)

LEVEL: Final = 0.01
FEW: Final = 5  # of a control that is wrong from the first, and every fit of which takes a chain
FULL: Final[Mapping[str, int]] = {
    **{variant.name: 100 for variant in VARIANTS},
    **{control.name: 75 for control in CONTROLS},
    "balance-residual": FEW,
    "cuts-ignored": 150,  # its ranks are off by 0.15 on average: few do not show that
    "joint": 300,
    "quiet-wheels": 50,
    "noisy-wheels": 50,
}
ENOUGH: Final = 50
"""Repetitions of a variant from which its not being rejected says something."""
QUICK: Final[Mapping[str, int]] = dict.fromkeys(FULL, 15) | {"joint": 40, "balance-residual": FEW}


@dataclass(frozen=True)
class Judgement:
    """All variants judged together.

    ``table`` has one row per variant and parameter: coverage of 90 % intervals, p-values of the
    ranks' ECDF envelope and of the coverage, and both after Holm's adjustment over all variants.
    """

    table: pd.DataFrame
    passed: bool


def calibrate_telemetry(
    study: Study, scenario: Path, priors: Path, numbers: Mapping[str, int]
) -> bool:
    """Run all variants and controls and write page, table and figure.

    ``numbers`` are repetitions by variant, as in :data:`FULL`. Returns whether every variant passes
    and every control fails.
    """
    collected: dict[str, Ranks] = {}
    declined: dict[str, int] = {}
    variants = (*VARIANTS, *CONTROLS)
    for variant in variants:
        campaign = TelemetryCampaign(scenario, priors, variant, seed=study.seed)
        result = study.repeat(variant.name, variant.label, campaign, numbers[variant.name])
        was_declined = np.isnan(result["ranks"]).all(axis=1)
        declined[variant.name] = int(was_declined.sum())
        answered = {key: values[~was_declined] for key, values in result.items()}
        collected[variant.name] = ranks_of(campaign.names(), answered)
    main = judge({v.name: collected[v.name] for v in VARIANTS})
    controls = {v.name: judge({v.name: collected[v.name]}) for v in CONTROLS}
    figure = envelope_figure({v.label: collected[v.name] for v in variants}, 1.0 - LEVEL)
    table = pd.concat([main.table, *(control.table for control in controls.values())])
    body = _body(study.page.stem, collected, declined, main, controls)
    study.publish(
        "Calibration of the joint model on telemetry", body, MODULE, {"": table}, {"": figure}
    )
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


def _row(variant: Variant, ranks: Ranks, declined: int, judgement: Judgement) -> str:
    table = judgement.table[judgement.table["variant"] == variant.name]
    outside = (table["p_envelope_holm"] <= LEVEL) | (table["p_coverage_holm"] <= LEVEL)
    worst = table.loc[table["p_envelope"].idxmin()]
    return (
        f"| {variant.label} | {len(ranks.ranks)} | {declined} | {len(table)} "
        f"| {table['coverage_90'].min():.3f} … {table['coverage_90'].max():.3f} "
        f"| {table['p_envelope_holm'].min():.2g} | {table['p_coverage_holm'].min():.2g} "
        f"| {int(outside.sum())} | {worst['parameter']} (mean rank {worst['mean_rank']:.2f}) "
        f"| {int(ranks.by_chain.sum())} | {ranks.pareto_k.max():.2f} |"
    )


def _body(
    stem: str,
    collected: Mapping[str, Ranks],
    declined: Mapping[str, int],
    main: Judgement,
    controls: Mapping[str, Judgement],
) -> str:
    rows = [_row(v, collected[v.name], declined[v.name], main) for v in VARIANTS]
    rows += [_row(v, collected[v.name], declined[v.name], controls[v.name]) for v in CONTROLS]
    failed = [v.label for v in CONTROLS if not controls[v.name].passed]
    verdict = "passes" if main.passed else "FAILS"
    least = min(len(collected[v.name].ranks) for v in VARIANTS)
    if main.passed and least < ENOUGH:
        verdict = f"is not rejected (with {least} repetitions only gross faults would be)"
    return f"""\
Parameters drawn from the priors, wheel rates drawn anew, two wheel biases and a set of slews flown
in closed loop by the [simulation](../topics/simulation.md), telemetry reduced and fitted with the
[joint model](../topics/telemetry-likelihood.md), the rank of each true value among 999 posterior
draws kept. All ranks together have to stay inside the simultaneous {1 - LEVEL:.0%} ECDF envelope,
and 90 % central intervals have to cover, both after Holm's adjustment over all parameters of all
variants. Each control is judged alone and has to fail.

**The model {verdict}; {len(failed)} of {len(CONTROLS)} controls fail as they must.**

| variant | repetitions | declined | parameters | coverage of 90 % intervals, lowest … highest \
| smallest p, envelope (Holm) | smallest p, coverage (Holm) | parameters rejected \
| most extreme | chains | largest Pareto k̂ |
| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |
{chr(10).join(rows)}

![Rank distributions in their simultaneous envelopes]({stem}.png)

Every parameter: [{stem}.csv]({stem}.csv). Draws are importance draws where Pareto k̂ < 0.5, else a
chain. Of the torques, which all events of a repetition share in truth and each fit has per event,
the first event's are ranked. *Declined* are flights that the package refuses before sampling; that
depends on the data alone, and they are not among the repetitions. The seed was stated before the
run."""
