"""Published thrust estimates: a CSV of thrusts with their pulses, and what may be wrong with them.

An estimate is y = F R(τ_f) k (1 + ε): F the thrust (common level, a thruster's departure), R the
ratio of delivered to commanded impulse of its pulses, 1 where the estimate was corrected for tails,
k what all estimates share (geometry, inertia), ε the event's own departure. Every hypothesis is a
prior on these, written as a function of standard normals z.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
from scipy.special import ndtr, ndtri

from cassini_bayes.computing.arrays import Array
from cassini_bayes.diagnosis.case import NONE, UNKNOWN
from cassini_bayes.effects.printed import FACTOR, Printed
from cassini_bayes.effects.registry import Kinds
from cassini_bayes.errors import InputError
from cassini_bayes.files.cells import Row, first_line, read_rows
from cassini_bayes.files.checks import parse_number
from cassini_bayes.files.reading import exists
from cassini_bayes.priors.reader import Priors
from cassini_bayes.spacecraft.pulses import PULSE_SHAPES, PulseShape

Predict = Callable[[Array], "Prediction"]
COLUMNS: Final = (
    "id", "thruster", "thrust_n", "thrust_sd_n", "shared_sd", "pulses", "on_time_per_pulse_s",
    "tail_corrected", "source",
)  # fmt: skip
ALL: Final = "all"
NEEDED: Final = (
    "thrust_common_n", "thrust_individual_n", "thrust_event_n", "tau_rise_s", "tau_fall_s",
)  # fmt: skip
GEOMETRY: Final = "geometry or inertia"
CLOSED_FORM: Final = "pulse_shape, first-order closed form"
DELAY_S: Final = 0.005
"""Of the valve, in closed forms that have it: it cancels in all but the shortest pulses."""
MOST_DEFICIT: Final = 0.9  # of a thrust: what lacks more would be called dead
FARTHEST: Final = 37.0
"""Standard deviations beyond which a normal's tail is zero in floating point."""


@dataclass(frozen=True)
class Prediction:
    """What a hypothesis predicts: estimates and the parameters behind them, each (n,).

    ``independent_sd_n`` is the spread of every estimate about its prediction that nothing shares.
    """

    estimate_n: Array  # (n, E)
    independent_sd_n: Array  # (n, E)
    parameters: Mapping[str, Array]


@dataclass(frozen=True)
class EstimateHypothesis:
    """One hypothesis: what it predicts at standard normals (n, d), and its prior probability."""

    name: str
    prior_probability: float
    dimension: int
    predict: Predict

    @property
    def causes(self) -> tuple[str, ...]:
        """Names joined by a plus sign, one or two; none where it is no cause."""
        return () if self.name in (NONE, UNKNOWN) else tuple(self.name.split("+"))

    @property
    def log_penalty(self) -> float:
        """Nothing is searched for before the fit."""
        return 0.0


def positive_normal(z: Array, mean: float, sd: float) -> Array:
    """N(mean, sd²) cut off at zero (mean ≥ 0), as a rising function of a standard normal z.

    Rising, so that a posterior has one mode where the absolute value of a normal would have two.
    """
    if sd == 0.0:
        return np.full_like(z, mean)
    kept, cut = float(ndtr(mean / sd)), float(ndtr(-mean / sd))
    inside = np.clip(z, -FARTHEST, FARTHEST)
    above, below = kept * ndtr(-inside), cut + kept * ndtr(inside)
    # each tail by its own small probability: the other's would be one less that
    white = np.where(above < 0.5, -ndtri(above), ndtri(below))
    return np.asarray(mean + sd * white)


def deficit(z: Array, sd: float) -> Array:
    """Share (n,) that a thruster lacks: half a normal, at most nine tenths."""
    return np.minimum(positive_normal(z, 0.0, sd), MOST_DEFICIT)


