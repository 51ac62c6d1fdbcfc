"""Predictions and plans as their user holds them: the next wheel bias, from a fit."""

from __future__ import annotations

import json
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import pandas as pd
import xarray as xr

from cassini_bayes.errors import InputError
from cassini_bayes.files.checks import DEFAULT_SEED, check_seed
from cassini_bayes.files.storage import write_text
from cassini_bayes.model.gather import PathLike
from cassini_bayes.pipeline.fits import FitResult
from cassini_bayes.prediction import planning
from cassini_bayes.prediction.learning import FEW_DRAWS, Learned
from cassini_bayes.prediction.minimise import (
    CheapestBias,
    Throughput,
    accumulated_throughput,
    cheapest_bias,
    cheapest_dictionary,
    cheapest_text,
)
from cassini_bayes.prediction.planning import Plan, plan_csv, plan_dictionary, plan_text
from cassini_bayes.prediction.predict import Prediction
from cassini_bayes.prediction.predict import predict as predict_one
from cassini_bayes.prediction.requests import (
    BiasRequest,
    check_ids,
    check_request,
    parse_bias,
    parse_epoch,
    parse_quaternion,
    parse_rates,
    read_requests,
)
from cassini_bayes.prediction.sources import (
    EXTENDED,
    Sources,
    learn_from_fit,
    read_sources,
    sources_of,
)
from cassini_bayes.prediction.summary import INTERVAL, as_csv, as_dictionary, as_text, lines
from cassini_bayes.report.cells import percent
from cassini_bayes.report.shown import html_of, with_interval
from cassini_bayes.results.exchange import draws_as_inference_data
from cassini_bayes.results.fitting import fit_warnings, stop_rule_held
from cassini_bayes.results.record import FIT_FILE, Fit
from cassini_bayes.results.record import read_fit as read_record

if TYPE_CHECKING:
    from cassini_bayes.report.plots import Figure

LEVELS: Final = 5
"""End rates per wheel and sign that a plan tries."""
TOP: Final = 10
"""Candidates of a plan that are shown."""
_SHOWN: Final = 12
_DRAWN: Final = (
    ("on_time_s", ("thruster",), "s"),
    ("pulses", ("thruster",), "1"),
    ("duration_s", (), "s"),
    ("delta_v_computed_m_s", ("axis",), "m s-1"),
    ("delta_v_delivered_m_s", ("axis",), "m s-1"),
    ("hydrazine_g", (), "g"),
)
"""What a prediction has draws of, beyond which dimensions, in which unit."""


def stream(seed: int, row: int) -> np.random.Generator:
    """Random stream of one bias: the same whatever other biases are asked for."""
    return np.random.default_rng(np.random.SeedSequence((seed, 1, row)))


