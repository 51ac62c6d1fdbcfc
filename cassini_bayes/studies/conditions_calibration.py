"""Simulation-based calibration over conditions: every repetition draws one level of each.

Parameters are drawn from the priors and conditions from :mod:`.conditions`; the telemetry is flown,
reduced and fitted, and the rank of every true value is kept. Ranks are judged by stratum, one level
of one condition, and pooled. Repetitions that the package declines count as declined.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.stats import kstest

from cassini_bayes.errors import InputError
from cassini_bayes.model.posterior import build_model, log_posterior
from cassini_bayes.report.study_page import table_of
from cassini_bayes.results.ranks import coverage_p_values, holm, rank
from cassini_bayes.studies.conditions import (
    CRAFTS,
    beliefs_under,
    draw_condition,
    scenario_under,
    strata_of,
    with_known_noise,
)
from cassini_bayes.studies.posterior_draws import posterior_draws
from cassini_bayes.studies.repeated import Repeated
from cassini_bayes.studies.scenario import simulate_file
from cassini_bayes.studies.study import Study
from cassini_bayes.studies.telemetry_calibration import (
    CHAIN_STEPS,
    EFFORTS,
    flat_draws,
    flat_truth,
    reduced_simulation,
)

MODULE: Final = "studies.conditions_calibration"
FULL: Final[Mapping[str, int]] = {"conditions": 1_000}
QUICK: Final[Mapping[str, int]] = {"conditions": 40}
LEVEL: Final = 0.05
LEAST: Final = 30  # repetitions of a stratum that are judged: with fewer nothing would be rejected
PROBABILITY: Final = 0.9


@dataclass(frozen=True)
class ConditionTrials(Repeated):
    """Repetitions over conditions: scenario whose events are flown, folder of priors, seed."""

    scenario: Path
    priors: Path

    def inputs(self) -> list[Path]:
        """The scenario, and the priors files of all crafts."""
        return [self.scenario, *(self.priors / file for file, *_ in CRAFTS.values())]

    def repetition(self, index: int) -> Mapping[str, NDArray[Any] | float | bool]:
        """One repetition: levels, ranks of the scalars it has (JSON keys by name), Pareto k̂."""
        rng = self.stream(index)
        condition = draw_condition(rng)
        file = scenario_under(condition, self.scenario, self.priors, rng)
        priors = beliefs_under(condition, self.priors)
        flight = simulate_file(file, int(rng.integers(2**62)), priors=priors)
        truth = flat_truth(flight)
        if condition.noise == "known":
            priors = with_known_noise(priors, truth)
        ranks, pareto_k = np.full(len(SCALARS), np.nan), np.nan
        try:
            model = build_model([reduced_simulation(e, priors) for e in flight.events], priors)
            density = partial(log_posterior, model)
            z, pareto_k, _ = posterior_draws(density, model.starts, rng, EFFORTS, CHAIN_STEPS)
            drawn = flat_draws(model, z, rng)
            for place, name in enumerate(SCALARS):
                if name in drawn and name in truth and np.ptp(drawn[name]) > 0.0:
                    ranks[place] = rank(drawn[name], truth[name], rng)
        except InputError:
            pass  # declined: every rank stays unknown
        return {"levels": condition.places, "ranks": ranks, "pareto_k": pareto_k}


SCALARS: Final = (
    *(f"inertia_{e}_kg_m2" for e in ("xx", "yy", "zz", "xy", "xz", "yz")),
    *(f"rwa{n}_inertia_kg_m2" for n in (1, 2, 3, 4)),
    "rwa4_tilt_u_rad",
    "rwa4_tilt_v_rad",
    "tau_rise_s",
    "tau_fall_s",
    *(f"cm_{axis}_m" for axis in "xyz"),
    *(f"thruster_{name}_m" for name in ("lx", "ly", "lzz", "lzy")),
    "rate_noise_rad_s",
    "wheel_noise_rpm",
    "attitude_noise_rad",
    "torque_noise_n_m_s05",
    *(f"thrust_n[bias-1,{k}]" for k in ("z1", "z2", "z3", "z4", "y1", "y2", "y3", "y4")),
    *(f"external_torque_n_m[bias-1,{axis}]" for axis in "xyz"),
)
"""What is ranked: shared parameters, thrusts and torque of the first bias."""


def judged(found: Mapping[str, NDArray[Any]]) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Strata, and every parameter pooled over them, each with coverage and p-values after Holm."""
    levels, ranks = found["levels"].astype(int), found["ranks"]
    known = np.isfinite(ranks)
    tail = 0.5 * (1.0 - PROBABILITY)
    inside = (ranks > tail) & (ranks < 1.0 - tail)  # an unknown one is not
    rows, places = [], []
    for name, level, chosen in [("all", "all", np.full(len(ranks), True)), *strata_of(levels)]:
        for place, scalar in enumerate(SCALARS):
            counted = chosen & known[:, place]
            number = int(counted.sum())
            if number < LEAST:
                continue
            own, coverage = ranks[counted, place], inside[counted, place].mean()
            p_ranks = float(kstest(own, "uniform").pvalue)
            p_coverage = coverage_p_values(np.array([coverage]), number, PROBABILITY)[0]
            rows.append([name, level, scalar, number, own.mean(), coverage, p_ranks, p_coverage])
        share = inside[chosen].sum() / max(int(known[chosen].sum()), 1)
        declined = int((chosen & ~known.any(axis=1)).sum())
        places.append([name, level, int(chosen.sum()), declined, share])
    columns = ["condition", "level", "scalar", "n", "mean_rank", "coverage_90", "p_ranks"]
    table = pd.DataFrame(rows, columns=[*columns, "p_coverage"])
    both = holm(table[["p_ranks", "p_coverage"]].to_numpy().ravel()).reshape(-1, 2)
    table["p_holm"] = both.min(axis=1) if len(table) else []
    summary = pd.DataFrame(
        places, columns=["condition", "level", "repetitions", "declined", "coverage_90"]
    )
    return summary, table