def pulse_ratio(
    shape: PulseShape,
    widths_s: Array,
    counts: Array,
    rise_s: float,
    fall_s: Array,
    offset_s: Array | float = 0.0,
) -> Array:
    """Delivered over commanded impulse R (n,) of a set of pulses at tail-off times (n,), s.

    ``offset_s`` (n,) is by how much every pulse lasts longer than commanded.
    """
    fall, offset = (np.asarray(value, dtype=np.float64)[..., None] for value in (fall_s, offset_s))
    effective = shape.longer_time(widths_s, offset, DELAY_S, rise_s, fall)
    return np.asarray((effective * counts).sum(-1) / (widths_s @ counts))


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
    """Read a CSV of estimates (:func:`read_all_estimates`)."""
    return read_all_estimates([path], thrusters)


def read_all_estimates(paths: Sequence[Path], thrusters: Sequence[str]) -> tuple[Estimate, ...]:
    """Read CSV files of estimates; lines that start with ``#`` are comments.

    ``thruster`` is one of ``thrusters`` or ``all``; several widths are ``133;16;1`` pulses of
    ``0.125;0.25;0.5`` s.

    Raises
    ------
    InputError
        A missing or unknown column, or a bad value; rows that do not share one ``shared_sd``, an
        id twice, in one file or two: file, line and column are named.
    """
    what = "a CSV of estimates"
    rows = [row for path in paths for row in read_rows(path, COLUMNS, COLUMNS, what, comments=True)]
    estimates = tuple(_estimate(row, thrusters) for row in rows)
    _check_together(rows, estimates)
    return estimates


def _check_together(rows: Sequence[Row], estimates: Sequence[Estimate]) -> None:
    """Refuse rows that differ in what all share, and one id of two: each is an observation."""
    known: dict[str, Row] = {}
    for row, estimate in zip(rows, estimates, strict=True):
        if estimate.shared_sd != estimates[0].shared_sd:
            first = rows[0].where("shared_sd")
            expected = f"one value in all rows, {estimates[0].shared_sd:g} as in {first}"
            raise row.refuse("shared_sd", expected, "make them equal")
        if estimate.id in known:
            expected = f"another id than in {known[estimate.id].where('id')}"
            raise row.refuse("id", expected, "rename one, or leave one out")
        known[estimate.id] = row


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
    result = [parse_number(text.strip()) for text in row.cells[column].split(";")]
    values = tuple(value for value in result if value is not None and value > 0.0)
    if len(values) < len(result):
        raise row.refuse(column, "positive numbers", "mend it")
    return values