@dataclass(frozen=True, eq=False, repr=False)
class PredictionResult:
    """Draws of planned wheel biases: on-times, pulses, ΔV, hydrazine, duration."""

    predictions: tuple[Prediction, ...]
    learned: Learned
    seed: int
    seconds: float
    warnings: tuple[str, ...] = ()  # sentences about anything that makes the draws doubtful
    converged: bool = True  # whether the fit had

    def __iter__(self) -> Iterator[Prediction]:
        return iter(self.predictions)

    def summary(self) -> pd.DataFrame:
        """One row per bias and scalar: unit, mean, sd, median, central 90 % interval.

        Returns
        -------
        DataFrame with ``attrs["interval"]``: 90 % central.
        """
        rows = [
            {"bias": prediction.request.id, **asdict(line)}
            for prediction in self.predictions
            for line in lines(prediction)
        ]
        return with_interval(pd.DataFrame(rows), INTERVAL)

    def plot_predictions(self) -> dict[str, Figure]:
        """A figure per bias: on-times, pulses, ΔV, with their intervals."""
        from cassini_bayes.report.plots import draw
        from cassini_bayes.report.plots.prediction import prediction_figure

        return draw(
            {
                prediction.request.id: partial(prediction_figure, prediction)
                for prediction in self.predictions
            }
        )

    def to_arviz(self) -> Any:  # ArviZ carries no types
        """Draws of every bias as the ``predictions`` group of ``arviz.InferenceData``."""
        first, each = self.predictions[0], ("chain", "draw", "bias")
        variables = {
            name: xr.DataArray(
                np.stack([getattr(own, name) for own in self.predictions], axis=1)[None],
                dims=(*each, *dims),
                attrs={"units": unit},
            )
            for name, dims, unit in _DRAWN
            if getattr(first, name) is not None
        }
        known: dict[str, list[str]] = {
            "bias": [prediction.request.id for prediction in self.predictions],
            "thruster": list(first.thrusters),
            "axis": list("xyz"),
        }
        labelled = xr.Dataset(variables, coords=known)
        return draws_as_inference_data({name: labelled[name] for name in variables}, "predictions")

    def as_record(self, extra: Sequence[Mapping[str, Any]] = ()) -> dict[str, Any]:
        """Everything as plain JSON types; ``extra`` has more to say of each bias."""
        biases = [as_dictionary(prediction) for prediction in self.predictions]
        for record, more in zip(biases, extra, strict=False):
            record |= more
        return {
            "seconds": round(self.seconds, 3),
            "seed": self.seed,
            **_standing(self),
            "biases": biases,
        }

    def save(self, folder: PathLike, record: Mapping[str, Any] | None = None) -> None:
        """Write ``prediction.json``, ``prediction.csv`` and ``figures/``."""
        from cassini_bayes.report.plots import save_figures

        place = Path(folder)
        document = self.as_record() if record is None else record
        write_text(place / "prediction.json", json.dumps(document, indent=1) + "\n")
        write_text(place / "prediction.csv", as_csv(self.predictions))
        save_figures(self.plot_predictions(), place / "figures")

    def __repr__(self) -> str:
        return "\n\n".join(map(as_text, self.predictions))

    def _repr_html_(self) -> str:
        title = f"Prediction of {len(self.predictions)} wheel bias(es)"
        return html_of(title, self.warnings, self.summary().head(_SHOWN))


@dataclass(frozen=True, eq=False, repr=False)
class PlanResult:
    """Wheel biases ranked by what they teach of a quantity."""

    plan: Plan
    learned: Learned
    top: int = TOP
    warnings: tuple[str, ...] = ()  # sentences about anything that makes the draws doubtful
    converged: bool = True  # whether the fit had

    def summary(self) -> pd.DataFrame:
        """One row per candidate, most informative first: end rates, nats, sd after, cost."""
        names = [f"{name}_end_rpm" for name in self.plan.wheel_names]
        rows = [
            {
                **dict(zip(names, candidate.end_rpm, strict=True)),
                "information_nats": candidate.information_nats,
                "sd_before": self.plan.sd_before,
                "sd_after": candidate.sd_after,
                "hydrazine_g": candidate.hydrazine_g,
                "duration_s": candidate.duration_s,
            }
            for candidate in self.plan.candidates
        ]
        return with_interval(pd.DataFrame(rows), "standard deviations, in the quantity's unit")

    def plot_plan(self) -> Figure:
        """Information against hydrazine, with the candidates that no other beats in both."""
        from cassini_bayes.report.plots import draw
        from cassini_bayes.report.plots.prediction import plan_figure

        return draw({"plan": partial(plan_figure, self.plan)})["plan"]

    def as_record(self) -> dict[str, Any]:
        """Everything as plain JSON types."""
        return _standing(self) | plan_dictionary(self.plan, self.top)

    def save(self, folder: PathLike) -> None:
        """Write ``plan.csv`` and its figure."""
        from cassini_bayes.report.plots import save_figures

        write_text(Path(folder) / "plan.csv", plan_csv(self.plan))
        save_figures({"plan": self.plot_plan()}, Path(folder))

    def __repr__(self) -> str:
        return plan_text(self.plan, self.top)

    def _repr_html_(self) -> str:
        plan = self.plan
        title = f"Plan for {plan.quantity}: {plan.mean:.4g} ± {plan.sd_before:.2g} before"
        return html_of(title, self.warnings, self.summary().head(self.top))


