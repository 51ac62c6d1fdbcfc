"""`predict` and `plan`: the next wheel bias."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cassini_bayes.cli.options import Accept, Effects, Output, Plausibility, Seed
from cassini_bayes.files.checks import DEFAULT_SEED

if TYPE_CHECKING:
    from cassini_bayes.pipeline.predictions import PredictionResult
    from cassini_bayes.prediction.predict import Prediction

Fit = Annotated[Path, typer.Option("--fit", help="Folder of a run, or its fit.nc.")]


@dataclass(frozen=True)
class Learning:
    """Options of what is learned from a fit, and the seed of what is drawn with it."""

    events: Annotated[
        str | None, typer.Option("--events", help="Events of the fit, if they have moved.")
    ] = None
    priors: Annotated[
        Path | None, typer.Option("--priors", help="Priors file of the fit, if it has moved.")
    ] = None
    beliefs: Annotated[
        Path | None,
        typer.Option("--beliefs", help="TOML of priors of prediction that are not the package's."),
    ] = None
    effects: Effects = None
    accept: Accept = None
    seed: Seed = DEFAULT_SEED

    @property
    def arguments(self) -> dict[str, Any]:
        """As the verbs of the package take it."""
        named = {"accept": self.accept or [], "effect_files": self.effects or ()}
        files = {"events": self.events, "priors": self.priors, "beliefs": self.beliefs}
        return {**files, "seed": self.seed, **named}


def predict_command(
    fit: Fit,
    bias: Annotated[
        str,
        typer.Option(
            "--bias",
            help='"rwa1: -1118 -> 626, rwa2: 1290 -> 1300, …" in rev/min, or a CSV of biases.',
        ),
    ],
    *,
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
    learning: Learning,
    output: Output,
) -> None:
    """Predict planned wheel biases: on-times, pulses, ΔV, hydrazine, duration."""
    from cassini_bayes.pipeline.predictions import predict

    result = predict(
        fit,
        bias,
        epoch=epoch,
        branch=branch,
        quaternion=quaternion,
        **learning.arguments,
    )
    flown = [_closed_loop(result, weights, simulations) if simulate else {} for weights in result]
    document = result.as_record(flown)
    if out is not None:
        result.save(out, document)
    texts = (_text(p, r) for p, r in zip(result, flown, strict=True))
    output.show(lambda: json.dumps(document), lambda: "\n\n".join(texts))
    if not (output.as_json or output.quiet):
        typer.echo(f"\nanswered in {result.seconds:.2f} s", err=True)
    Plausibility().end(result.warnings, converged=result.converged)


@dataclass(frozen=True)
class Wanted:
    """Options of a plan: what is asked of the next bias, and where it starts."""

    quantity: Annotated[
        str | None, typer.Option("--quantity", help="E.g. thrust_level_z1_n, tau_fall_s, cm_x_m.")
    ] = None
    minimise: Annotated[
        str | None,
        typer.Option("--minimise", help="z_throughput or hydrazine: the cheapest end rates."),
    ] = None
    to: Annotated[
        str | None,
        typer.Option("--to", help='With --minimise: ends that are given, "rwa4: -729".'),
    ] = None
    limit: Annotated[
        float | None, typer.Option("--limit", help="With --minimise: most on-time a thruster, s.")
    ] = None
    start: Annotated[
        str | None,
        typer.Option("--from", help='Rates before the bias, "rwa1: -526, …" (default: last end).'),
    ] = None
    levels: Annotated[
        int | None,
        typer.Option(
            "--levels",
            min=1,
            max=12,
            help="With --quantity: end rates per wheel and sign (default: 5).",
        ),
    ] = None
    budget: Annotated[
        float | None,
        typer.Option("--budget", min=0.0, help="With --quantity: most hydrazine, g."),
    ] = None
    top: Annotated[
        int | None,
        typer.Option("--top", min=1, help="With --quantity: how many to show (default: 10)."),
    ] = None


def plan_command(
    fit: Fit,
    *,
    wanted: Wanted,
    out: Annotated[
        Path | None,
        typer.Option("--out", help="Folder for plan.csv and figure, or plan.json of --minimise."),
    ] = None,
    learning: Learning,
    output: Output,
) -> None:
    """Rank wheel biases by what they teach of a quantity, or find the one that costs least."""
    from cassini_bayes.pipeline.predictions import plan

    result = plan(fit, **vars(wanted), **learning.arguments)
    if out is not None:
        result.save(out)
    output.show(lambda: json.dumps(result.as_record()), lambda: repr(result))
    Plausibility().end(result.warnings, converged=result.converged)


def _closed_loop(found: PredictionResult, own: Prediction, simulations: int) -> dict[str, Any]:
    """The same bias flown in closed loop: means and standard deviations of its flights."""
    from cassini_bayes.studies.closed_loop import simulate_request

    flown = simulate_request(found.learned, own.request, simulations, found.seed)
    first = [unit[0] for unit in own.units]
    means = {
        f"{kind}_{name}": {"unit": unit, "mean": mean, "sd": sd}
        for kind, unit, values in (
            ("on_time", "s", flown.on_time_s[:, first]),
            ("pulses", "count", flown.pulses[:, first]),
        )
        for name, mean, sd in zip(
            own.unit_names(), values.mean(0).tolist(), values.std(0).tolist(), strict=True
        )
    }
    counted = {"simulations": len(flown.duration_s), "duration_s": float(flown.duration_s.mean())}
    return {"closed_loop": means | counted}


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
