"""Every thruster of a fitted mission: its thrust over time, its health, what is next."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import pandas as pd
from scipy.stats import gaussian_kde, norm

from cassini_bayes.computing.arrays import Array, joined
from cassini_bayes.model.mission.losses import (
    DrawnLosses,
    Hypothesis,
    draw_losses,
    draw_thrusts_given,
    loss_terms,
)
from cassini_bayes.model.mission.mission_file import ForecastTable, MissionTable, years_between
from cassini_bayes.model.mission.model import INTERCEPT, BranchThrusts, MissionModel
from cassini_bayes.results.mission.fitting import MissionFit, distinct
from cassini_bayes.sampling.warmstart import weighted

INTERVAL: Final = (0.05, 0.95)
LEAST_ON_TIME_S: Final = 5.0
"""On-time from which paper 003 takes an event to have seen a thruster."""


@dataclass(frozen=True)
class BranchDraws:
    """Draws of one branch's thrusts, losses drawn with their probabilities."""

    thrusts: BranchThrusts
    level_n: Array  # (n, E, K) at the reference pressure
    thrust_n: Array  # (n, E, K) in the event
    shared: Array  # (n, q)
    losses: DrawnLosses
    intercept: Array  # (n,)

    def level_at(self, years: float) -> Array:
        """Levels (n, K) at the reference pressure, years after the branch's first event.

        Every loss is counted: the date is one after the last event.
        """
        mean = self.thrusts.common_n + self.shared @ self.thrusts.rows(np.array([years]))[0].T
        lost = self.losses.lost(len(self.thrusts.events), len(self.thrusts.thrusters))[:, -1]
        return np.asarray(mean - self.thrusts.common_n * lost)

    @property
    def slope(self) -> Array:
        """Mean change (n,) of the thrusters' levels in a year, losses not counted, N."""
        first = self.thrusts.levels.shape[1]
        return np.asarray((self.shared[:, first:] @ self.thrusts.ageing.T).mean(-1))


@dataclass(frozen=True)
class MissionDraws:
    """Joint draws of a mission: walked coordinates z (n, d), and each branch's thrusts at them."""

    z: Array
    branches: Mapping[str, BranchDraws]


@dataclass(frozen=True)
class Trend:
    """Tables of a trend; ``draws`` are those that they were made of."""

    thrust: pd.DataFrame  # one row per event and thruster
    health: pd.DataFrame  # one row per thruster
    onsets: pd.DataFrame  # probability of each onset, given that the thruster fails
    forecast: pd.DataFrame
    draws: MissionDraws


def trend_of(
    fit: MissionFit,
    mission: MissionTable,
    on_time_s: Mapping[str, Array],
    rng: np.random.Generator,
) -> Trend:
    """All tables of a trend.

    Parameters
    ----------
    on_time_s
        Event → commanded on-time of each thruster of its branch, (K,).
    """
    draws = draw_branches(fit, rng)
    branches = draws.branches
    return Trend(
        thrust=thrust_table(fit, mission, branches, on_time_s),
        health=health_table(fit, mission, branches),
        onsets=onset_table(fit, branches),
        forecast=forecast_table(fit, mission, branches, rng),
        draws=draws,
    )


def draw_branches(fit: MissionFit, rng: np.random.Generator) -> MissionDraws:
    """As many draws of everything as the fit has: of points, then of every branch's hypotheses."""
    log_weight = np.sum([losses.log_weight for losses in fit.losses], axis=0)
    places = weighted(fit.z, np.broadcast_to(log_weight, (len(fit.z),))).places(rng, len(fit.z))
    z = fit.z[places]
    share = fit.model.space.to_parameters(z)[INTERCEPT] if fit.losses else 0.0
    intercept = np.broadcast_to(np.asarray(share), (len(z),))
    result = {}
    for number, losses in enumerate(fit.losses):
        which = losses.draw_at(places, rng)
        lots = [
            _draw_batch(fit, number, z[rows], which[rows], rng)
            for rows in fit.model.batches(len(z))
        ]
        own = fit.model.branches[number]
        result[losses.branch] = BranchDraws(own, *joined(lots), intercept)
    return MissionDraws(z, result)