@dataclass(frozen=True, eq=False, repr=False)
class CheapestResult:
    """The end rates that cost least."""

    found: CheapestBias
    throughput: tuple[Throughput, ...]
    learned: Learned
    warnings: tuple[str, ...] = ()  # sentences about anything that makes the draws doubtful
    converged: bool = True  # whether the fit had

    def as_record(self) -> dict[str, Any]:
        """Everything as plain JSON types."""
        return _standing(self) | cheapest_dictionary(self.found, self.throughput)

    def save(self, folder: PathLike) -> None:
        """Write ``plan.json``: everything as plain JSON types."""
        write_text(Path(folder) / "plan.json", json.dumps(self.as_record(), indent=1) + "\n")

    def __repr__(self) -> str:
        return cheapest_text(self.found, self.throughput)


def _standing(result: PredictionResult | PlanResult | CheapestResult) -> dict[str, Any]:
    """Whether a result may be used, for its record."""
    return {"converged": result.converged, "warnings": list(result.warnings)}


def doubts(learned: Learned, within: Sequence[str], fit: Fit) -> tuple[str, ...]:
    """Sentences about anything that makes the draws doubtful, the worst last.

    Few effective draws where the weights join physics and firing logic; effects of the fit that act
    ``within`` an event, which no prediction has; what the fit itself says of its draws.
    """
    said = []
    if learned.effective_draws < FEW_DRAWS:
        said.append(
            f"physics and firing logic share only {learned.effective_draws:.0f} effective draws: "
            "intervals are rough; check that the events are like one another"
        )
    if within:
        said.append(
            f"predicted without {', '.join(within)}, which the fit has: it acts from row to row of "
            "an event, and the totals of a planned one do not have rows"
        )
    said += [f"the fit: {sentence}" for sentence in fit_warnings(fit)]
    if not stop_rule_held(fit):
        said.append(
            "NOT CONVERGED: what was predicted is no result yet; give the command that "
            "made the fit --resume and a larger --max-steps"
        )
    return tuple(said)


def beyond_trend(predictions: Sequence[Prediction], learned: Learned) -> tuple[str, ...]:
    """A sentence for every bias so far from the events that the trend leaves draws no thrust."""
    return tuple(
        f"{own.request.id}: in {_share(own.powerless)} of the draws a thruster has no thrust left "
        f"on {own.epoch.date()}: the trend of the printed thrust does not reach so far (last "
        f"event {learned.last_epoch.date()}), and the intervals mean nothing; give an earlier epoch"
        for own in predictions
        if own.powerless > 0.0
    )


def _share(share: float) -> str:
    """A positive share in whole per cent, never as none."""
    return percent(share) if share >= 0.01 else "less than 1 %"


