"""The report of a trend: one HTML page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

from cassini_bayes.files.storage import write_text
from cassini_bayes.model.mission.mission_file import MissionTable
from cassini_bayes.model.mission.model import USED_FACTOR
from cassini_bayes.report.cells import Cell, Column, Table, flagged, tabulate
from cassini_bayes.report.plots import Figure
from cassini_bayes.report.templating import rendered, svg_address
from cassini_bayes.results.mission.fitting import MissionFit, describe
from cassini_bayes.results.mission.trend import Trend, proportional_odds

DECISIVE: Final = 3.0
"""Nats from which odds decide, some 20 to 1."""
ONSET_SHOWN: Final = 0.02
"""Probability of a loss above which the table says when it would have begun."""

CAPTIONS: Final[Mapping[str, str]] = {
    "thrust": "thrust of every thruster in every event, mean and central 90 %, against the date; "
    "filled where it was on for more than 5 s.",
    "normalised": "the same at the reference pressure: what is left is health.",
    "losses": "probability that a thruster has lost thrust, and at which event the loss began.",
}


def write_trend_report(
    page: Path,
    name: str,
    fit: MissionFit,
    mission: MissionTable,
    trend: Trend,
    figures: Mapping[str, Figure],
    made: str,
) -> None:
    """Write the page, atomically."""
    html = rendered(
        "trend.html.jinja",
        name=name,
        sentences=sentences_of(fit, mission, trend),
        tables=tables_of(mission, trend),
        pictures=[(_caption(item), svg_address(figure)) for item, figure in figures.items()],
        made=made,
    )
    write_text(page, html)


def _caption(name: str) -> str:
    """What a figure ``<what>_<branch>`` shows, for those who see it and those who do not."""
    what, _, branch = name.partition("_")
    return f"Branch {branch}: {CAPTIONS[what]}"


def sentences_of(fit: MissionFit, mission: MissionTable, trend: Trend) -> list[str]:
    """The result of a mission in a few sentences."""
    alarms = trend.health[trend.health["alarm"]]
    result = [
        f"{len(fit.model.circumstances.events)} events. "
        + (
            "Alarm: "
            + "; ".join(
                f"{row['branch']}.{row['thruster']} has lost {row['lost_share']:.0%} of its thrust "
                f"with probability {row['failing']:.3f}, from {row['onset_event']} on (90 % "
                f"{row['onset_first']} to {row['onset_last']})"
                for _, row in alarms.iterrows()
            )
            + "."
            if len(alarms)
            else f"No alarm: no thruster has lost thrust with a probability above "
            f"{mission.trend.alarm:g}."
        )
    ]
    if mission.pressure is None:
        result.append(
            "No tank pressure is given: levels are as if the pressure had stayed, and the common "
            "drift holds what pressure did."
        )
    odds = proportional_odds(fit.model, trend.draws.z)
    if mission.pressure is not None and odds is not None:
        result.append(
            f"Thrust in proportion to pressure against an affine law: {odds:+.1f} nats"
            + (" (undecided)." if abs(odds) < DECISIVE else ".")
        )
    for branch, draws in trend.draws.branches.items():
        slope = draws.slope
        result.append(
            f"Mean slope of branch {branch}, losses not counted: "
            + f"{1e3 * slope.mean():+.0f} ± ".replace("-", "−")
            + f"{1e3 * slope.std():.0f} mN a year (± sd), below zero with probability "
            f"{(slope < 0).mean():.2f}."
        )
    if USED_FACTOR in fit.model.space.names:
        result.append(
            "The hydrazine used was computed from thrust: pressures of the blowdown law and drifts "
            "repeat an assumed thrust, so a factor on that mass is inferred with the rest."
        )
    result.append(
        f"Importance draws about {describe(fit.model, fit.references)}: log evidence "
        f"{fit.log_evidence_total:.2f} ± {fit.log_evidence_se:.2f}, Pareto k̂ {fit.pareto_k:.2f}, "
        f"efficiency {fit.efficiency:.0%}" + ("." if fit.converged else ": NOT CONVERGED.")
    )
    return result


def tables_of(mission: MissionTable, trend: Trend) -> Sequence[Table]:
    """Health and forecast as the page shows them."""
    degraded = {
        f"P(> {100 * share:g} %)": _probability(f"degraded_{100 * share:g}_percent")
        for share in mission.trend.degraded
    }
    health = tabulate(
        trend.health,
        {
            "thruster": lambda row: f"{row['branch']}.{row['thruster']}",
            "change since the first event (central 90 %)": lambda row: (
                f"{-100 * row['loss_share']:+.1f} % ({-100 * row['loss_high_share']:+.1f} to "
                f"{-100 * row['loss_low_share']:+.1f})"
            ).replace("-", "−"),
            **degraded,
            "change a year [mN, ± sd]": lambda row: (
                f"{1e3 * row['rate_n_per_year']:+.1f} ± {1e3 * row['rate_sd_n_per_year']:.1f}"
            ).replace("-", "−"),
            "P(falls)": _probability("falls"),
            "P(loss)": lambda row: flagged(f"{row['failing']:.3f}", row["alarm"]),
            "onset (central 90 %)": lambda row: (
                Cell(f"{row['onset_event']} ({row['onset_first']} – {row['onset_last']})", "wrap")
                if row["failing"] > ONSET_SHOWN
                else Cell("–", "muted")
            ),
            "one more bias [nats]": lambda row: f"{row['next_bias_nats']:.1f}",
        },
        title="Health of every thruster",
    )
    if not len(trend.forecast):
        return [health]
    forecast = tabulate(
        trend.forecast,
        {
            "date": lambda row: str(row["epoch"])[:10],
            "thruster": lambda row: f"{row['branch']}.{row['thruster']}",
            "pressure [kPa]": lambda row: (
                Cell("–", "muted") if mission.pressure is None else f"{row['pressure_kpa']:.0f}"
            ),
            "thrust [N, ± sd]": lambda row: f"{row['thrust_n']:.3f} ± {row['thrust_sd_n']:.3f}",
            "central 90 %": lambda row: f"{row['thrust_low_n']:.3f} to {row['thrust_high_n']:.3f}",
        },
        title="Forecast",
    )
    return [health, forecast]


def _probability(column: str) -> Column:
    return lambda row: f"{row[column]:.3f}"