def _draw_batch(
    fit: MissionFit,
    number: int,
    z: Array,
    which: Sequence[Hypothesis],
    rng: np.random.Generator,
) -> tuple[Array, Array, Array, DrawnLosses]:
    """Levels, thrusts, shared coefficients and losses of one branch, by its number.

    At points (n, d) with their hypotheses.
    """
    first, back = distinct(z)
    branch = fit.model.at(z[first])[0][number].take(back)
    losses = draw_losses(loss_terms(branch), which, fit.prior.scale, rng)
    shared, thrust = draw_thrusts_given(branch, losses, rng)
    thrusts = branch.thrusts
    lost = losses.lost(len(thrusts.events), len(thrusts.thrusters))
    level = thrusts.common_n * (1.0 - lost) + thrusts.levels_at(shared)
    return level, thrust, shared, losses


def proportional_odds(model: MissionModel, z: Array) -> float | None:
    """Log Bayes factor of the proportional law of pressure against the affine one.

    Posterior over prior density of no intercept (Savage and Dickey), by a kernel estimate from
    draws z (n, d): good to a tenth of a nat near the bulk, a bound far out. None where the
    intercept is fixed.
    """
    space = model.space
    if INTERCEPT not in space.names:
        return None
    place = space.names.index(INTERCEPT)
    none = float(space.distributions[place].standard_of(0.0))
    return float(gaussian_kde(z[:, place]).logpdf(none)[0] - norm.logpdf(none))


def thrust_table(
    fit: MissionFit,
    mission: MissionTable,
    draws: Mapping[str, BranchDraws],
    on_time_s: Mapping[str, Array],
) -> pd.DataFrame:
    """Thrust of every thruster in every event, as flown and at the reference pressure, N.

    ``pressure_kpa`` is NaN where the mission has no tank pressure.
    """
    circumstances = fit.model.circumstances
    pressures = circumstances.tank.pressures_kpa(np.ones(1))[0]
    if mission.pressure is None:
        pressures = np.full_like(pressures, np.nan)
    rows = []
    for branch, branch_draws in draws.items():
        for e, place in enumerate(branch_draws.thrusts.events):
            event = circumstances.events[place]
            for k, thruster in enumerate(branch_draws.thrusts.thrusters):
                thrust, level = branch_draws.thrust_n[:, e, k], branch_draws.level_n[:, e, k]
                on_time = float(on_time_s[event.id][k])
                rows.append(
                    {
                        "event": event.id,
                        "epoch": event.epoch.isoformat(),
                        "branch": branch,
                        "thruster": thruster,
                        "pressure_kpa": float(pressures[place]),
                        "on_time_s": on_time,
                        "saw_it": on_time > LEAST_ON_TIME_S,
                        **_summary("thrust", thrust),
                        **_summary("normalised", level),
                    }
                )
    return pd.DataFrame(rows)


def health_table(
    fit: MissionFit, mission: MissionTable, draws: Mapping[str, BranchDraws]
) -> pd.DataFrame:
    """How each thruster stands: probability of degradation, of a loss, its onset and size, alarm.

    ``degraded_*`` compares the level after the last event with the one of the first, at the same
    pressure. ``next_bias_nats`` is what one more bias like the last ones would add to the log odds
    of a loss if the thruster had lost ten percent from then on.
    """
    branches, _ = fit.model.at(fit.z[:1])
    rows = []
    for branch, losses in zip(branches, fit.losses, strict=True):
        own = draws[losses.branch]
        failing = losses.failing(len(own.thrusts.thrusters))
        events = [fit.model.circumstances.events[i] for i in own.thrusts.events]
        loss = 1.0 - own.level_n[:, -1] / own.level_n[:, 0]
        rate = own.level_at(float(own.thrusts.years[-1]) + 1.0) - own.level_n[:, -1]
        last = loss_terms(branch).square[0, -min(5, len(events)) :]
        gained = 0.5 * 0.1**2 * last.max(0) / min(5, len(events))
        for k, thruster in enumerate(own.thrusts.thrusters):
            onset = losses.onsets(k, len(events))
            first, final = interval_of(onset)
            size = np.where(own.losses.thruster == k, own.losses.share, 0.0).sum(1)
            failed = size[size > 0]
            rows.append(
                {
                    "branch": losses.branch,
                    "thruster": thruster,
                    **{
                        f"degraded_{100 * share:g}_percent": float((loss[:, k] > share).mean())
                        for share in mission.trend.degraded
                    },
                    **_summary("loss", loss[:, k], "share"),
                    **_summary("rate", rate[:, k], "n_per_year"),
                    "falls": float((rate[:, k] < 0).mean()),
                    "failing": float(failing[k]),
                    "alarm": bool(failing[k] > mission.trend.alarm),
                    "onset_event": events[int(np.argmax(onset))].id if onset.any() else "",
                    "onset_first": events[first].id if onset.any() else "",
                    "onset_last": events[final].id if onset.any() else "",
                    "lost_share": float(failed.mean()) if len(failed) else 0.0,
                    "next_bias_nats": float(gained[k]),
                }
            )
    return pd.DataFrame(rows)