@dataclass(frozen=True)
class Estimates:
    """Estimates with the priors that they are held against.

    ``printed`` are the widths of what all share or name, ``event_sd`` (a fraction) that of an
    event's own departure, ``individual_sd_n`` that of a thruster's.
    """

    rows: tuple[Estimate, ...]
    thrust_n: float
    event_sd: float
    rise_s: float
    fall_s: float
    printed: Printed
    individual_sd_n: float = 0.0
    shape: str = "published_2005"

    @property
    def thrust_estimates_n(self) -> Array:
        """(E,)"""
        return np.array([row.thrust_n for row in self.rows])

    @property
    def sd_n(self) -> Array:
        """Own errors (E,) of the estimates."""
        return np.array([row.sd_n for row in self.rows])

    @property
    def coordinates(self) -> tuple[str, ...]:
        """What the standard normals are of, in order."""
        pulsed = ("fall", "offset") if self.printed.is_pulsed else ()
        weak = tuple(f"deficit:{name}" for name in self.printed.degraded)
        return ("thrust", *pulsed, "scale", *weak, *self.printed.thrusters)

    def predict(self, z: Array) -> Prediction:
        """What would have been estimated at standard normals (n, d)."""
        at, errors = dict(zip(self.coordinates, z.T, strict=True)), self.printed
        thrust, scale = 1.0 + errors.thrust_sd * at["thrust"], 1.0 + errors.scale_sd * at["scale"]
        weak = {
            name: 1.0 - deficit(at[f"deficit:{name}"], errors.deficit_sd)
            for name in errors.degraded
        }
        parameters = {"thrust_common_n": self.thrust_n * thrust}
        if not weak:
            parameters["thrust_factor"] = thrust
        if errors.is_pulsed:
            parameters["tau_fall_s"] = positive_normal(at["fall"], self.fall_s, errors.fall_sd_s)
            parameters["impulse_time_offset_s"] = errors.offset_sd_s * at["offset"]
        parameters["scale"] = scale
        for name, factor in weak.items():
            parameters["thrust_factor" if len(weak) == 1 else f"thrust_factor[{name}]"] = factor
        columns, ratios = [], {}
        for row in self.rows:
            level = self.thrust_n * thrust
            if row.thruster in errors.thrusters:
                level = level + self.individual_sd_n * at[row.thruster]
            level = level * weak.get(row.thruster, 1.0)
            pulses = () if row.corrected else (row.widths_s, row.pulses)
            if pulses not in ratios:
                ratios[pulses] = self._ratio(row, parameters)
            columns.append(level * scale * ratios[pulses])
        if errors.is_pulsed and len(ratios) == 1:
            (parameters["ratio"],) = ratios.values()
        estimate = np.stack(columns, axis=1)
        return Prediction(estimate, self.event_sd * estimate, parameters)

    def _ratio(self, row: Estimate, parameters: Mapping[str, Array]) -> Array | float:
        if row.corrected:
            return 1.0
        widths, counts = np.array(row.widths_s), np.array(row.pulses)
        fall, offset = parameters["tau_fall_s"], parameters["impulse_time_offset_s"]
        return pulse_ratio(PULSE_SHAPES[self.shape], widths, counts, self.rise_s, fall, offset)

    def hypothesis(self, name: str, prior_probability: float) -> EstimateHypothesis:
        """These priors as a hypothesis."""
        return EstimateHypothesis(name, prior_probability, len(self.coordinates), self.predict)

    def doubted(self, kinds: Kinds, width: float) -> dict[str, Estimates]:
        """One thing doubted at a time, by name of the cause, at a width of the effects' priors."""
        doubted = {
            name: replace(self, printed=printed)
            for kind, table in kinds.kinds
            if kind.doubt is not None and "estimates" in table.inputs
            for name, printed in kind.doubt(self.printed, width).items()
        }
        scale_sd = FACTOR * width * self.printed.scale_sd
        doubted[GEOMETRY] = replace(self, printed=replace(self.printed, scale_sd=scale_sd))
        if self.printed.is_pulsed and self.shape != "first_order":
            doubted[CLOSED_FORM] = replace(self, shape="first_order")
        return doubted

    def hypotheses(self, kinds: Kinds, width: float = 1.0) -> list[EstimateHypothesis]:
        """``none``, ``unknown`` and what may be wrong with such estimates."""
        unknown = replace(self, event_sd=kinds.unknown.estimate_sd)
        doubted = self.doubted(kinds, width)
        shares = kinds.odds.of_causes([name.partition(":")[0] for name in doubted])
        return [
            self.hypothesis(NONE, kinds.odds.none),
            unknown.hypothesis(UNKNOWN, kinds.odds.unknown),
            *(doubted[n].hypothesis(n, p) for n, p in zip(doubted, shares, strict=True)),
        ]

    def pairs(self, kinds: Kinds, first: str) -> list[EstimateHypothesis]:
        """The first cause doubted together with every other, each with its prior probability."""
        alone = {h.name: h.prior_probability for h in self.hypotheses(kinds)}
        both = self.doubted(kinds, 1.0)[first].doubted(kinds, 1.0)
        return [
            h.hypothesis(f"{first}+{second}", alone[first] * alone[second])
            for second, h in both.items()
            if second in alone and second != first
        ]


def estimates_of(rows: Sequence[Estimate], priors: Priors) -> Estimates:
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
        fixed = 0.0 if prior.fixed is None else float(prior.fixed)
        known = prior.distribution
        values[name] = (fixed, 0.0) if known is None else (known.mean(), known.sd())
    thrust, sd = values["thrust_common_n"]
    fall, fall_sd = values["tau_fall_s"]
    return Estimates(
        tuple(rows),
        thrust,
        values["thrust_event_n"][1] / thrust,
        values["tau_rise_s"][0],
        fall,
        Printed(
            sd / thrust,
            fall_sd,
            rows[0].shared_sd,
            tuple(sorted({row.thruster for row in rows} - {ALL})),
            not all(row.corrected for row in rows),
        ),
        values["thrust_individual_n"][1],
    )