def predict(
    fit: FitResult | PathLike,
    bias: str | BiasRequest | Iterable[BiasRequest],
    *,
    epoch: str | None = None,
    branch: str | None = None,
    quaternion: str | None = None,
    events: PathLike | None = None,
    priors: PathLike | None = None,
    beliefs: PathLike | None = None,
    effect_files: Sequence[PathLike] = (),
    accept: Sequence[str] = (),
    seed: int = DEFAULT_SEED,
) -> PredictionResult:
    """Predict planned wheel biases: on-times, pulses, ΔV, hydrazine, duration.

    Of a fit of telemetry, the recorded wheel biases teach the firing logic as totals rows do. What
    effects of the fit do to thrust, arms, wheels and torque they do to the planned bias as well.

    Parameters
    ----------
    fit
        A fit, a run's folder or its ``fit.nc``; the folder of a diagnosis whose extended model was
        sampled.
    bias
        ``"rwa1: -1118 -> 626, rwa2: 1290 -> 1300, …"`` in rev/min, the path of a CSV of biases, or
        requests.
    epoch, branch, quaternion
        ISO 8601, UTC (the last event by default); thruster branch; ``q1 q2 q3 q4`` inertial to
        body, for inertial ΔV too.
    events, priors
        Where the fit's files have moved.
    beliefs
        A TOML file of priors of prediction, of those that are others than the package's
        (``prediction/prediction.toml``).
    effect_files
        Files of effects that the fit was given.
    accept
        Mistakes in the data that are none.
    seed
        Same seed, same draws.

    Raises
    ------
    InputError
        A fit without wheel biases; files that have moved; an impossible bias; an id twice or with
        characters that no file name should have.
    """
    seed = check_seed(seed)
    began = time.perf_counter()
    sources, draws, stored = _sources(fit, events, priors, accept, effect_files)
    requests = _requests(sources, bias, epoch, branch, quaternion)
    learned = learn_from_fit(draws, sources, seed, None if beliefs is None else Path(beliefs))
    result = tuple(
        predict_one(learned, request, stream(seed, i)) for i, request in enumerate(requests)
    )
    warnings = (*beyond_trend(result, learned), *doubts(learned, sources.within, stored))
    seconds = time.perf_counter() - began
    return PredictionResult(result, learned, seed, seconds, warnings, stop_rule_held(stored))


def plan(
    fit: FitResult | PathLike,
    quantity: str | None = None,
    *,
    minimise: str | None = None,
    to: str | None = None,
    limit: float | None = None,
    start: str | None = None,
    levels: int | None = None,
    budget: float | None = None,
    top: int | None = None,
    events: PathLike | None = None,
    priors: PathLike | None = None,
    beliefs: PathLike | None = None,
    effect_files: Sequence[PathLike] = (),
    accept: Sequence[str] = (),
    seed: int = DEFAULT_SEED,
) -> PlanResult | CheapestResult:
    """Rank wheel biases by what they teach of a quantity, or find the one that costs least.

    The expected gain on a quantity Q is −½ log(1 − ρ²) nats, ρ the correlation of Q with what the
    bias would show.

    Parameters
    ----------
    fit, events, priors, beliefs, effect_files, accept, seed
        As for :func:`predict`.
    quantity
        ``thrust_level_z1_n``, ``tau_fall_s``, ``cm_x_m`` … (:func:`quantities` lists them).
    minimise
        Instead of a quantity: ``z_throughput`` or ``hydrazine``.
    to, limit
        With ``minimise`` only: end rates that are given, ``"rwa4: -729"``; most on-time a
        thruster, s.
    start
        Rates before the bias, ``"rwa1: -526, …"`` (the last end by default).
    levels, budget, top
        With a quantity only: end rates per wheel and sign (5); most hydrazine, g; how many to show
        (10).

    Raises
    ------
    InputError
        As for :func:`predict`; an unknown quantity; neither or both of quantity and minimise, or
        what belongs to the one that was not asked for.
    """
    if (quantity is None) == (minimise is None):
        raise InputError(
            "plan",
            "either --quantity or --minimise",
            "neither" if quantity is None else "both",
            "write e.g. --quantity thrust_mean_n",
        )
    if quantity is None:
        _refuse_idle("--quantity", {"--levels": levels, "--budget": budget, "--top": top})
    else:
        _refuse_idle("--minimise", {"--to": to, "--limit": limit})
    seed = check_seed(seed)
    sources, draws, stored = _sources(fit, events, priors, accept, effect_files)
    wheels, rates = _start(sources, start)
    learned = learn_from_fit(draws, sources, seed, None if beliefs is None else Path(beliefs))
    warnings = doubts(learned, sources.within, stored)
    converged = stop_rule_held(stored)
    if quantity is not None:
        result = planning.plan(
            learned,
            quantity,
            wheels,
            rates,
            levels=LEVELS if levels is None else levels,
            budget_g=budget,
        )
        return PlanResult(result, learned, TOP if top is None else top, warnings, converged)
    assert minimise is not None
    wanted = {} if to is None else parse_rates(to, sources.model.spacecraft, "--to")
    cheapest = cheapest_bias(learned, minimise, wheels, rates, wanted, stream(seed, 0))
    fitted = read_record(draws, ("observed_data",)) if isinstance(draws, Path) else draws
    observed = fitted.groups["observed_data"]
    throughput = accumulated_throughput(observed, cheapest.prediction, limit)
    return CheapestResult(cheapest, tuple(throughput), learned, warnings, converged)


