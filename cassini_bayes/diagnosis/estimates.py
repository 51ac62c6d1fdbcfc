"""Published thrust estimates as input of a diagnosis: a CSV of thrusts with their pulses.

An estimate is y = F R(τ_f) k (1 + ε): F the thrust (common level, a thruster's departure), R the
ratio of delivered to commanded impulse of its pulses, 1 where the estimate was corrected for tails,
k what all estimates share (geometry, inertia), ε the event's own departure.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from cassini_bayes.diagnosis.score import gain_verdict, summed
from cassini_bayes.diagnosis.summaries import (
    LeftOut,
    Prediction,
    SummaryCause,
    SummaryVerdict,
    leave_out,
    positive_normal,
    pulse_ratio,
    untrusted,
    weigh_summaries,
)
from cassini_bayes.errors import InputError
from cassini_bayes.files.cells import Row, first_line, read_rows
from cassini_bayes.files.checks import parse_number
from cassini_bayes.files.reading import exists
from cassini_bayes.priors.reader import Priors
from cassini_bayes.spacecraft.pulses import PULSE_SHAPES

Array = NDArray[np.float64]
COLUMNS: Final = (
    "id", "thruster", "thrust_n", "thrust_sd_n", "shared_sd", "pulses", "on_time_per_pulse_s",
    "tail_corrected", "source",
)  # fmt: skip
ALL: Final = "all"
NEEDED: Final = (
    "thrust_common_n", "thrust_individual_n", "thrust_event_n", "tau_rise_s", "tau_fall_s",
)  # fmt: skip
FACTOR: Final = 5.0
NONE, UNKNOWN, CATALOGUED = 0.5, 0.05, 0.45
DEFICIT, OFFSET_S, UNKNOWN_SD = 0.2, 0.04, 0.15
WIDTHS: Final = (0.5, 1.0, 2.0)
LEAST_ESTIMATES: Final = 3
LEAST_THRUST_SD, LEAST_TAIL_SD_S, LEAST_SHARED_SD = 0.02, 0.002, 0.004


@dataclass(frozen=True)
class Estimate:
    """One row: thrust with its own error, pulses by width, whether tails are corrected."""

    id: str
    thruster: str
    thrust_n: float
    sd_n: float
    shared_sd: float
    pulses: tuple[float, ...]
    widths_s: tuple[float, ...]
    corrected: bool


def is_estimates(path: Path) -> bool:
    """Whether a file is a CSV of estimates, by its header."""
    if path.suffix != ".csv" or not exists(path) or path.is_dir():
        return False
    header = first_line(path, "a CSV file", "#").split(",")
    return {"thrust_n", "on_time_per_pulse_s"} <= {cell.strip() for cell in header}


def read_estimates(path: Path, thrusters: Sequence[str]) -> tuple[Estimate, ...]:
    """Read a CSV of estimates; lines that start with ``#`` are comments.

    ``thruster`` is one of ``thrusters`` or ``all``; several widths are ``133;16;1`` pulses of
    ``0.125;0.25;0.5`` s.

    Raises
    ------
    InputError
        A missing or unknown column, or a bad value: file, line and column are named.
    """
    table = read_rows(path, COLUMNS, COLUMNS, "a CSV of estimates", comments=True)
    rows = tuple(_estimate(row, thrusters) for row in table)
    if len({row.shared_sd for row in rows}) > 1:
        raise InputError(
            f"{path}: column shared_sd", "one value in all rows", "several", "make them equal"
        )
    return rows


def _estimate(row: Row, thrusters: Sequence[str]) -> Estimate:
    pulses, widths = _numbers(row, "pulses"), _numbers(row, "on_time_per_pulse_s")
    if len(pulses) != len(widths):
        raise row.refuse(
            "on_time_per_pulse_s", f"{len(pulses)} values, as in pulses",
            "give one width to every count", str(len(widths)),
        )  # fmt: skip
    thruster = row.cells["thruster"].lower()
    if thruster not in (ALL, *thrusters):
        fix = "name a thruster of the priors' branch"
        raise row.refuse("thruster", f"{ALL}, {', '.join(thrusters)}", fix)
    if row.cells["tail_corrected"] not in ("yes", "no"):
        raise row.refuse("tail_corrected", "yes or no", "say which")
    return Estimate(
        row.cells["id"],
        thruster,
        _numbers(row, "thrust_n")[0],
        _numbers(row, "thrust_sd_n")[0],
        _numbers(row, "shared_sd")[0],
        pulses,
        widths,
        row.cells["tail_corrected"] == "yes",
    )


def _numbers(row: Row, column: str) -> tuple[float, ...]:
    found = [parse_number(text.strip()) for text in row.cells[column].split(";")]
    values = tuple(value for value in found if value is not None and value > 0.0)
    if len(values) < len(found):
        raise row.refuse(column, "positive numbers", "mend it")
    return values


@dataclass(frozen=True)
class EstimateCase:
    """Estimates with the priors that they are held against."""

    rows: tuple[Estimate, ...]
    thrust_n: float
    thrust_sd_n: float
    individual_sd_n: float
    event_sd: float  # fraction
    rise_s: float
    fall_s: float
    fall_sd_s: float
    scale_sd: float  # fraction
    shape: str = "published_2005"
    offset_sd_s: float = 0.0
    degraded: str = ""
    deficit_sd: float = DEFICIT

    @property
    def named(self) -> tuple[str, ...]:
        """Thrusters that rows name."""
        return tuple(sorted({row.thruster for row in self.rows} - {ALL}))

    def predict(self, z: Array) -> Prediction:
        """What would have been estimated at standard normals (n, 5 + named thrusters)."""
        common = self.thrust_n + self.thrust_sd_n * z[:, 0]
        fall = positive_normal(z[:, 1], self.fall_s, self.fall_sd_s)
        scale = 1.0 + self.scale_sd * z[:, 2]
        offset = self.offset_sd_s * z[:, 3]
        factor = 1.0 - np.minimum(positive_normal(z[:, 4], 0.0, self.deficit_sd), 0.9)
        departures = self.individual_sd_n * z.T[5:]
        own = dict(zip(self.named, departures, strict=True))
        columns = []
        for row in self.rows:
            thrust = common + own.get(row.thruster, 0.0)
            thrust = thrust * factor if row.thruster == self.degraded else thrust
            columns.append(thrust * scale * self._ratio(row, fall, offset))
        estimate = np.stack(columns, axis=1)
        parameters = {"thrust_common_n": common, "tau_fall_s": fall, "scale": scale}
        if self.offset_sd_s > 0.0:
            parameters["impulse_time_offset_s"] = offset
        if self.degraded:
            parameters["thrust_factor"] = factor
        return Prediction(estimate, self.event_sd * estimate, parameters)

    def _ratio(self, row: Estimate, fall: Array, offset: Array) -> Array:
        if row.corrected:
            return np.ones_like(fall)
        widths, counts = np.array(row.widths_s), np.array(row.pulses)
        ratio = pulse_ratio(PULSE_SHAPES[self.shape], widths, counts, self.rise_s, fall)
        return np.asarray(ratio + offset * counts.sum() / (widths @ counts))

    def as_cause(self, name: str, prior_probability: float) -> SummaryCause:
        """These priors as a hypothesis."""
        return SummaryCause(name, prior_probability, 5 + len(self.named), self.predict)

    def causes(self, width: float = 1.0) -> list[SummaryCause]:
        """``none``, ``unknown`` and what may be wrong with such estimates."""
        wide = FACTOR * width
        least = LEAST_THRUST_SD * self.thrust_n
        changed = {
            "thrust_scale": replace(self, thrust_sd_n=wide * max(self.thrust_sd_n, least)),
            "geometry or inertia": replace(
                self, scale_sd=wide * max(self.scale_sd, LEAST_SHARED_SD)
            ),
        }
        if not all(row.corrected for row in self.rows):
            changed |= {
                "tail_off": replace(self, fall_sd_s=wide * max(self.fall_sd_s, LEAST_TAIL_SD_S)),
                "pulse_shape": replace(self, offset_sd_s=OFFSET_S * width),
                "pulse_shape, first-order closed form": replace(self, shape="first_order"),
            }
        weak = {
            f"thruster_degraded:{name}": replace(self, degraded=name, deficit_sd=DEFICIT * width)
            for name in self.named
        }
        share = CATALOGUED / (len(changed) + bool(weak))
        return [
            self.as_cause("none", NONE),
            replace(self, event_sd=UNKNOWN_SD).as_cause("unknown", UNKNOWN),
            *(case.as_cause(name, share) for name, case in changed.items()),
            *(case.as_cause(name, share / len(weak)) for name, case in weak.items()),
        ]


def estimate_case(rows: Sequence[Estimate], priors: Priors) -> EstimateCase:
    """Estimates held against a priors file.

    Raises
    ------
    InputError
        The file lacks a parameter that estimates need (:data:`NEEDED`).
    """
    values = {}
    for name in NEEDED:
        if name not in priors.parameters:
            raise InputError(
                f"{priors.path}: parameters.{name}", "a prior", "none", "add the table"
            )
        prior = priors.parameters[name]
        own = prior.distribution
        fixed = 0.0 if prior.fixed is None else float(prior.fixed)
        values[name] = (fixed, 0.0) if own is None else (own.mean(), own.sd())
    thrust, sd = values["thrust_common_n"]
    fall, fall_sd = values["tau_fall_s"]
    return EstimateCase(
        tuple(rows),
        thrust,
        sd,
        values["thrust_individual_n"][1],
        values["thrust_event_n"][1] / thrust,
        values["tau_rise_s"][0],
        fall,
        fall_sd,
        rows[0].shared_sd,
    )


def diagnose_estimates(case: EstimateCase, rng: np.random.Generator) -> dict[str, Any]:
    """The record of ``diagnosis.json`` for estimates: causes, sensitivity, gain if three or more.

    Warns of hypotheses whose draws do not cover their posterior.
    """
    estimate = np.array([row.thrust_n for row in case.rows])
    sd = np.array([row.sd_n for row in case.rows])
    found = {w: weigh_summaries(estimate, sd, case.causes(w), rng) for w in WIDTHS}
    doubt = untrusted([verdict for own in found.values() for verdict in own])
    if doubt:
        warnings.warn(doubt, RuntimeWarning, stacklevel=2)
    middle = found[1.0]
    none = next(v for v in middle if v.name == "none")
    causes = {cause.name: cause for cause in case.causes()}
    base, own = None, None
    if len(estimate) >= LEAST_ESTIMATES:
        base = leave_out(estimate, sd, causes["none"], rng)
        own = base if middle[0] is none else leave_out(estimate, sd, causes[middle[0].name], rng)
    return {
        "format": 1,
        "events": [row.id for row in case.rows],
        "baseline": _fit_record(none, base),
        "discrepant": none.probability < 0.5,
        "p_value": None,
        "symptoms": [],
        "closure": [],
        "causes": [_cause_record(v, none) for v in middle],
        "extended": {
            "causes": [] if middle[0] is none else [middle[0].name],
            **_fit_record(middle[0], own),
        },
        "gain": _gain(base, own),
        "sensitivity": {
            f"{w:g}": {v.name: v.probability for v in found[w]} for w in WIDTHS if w != 1.0
        },
        "second_cause_nats": None,
        "separation": [],
    }


def _gain(base: LeftOut | None, own: LeftOut | None) -> dict[str, Any]:
    """Difference of the held-out log scores, with its standard error over estimates."""
    nothing = {"still_discrepant": None, "p_value": None}
    if base is None or own is None:
        return {
            "elpd_diff": None,
            "elpd_diff_se": None,
            "heldout_rmse_ratio": None,
            "verdict": "held-out gain: not measurable",
            **nothing,
        }
    total, error = summed(own.log_scores - base.log_scores)
    ratio = own.rmse_n / base.rmse_n
    return {
        "elpd_diff": total,
        "elpd_diff_se": error,
        "heldout_rmse_ratio": ratio,
        "verdict": gain_verdict(total, error, ratio),
        **nothing,
    }


def _fit_record(verdict: SummaryVerdict, score: LeftOut | None) -> dict[str, Any]:
    total, error = (None, None) if score is None else summed(score.log_scores)
    return {
        "elpd": total,
        "elpd_se": error,
        "rmse_nms": None,
        "rmse_n": float(np.sqrt((verdict.residual_n**2).mean())),
        "heldout_rmse_nms": None,
        "heldout_rmse_n": None if score is None else score.rmse_n,
        "heldout_coverage_90": None,
        "log_evidence": verdict.log_evidence,
    }


def _cause_record(verdict: SummaryVerdict, none: SummaryVerdict) -> dict[str, Any]:
    """Sizes as means and standard deviations; the interval is that of a normal."""
    return {
        "name": verdict.name,
        "probability": verdict.probability,
        "log_bayes_factor": verdict.log_evidence - none.log_evidence,
        "log_evidence_se": verdict.log_evidence_se,
        "effective_draws": verdict.effective_draws,
        "pareto_k": verdict.pareto_k,
        "parameters": {
            key: {"mean": mean, "sd": sd, "hdi_90": [mean - 1.645 * sd, mean + 1.645 * sd]}
            for key, (mean, sd) in verdict.parameters.items()
            if sd > 0.0
        },
        "confounded_with": [],
    }
