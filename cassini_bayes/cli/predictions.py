"""`predict` and `plan`: the next wheel bias."""

from __future__ import annotations

import json
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cassini_bayes.cli.options import Json, Quiet, Seed
from cassini_bayes.errors import InputError

if TYPE_CHECKING:
    from cassini_bayes.prediction.learning import Learned
    from cassini_bayes.prediction.planning import Plan
    from cassini_bayes.prediction.predict import Prediction
    from cassini_bayes.prediction.requests import BiasRequest
    from cassini_bayes.prediction.sources import Sources

Fit = Annotated[Path, typer.Option("--fit", help="fit.nc of a run (its folder says the rest).")]
Events = Annotated[
    str | None, typer.Option("--events", help="Totals CSV of the fit, if it has moved.")
]
PriorsFile = Annotated[
    Path | None, typer.Option("--priors", help="Priors file of the fit, if it has moved.")
]


def predict_command(
    fit: Fit,
    bias: Annotated[
        str,
        typer.Option(
            "--bias",
            help='"rwa1: -1118 -> 626, rwa2: 1290 -> 1300, …" in rev/min, or a CSV of biases.',
        ),
    ],
    epoch: Annotated[
        str | None, typer.Option("--epoch", help="ISO 8601, UTC (default: the last event).")
    ] = None,
    branch: Annotated[str | None, typer.Option("--branch", help="Thruster branch.")] = None,
    quaternion: Annotated[
        str | None,
        typer.Option("--quaternion", help="q1 q2 q3 q4, inertial to body: inertial ΔV too."),
    ] = None,
    simulate: Annotated[
        bool, typer.Option("--simulate", help="Fly it in closed loop too, and compare.")
    ] = False,
    simulations: Annotated[int, typer.Option("--simulations", min=1)] = 8,
    out: Annotated[
        Path | None, typer.Option("--out", help="Folder for prediction.json, .csv and figures.")
    ] = None,
    events: Events = None,
    priors: PriorsFile = None,
    seed: Seed = 1,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Predict planned wheel biases: on-times, pulses, ΔV, hydrazine, duration."""
    from cassini_bayes.prediction.predict import predict
    from cassini_bayes.prediction.sources import learn_from_fit, read_sources

    began = time.perf_counter()
    sources = read_sources(fit, events, priors)
    requests = _requests(sources, bias, epoch, branch, quaternion)
    learned = learn_from_fit(fit, sources, seed)
    _warn(learned)
    predictions = [
        predict(learned, request, _stream(seed, i)) for i, request in enumerate(requests)
    ]
    seconds = time.perf_counter() - began
    results = [_as_result(learned, p, simulations if simulate else 0, seed) for p in predictions]
    document: dict[str, Any] = {"seconds": round(seconds, 3), "seed": seed, "biases": results}
    if out is not None:
        _write(out, predictions, document)
    if as_json:
        typer.echo(json.dumps(document))
    elif not quiet:
        typer.echo("\n\n".join(_text(p, r) for p, r in zip(predictions, results, strict=True)))
        typer.echo(f"\nanswered in {seconds:.2f} s", err=True)


def plan_command(
    fit: Fit,
    quantity: Annotated[
        str, typer.Option("--quantity", help="E.g. thrust_level_z1_n, tau_fall_s, cm_x_m.")
    ],
    start: Annotated[
        str | None,
        typer.Option("--from", help='Rates before the bias, "rwa1: -526, …" (default: last end).'),
    ] = None,
    levels: Annotated[
        int, typer.Option("--levels", min=1, max=12, help="End rates per wheel and sign.")
    ] = 5,
    budget: Annotated[
        float | None, typer.Option("--budget", min=0.0, help="Most hydrazine, g.")
    ] = None,
    top: Annotated[int, typer.Option("--top", min=1, help="How many to show.")] = 10,
    out: Annotated[Path | None, typer.Option("--out", help="Folder for plan.csv, figure.")] = None,
    events: Events = None,
    priors: PriorsFile = None,
    seed: Seed = 1,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Rank wheel biases by what they would teach about a quantity, with their hydrazine."""
    from cassini_bayes.prediction.planning import plan, plan_csv, plan_dictionary, plan_text
    from cassini_bayes.prediction.sources import learn_from_fit, read_sources

    sources = read_sources(fit, events, priors)
    wheels, rates = _start(sources, start)
    learned = learn_from_fit(fit, sources, seed)
    _warn(learned)
    found = plan(learned, quantity, wheels, rates, levels=levels, budget_g=budget)
    if out is not None:
        from cassini_bayes.files.storage import write_text

        write_text(out / "plan.csv", plan_csv(found))
        _save_plan_figure(found, out)
    if as_json:
        typer.echo(json.dumps(plan_dictionary(found, top)))
    elif not quiet:
        typer.echo(plan_text(found, top))


def _warn(learned: Learned) -> None:
    """Say so when the weights that join physics and firing logic leave few effective draws."""
    from cassini_bayes.prediction.learning import FEW_DRAWS

    if learned.effective_draws < FEW_DRAWS:
        typer.echo(
            f"warning: physics and firing logic share only {learned.effective_draws:.0f} effective "
            "draws: intervals are rough; check that the events are like one another",
            err=True,
        )


def _stream(seed: int, row: int) -> Any:
    import numpy as np

    return np.random.default_rng(np.random.SeedSequence((seed, 1, row)))


def _requests(
    sources: Sources, bias: str, epoch: str | None, branch: str | None, quaternion: str | None
) -> tuple[BiasRequest, ...]:
    """The planned biases, checked against the fit; options fill in what a CSV leaves open."""
    from cassini_bayes.prediction.requests import (
        check_request,
        parse_bias,
        parse_epoch,
        parse_quaternion,
        read_requests,
    )

    spacecraft = sources.model.spacecraft
    if bias.endswith(".csv"):
        found = read_requests(Path(bias), spacecraft)
    else:
        found = (parse_bias(bias, spacecraft),)
    when = None if epoch is None else parse_epoch(epoch)
    turned = None if quaternion is None else parse_quaternion(quaternion)
    filled = tuple(
        replace(
            request,
            epoch=request.epoch or when,
            branch=request.branch or branch,
            quaternion=request.quaternion or turned,
        )
        for request in found
    )
    first = min(event.epoch for event in sources.events)
    for request in filled:
        check_request(request, spacecraft, sources.model.branch, sources.priors.wheels, first)
    return filled


def _start(sources: Sources, text: str | None) -> tuple[tuple[int, ...], list[float]]:
    """Prime wheels and their rates before the planned bias."""
    from cassini_bayes.prediction.requests import parse_rates

    last = max(sources.events, key=lambda event: event.epoch)
    if text is None:
        return last.wheels, [float(rate) for rate in last.rwa_end_rpm]
    rates = parse_rates(text, sources.model.spacecraft, "--from")
    wheels = tuple(sorted(rates))
    for number in wheels:
        if number not in sources.priors.wheels:
            raise InputError(
                "--from",
                f"prime wheels {', '.join(map(str, sources.priors.wheels))}",
                f"wheel {number}",
                "drop it, or plan with a fit in which it is prime",
            )
    return wheels, [rates[number] for number in wheels]


def _as_result(
    learned: Learned, prediction: Prediction, simulations: int, seed: int
) -> dict[str, Any]:
    from cassini_bayes.prediction.summary import as_dictionary

    result = as_dictionary(prediction)
    if simulations:
        from cassini_bayes.studies.closed_loop import simulate_request

        flown = simulate_request(learned, prediction.request, simulations, seed)
        first = [unit[0] for unit in prediction.units]
        result["closed_loop"] = {
            f"{kind}_{name}": {"unit": unit, "mean": mean, "sd": sd}
            for kind, unit, values in (
                ("on_time", "s", flown.on_time_s[:, first]),
                ("pulses", "count", flown.pulses[:, first]),
            )
            for name, mean, sd in zip(
                prediction.unit_names(),
                values.mean(0).tolist(),
                values.std(0).tolist(),
                strict=True,
            )
        } | {"simulations": len(flown.duration_s), "duration_s": float(flown.duration_s.mean())}
    return result


def _text(prediction: Prediction, result: dict[str, Any]) -> str:
    from cassini_bayes.prediction.summary import as_text

    text = as_text(prediction)
    flown = result.get("closed_loop")
    if flown is not None:
        rows = [
            f"{name:<28} {value['mean']:>9.2f}  ± {value['sd']:.2f} {value['unit']}"
            for name, value in flown.items()
            if isinstance(value, dict)
        ]
        head = f"closed loop, {flown['simulations']} flights: mean ± standard deviation"
        text = "\n".join([text, head, *rows])
    return text


def _write(folder: Path, predictions: list[Prediction], document: dict[str, Any]) -> None:
    from cassini_bayes.files.storage import write_text
    from cassini_bayes.prediction.summary import as_csv
    from cassini_bayes.report.plots import save_figures
    from cassini_bayes.report.plots.prediction import prediction_figure

    write_text(folder / "prediction.json", json.dumps(document, indent=1) + "\n")
    write_text(folder / "prediction.csv", as_csv(predictions))
    figures = {p.request.id: prediction_figure(p) for p in predictions}
    save_figures(figures, folder / "figures")


def _save_plan_figure(found: Plan, folder: Path) -> None:
    from cassini_bayes.report.plots import save_figures
    from cassini_bayes.report.plots.prediction import plan_figure

    save_figures({"plan": plan_figure(found)}, folder)