def _refuse_idle(mode: str, options: Mapping[str, object]) -> None:
    """Refuse options that only ``mode`` reads, where the other was asked for."""
    given = [name for name, value in options.items() if value is not None]
    if given:
        raise InputError(
            given[0], f"{mode} beside it", "a plan of the other kind", f"add {mode}, or drop it"
        )


def _sources(
    fit: FitResult | PathLike,
    events: PathLike | None,
    priors: PathLike | None,
    accept: Sequence[str],
    effect_files: Sequence[PathLike],
) -> tuple[Sources, Path | FitResult, Fit]:
    """What a fit was made of, where its draws are, and what it says of them."""
    if isinstance(fit, FitResult) and fit.path is None:
        return sources_of(fit.model), fit, fit
    path = fit.path if isinstance(fit, FitResult) else Path(fit)
    assert path is not None
    file = path / FIT_FILE if path.is_dir() else path
    extended = path / EXTENDED / FIT_FILE
    file = extended if not file.exists() and extended.exists() else file
    sources = read_sources(
        file,
        None if events is None else str(events),
        None if priors is None else Path(priors),
        accept=accept,
        effect_files=[Path(item) for item in effect_files],
    )
    return sources, file, read_record(file, ("sample_stats",))


def _requests(
    sources: Sources,
    bias: str | BiasRequest | Iterable[BiasRequest],
    epoch: str | None,
    branch: str | None,
    quaternion: str | None,
) -> tuple[BiasRequest, ...]:
    """The planned biases, checked against the fit; options fill in what a request leaves open."""
    spacecraft = sources.model.spacecraft
    result: tuple[BiasRequest, ...]
    if isinstance(bias, BiasRequest):
        result = (bias,)
    elif not isinstance(bias, str | Path):
        result = tuple(bias)
    elif str(bias).endswith(".csv"):
        result = read_requests(Path(bias), spacecraft)
    else:
        result = (parse_bias(str(bias), spacecraft),)
    check_ids(str(bias) if isinstance(bias, str | Path) else "bias", [own.id for own in result])
    when = None if epoch is None else parse_epoch(epoch)
    turned = None if quaternion is None else parse_quaternion(quaternion)
    filled = tuple(
        replace(
            request,
            epoch=request.epoch or when,
            branch=request.branch or branch,
            quaternion=request.quaternion or turned,
        )
        for request in result
    )
    first = min(event.epoch for event in sources.events)
    for request in filled:
        check_request(request, spacecraft, sources.model.branch, sources.wheels, first)
    return filled


def _start(sources: Sources, text: str | None) -> tuple[tuple[int, ...], list[float]]:
    """Prime wheels and their rates before the planned bias."""
    last = max(sources.events, key=lambda event: event.epoch)
    if text is None:
        return last.wheels, [float(rate) for rate in last.rwa_end_rpm]
    rates = parse_rates(text, sources.model.spacecraft, "--from")
    wheels = tuple(sorted(rates))
    for number in wheels:
        if number not in sources.wheels:
            raise InputError(
                "--from",
                f"prime wheels {', '.join(map(str, sources.wheels))}",
                f"wheel {number}",
                "drop it, or plan with a fit in which it is prime",
            )
    return wheels, [rates[number] for number in wheels]