def onset_table(fit: MissionFit, draws: Mapping[str, BranchDraws]) -> pd.DataFrame:
    """Probability of every onset given that the thruster fails, where it is not negligible."""
    rows = []
    for losses in fit.losses:
        thrusts = draws[losses.branch].thrusts
        for k, thruster in enumerate(thrusts.thrusters):
            onset = losses.onsets(k, len(thrusts.events))
            rows += [
                {
                    "branch": losses.branch,
                    "thruster": thruster,
                    "event": fit.model.circumstances.events[thrusts.events[e]].id,
                    "probability": float(onset[e]),
                }
                for e in np.flatnonzero(onset > 1e-3)
            ]
    return pd.DataFrame(rows, columns=["branch", "thruster", "event", "probability"])


def forecast_table(
    fit: MissionFit,
    mission: MissionTable,
    draws: Mapping[str, BranchDraws],
    rng: np.random.Generator,
) -> pd.DataFrame:
    """Thrust of every thruster at the dates and pressures that the mission file asks for, N.

    ``pressure_kpa`` is NaN where the mission has no tank pressure: the one asked for says nothing.
    """
    rows = []
    for asked in mission.trend.forecast:
        thrust = forecast(fit, mission, draws[asked.branch], asked, rng)
        names = draws[asked.branch].thrusts.thrusters
        for name, values in zip((*names, "mean"), (*thrust.T, thrust.mean(1)), strict=True):
            rows.append(
                {
                    "epoch": str(asked.epoch),
                    "branch": asked.branch,
                    "pressure_kpa": np.nan if mission.pressure is None else asked.pressure_kpa,
                    "thruster": name,
                    **_summary("thrust", values),
                }
            )
    return pd.DataFrame(rows)


def forecast(
    fit: MissionFit,
    mission: MissionTable,
    own: BranchDraws,
    asked: ForecastTable,
    rng: np.random.Generator,
) -> Array:
    """Draws (n, K) of the thrusts in an event at a date and pressure."""
    first = fit.model.circumstances.events[own.thrusts.events[0]].epoch
    reference = asked.pressure_kpa if mission.pressure is None else mission.pressure.reference_kpa
    relative = asked.pressure_kpa / reference
    scale = own.intercept + (1.0 - own.intercept) * relative
    departures = (
        rng.standard_normal((len(scale), own.thrusts.departures.shape[1]))
        @ own.thrusts.departures.T
    )
    level = own.level_at(years_between(first, asked.epoch))
    return np.asarray(scale[:, None] * level + departures)


def interval_of(probability: Array) -> tuple[int, int]:
    """First and last place of the central 90 % of a discrete distribution."""
    total = np.cumsum(probability)
    first, last = (int(np.searchsorted(total, level * total[-1])) for level in INTERVAL)
    return min(first, len(total) - 1), min(last, len(total) - 1)


def _summary(name: str, values: Array, unit: str = "n") -> dict[str, float]:
    """Mean, standard deviation and central 90 % interval as columns."""
    low, high = np.quantile(values, INTERVAL)
    return {
        f"{name}_{unit}": float(values.mean()),
        f"{name}_sd_{unit}": float(values.std()),
        f"{name}_low_{unit}": float(low),
        f"{name}_high_{unit}": float(high),
    }
