"""Telemetry that the fitted model would have sent: replicated channels of every event.

At a posterior draw the balance of a row, r = I ω + T I_w ρ − momentum predicted, is normal with the
covariance of the channels' noise, plus the drift of the torque noise and what counters leave open.
A replicated balance r' is drawn, and each channel is moved to where it would have to be for it, the
other one staying as measured: ω' = ω + I⁻¹ (r' − r), ρ' = ρ + (T I_w)⁺ (r' − r). The balance is
that of the report's time series (:mod:`cassini_bayes.results.time_series`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from cassini_bayes.computing.arrays import Array, picked
from cassini_bayes.model.draws import Draws
from cassini_bayes.model.posterior import Model
from cassini_bayes.results.record import Coordinates, labelled
from cassini_bayes.results.time_series import BalanceRows, balances, thinned_draws
from cassini_bayes.spacecraft.units import RAD_S_PER_RPM

REPLICATED_ROWS: Final = 500  # with the draws shown 1.2 MB per event of three wheels
_STORED: Final = np.float32  # six digits finer than any channel's noise


@dataclass(frozen=True)
class Replicates:
    """One event's channels at r rows, measured and replicated at n posterior draws.

    ``rate_rad_s`` (n, r, 3) are body rates given the measured wheel rates, ``wheel_rpm`` (n, r, W)
    wheel rates given the measured body rates; ``wheels`` the wheels' numbers.
    """

    event: str
    time_s: Array
    wheels: tuple[int, ...]
    measured_rate_rad_s: Array
    measured_wheel_rpm: Array
    rate_rad_s: Array
    wheel_rpm: Array


def replicated(balance: BalanceRows, rng: np.random.Generator) -> Replicates:
    """Channels of one event replicated, one replicate per posterior draw of its balance."""
    draws, rows, _ = balance.measured.shape
    factor = np.linalg.cholesky(balance.covariance)
    white = rng.standard_normal((draws, rows, 3)) @ np.swapaxes(factor, -1, -2)
    kicks = rng.standard_normal((draws, balance.drift.shape[1], 3))
    drift = np.sqrt(balance.walk)[:, None, None] * (balance.drift @ kicks)
    change = white + drift + balance.open_momentum(rng) - balance.residual
    event = balance.term.event
    layout = event.statistics.layout
    first = len(layout.vector)
    scalar = balance.rows.scalar
    rate = scalar[:, layout.rate.start - first : layout.rate.stop - first]
    wheel = scalar[:, layout.wheel.start - first : layout.wheel.stop - first]
    to_rate, to_wheel = np.linalg.inv(balance.by_rate), np.linalg.pinv(balance.by_wheel)
    return Replicates(
        event.id,
        balance.rows.time_s,
        layout.wheels,
        rate,
        wheel / RAD_S_PER_RPM,
        rate + change @ np.swapaxes(to_rate, -1, -2),
        (wheel + change @ np.swapaxes(to_wheel, -1, -2)) / RAD_S_PER_RPM,
    )


def channel_replicates(
    model: Model,
    z: Array,
    draws: Draws,
    chain_length: int,
    coordinates: Coordinates,
    rng: np.random.Generator,
) -> Mapping[str, xr.Dataset]:
    """Replicated and measured channels of the telemetry events, at the draws of the figures.

    Parameters
    ----------
    z, draws
        All posterior draws, (n, d), chain after chain of ``chain_length``.
    coordinates
        Labels of ``event``, ``wheel`` and ``axis``; events and wheels that an event has no channels
        of are NaN, and so are the places after the last row of a short event.

    Returns
    -------
    Additions to the groups ``posterior_predictive`` and ``observed_data``; none without telemetry.
    """
    shown = thinned_draws(len(z))
    rows = balances(model, z[shown], picked(draws, shown), REPLICATED_ROWS)
    events = [replicated(row, rng) for row in rows]
    if not events:
        return {}
    return channel_datasets(events, coordinates, model.wheels, np.divmod(shown, chain_length))


def channel_datasets(
    events: Sequence[Replicates],
    coordinates: Coordinates,
    wheels: Sequence[int],
    origin: tuple[Array, Array],
) -> dict[str, xr.Dataset]:
    """Channels of all events together; ``origin``: chain and draw of every replicate."""
    labels = list(coordinates["event"])
    n, most = len(origin[0]), max(len(event.time_s) for event in events)
    time = np.full((len(labels), most), np.nan)
    rate = np.full((n + 1, len(labels), most, 3), np.nan, dtype=_STORED)
    wheel = np.full((n + 1, len(labels), most, len(wheels)), np.nan, dtype=_STORED)
    for event in events:
        place, rows = labels.index(event.event), len(event.time_s)
        columns = [list(wheels).index(number) for number in event.wheels]
        time[place, :rows] = event.time_s
        rate[0, place, :rows], rate[1:, place, :rows] = event.measured_rate_rad_s, event.rate_rad_s
        wheel[0, place, :rows, columns] = event.measured_wheel_rpm.T
        wheel[1:, place, :rows, columns] = np.moveaxis(event.wheel_rpm, -1, 0)
    shared: dict[str, object] = {name: coordinates[name] for name in ("event", "wheel", "axis")}
    shared |= {"time_s": labelled(("event", "sample"), time, "s", "time since the event's epoch")}
    replicate = ("replicate",)
    own = {
        f"replicate_{what}": labelled(replicate, places, "1", f"{what} of the posterior draw")
        for what, places in zip(("chain", "draw"), origin, strict=True)
    }
    replicated = _channels(rate[1:], wheel[1:], "replicated", replicate, {**shared, **own})
    measured = _channels(rate[0], wheel[0], "measured", (), shared)
    return {"posterior_predictive": replicated, "observed_data": measured}


def _channels(
    rate: NDArray[np.float32],
    wheel: NDArray[np.float32],
    what: str,
    first: tuple[str, ...],
    coordinates: Mapping[str, object],
) -> xr.Dataset:
    given = {"rate": "", "wheel": ""}
    if first:
        given = {"rate": ", given the wheel rates", "wheel": ", given the body rates"}
    rates = f"{what} body rates, body axes, at rows of the momentum balance{given['rate']}"
    wheels = f"{what} wheel rates at rows of the momentum balance{given['wheel']}"
    return xr.Dataset(
        {
            "rate_rad_s": labelled((*first, "event", "sample", "axis"), rate, "rad s-1", rates),
            "rwa_rpm": labelled((*first, "event", "sample", "wheel"), wheel, "rpm", wheels),
        },
        coords=dict(coordinates),
    )