def calibrate_conditions(
    study: Study, scenario: Path, priors: Path, numbers: Mapping[str, int]
) -> bool:
    """Run the repetitions and write page and tables; whether no stratum is rejected."""
    trials = ConditionTrials(scenario, priors, seed=study.seed)
    result = study.repeat("conditions", "conditions", trials, numbers["conditions"])
    summary, table = judged(result)
    rejected = table[table["p_holm"] <= LEVEL]
    body = _body(summary, table, rejected, len(result["ranks"]))
    study.publish("Calibration over conditions", body, MODULE, {"": table, "-strata": summary}, {})
    return bool(rejected.empty)


def _body(summary: pd.DataFrame, table: pd.DataFrame, rejected: pd.DataFrame, number: int) -> str:
    rows = table_of(
        summary,
        "condition | level | repetitions | declined | coverage of 90 % intervals",
        "{condition} | {level} | {repetitions} | {declined} | {coverage_90:.3f}",
    )
    least = table.assign(p_least=table[["p_ranks", "p_coverage"]].min(axis=1))
    worst = table_of(
        least.sort_values("p_least").head(12),
        "condition | level | scalar | repetitions | coverage | mean rank | p | p after Holm",
        "{condition} | {level} | {scalar} | {n} | {coverage_90:.2f} | {mean_rank:.2f}"
        " | {p_least:.2g} | {p_holm:.2g}",
    )
    return f"""\
Does a 90 % interval hold 90 % of the truths, whatever the flight was like? Every repetition draws
craft, events, cadence, steps of counters and wheels, noise of rates, controller, whether noise is
known, and the torque that drives wheels. Parameters are drawn from the priors.

The rank of the truth among 999 posterior draws is tested for every scalar in every stratum with at
least {LEAST} repetitions: by Kolmogorov and Smirnov, and by the coverage of 90 % intervals. Holm's
correction covers all tests at {LEVEL:.0%}. Goals: none rejected, and pooled coverage 0.90 ± 0.03. A
stratum passes if it is not rejected; few repetitions reject little, so the table counts them.

**Rejected: {len(rejected)} of {len(table)}. Pooled coverage: {summary["coverage_90"][0]:.3f}, over
{number} repetitions.**

{rows}

The twelve that are furthest off (p: the lesser of both tests):

{worst}
"""
