"""A fitted mission in files: ``trend.nc``, and the draws that later events go on from."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Final

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from cassini_bayes.files.checkpoint import CheckpointStore
from cassini_bayes.files.storage import write_bytes
from cassini_bayes.model.mission.losses import Loss, LossPrior
from cassini_bayes.model.mission.model import MissionModel
from cassini_bayes.results.mission.fitting import EarlierDraws, MissionFit, weighed_losses
from cassini_bayes.results.mission.groups import walked_draws
from cassini_bayes.results.mission.trend import Trend
from cassini_bayes.results.record import labelled

STATE: Final = "draws"
Kept = Mapping[str, NDArray[np.generic]]


def save_trend(fit: MissionFit, trend: Trend, path: Path) -> None:
    """Write ``trend.nc``: the draws of :func:`trend_draws`."""
    posterior = trend_draws(fit, trend)
    attributes = {
        "log_evidence": fit.log_evidence_total,
        "log_evidence_se": fit.log_evidence_se,
        "pareto_k": fit.pareto_k,
    }
    tree = xr.DataTree.from_dict({"/": xr.Dataset(attrs=attributes), "/posterior": posterior})
    write_bytes(path, bytes(tree.to_netcdf(engine="h5netcdf")))


def trend_draws(fit: MissionFit, trend: Trend) -> xr.Dataset:
    """Thrusts of all events with their branch, and what was walked: dims (chain, draw, ...).

    ``thrust_n[event, thruster]`` has the coordinate ``branch`` on its events, and NaN where a
    thruster is not of the event's branch.
    """
    branches = trend.draws.branches
    names = list(dict.fromkeys(n for branch in branches.values() for n in branch.thrusts.thrusters))
    events = fit.model.circumstances.events
    shape = (1, len(fit.z), len(events), len(names))
    thrust, level = np.full((2, *shape), np.nan)
    for own in branches.values():
        columns = np.array([names.index(name) for name in own.thrusts.thrusters])
        rows, columns = np.ix_(own.thrusts.events, columns)
        thrust[0][:, rows, columns] = own.thrust_n
        level[0][:, rows, columns] = own.level_n
    dims, meaning = ("chain", "draw", "event", "thruster"), "thrust level at the reference pressure"
    data = {
        "thrust_n": labelled(dims, thrust, "N", "thrust in the event"),
        "normalised_thrust_n": labelled(dims, level, "N", meaning),
    }
    return xr.Dataset(
        data | walked_draws(fit.model, trend.draws.z),
        coords={
            "chain": [0],
            "draw": np.arange(len(fit.z)),
            "event": [event.id for event in events],
            "thruster": names,
            "branch": ("event", [event.branch for event in events]),
            "epoch": ("event", [event.epoch.isoformat() for event in events]),
        },
    )


def save_state(fit: MissionFit, digests: Mapping[str, str], store: CheckpointStore) -> None:
    """Keep the draws: the fit of these events, which one of further events goes on from."""
    references = {
        branch: [[loss.thruster, loss.onset] for loss in losses]
        for branch, losses in fit.references.items()
    }
    text = {"references": references, "events": dict(digests), "names": list(fit.model.space.names)}
    store.save(
        STATE,
        {
            "z": fit.z,
            "log_density": fit.log_density,
            "evidence": np.array([fit.log_evidence, fit.log_evidence_se]),
            "quality": np.array([fit.pareto_k, fit.efficiency]),
            "text": np.frombuffer(json.dumps(text).encode(), dtype=np.uint8),
        },
    )


def earlier_draws(digests: Mapping[str, str], store: CheckpointStore) -> EarlierDraws | None:
    """The draws of the same mission with fewer events; None where there are none.

    Its events have to be the first of this mission's, unchanged, and fewer.
    """
    kept = store.load(STATE)
    if kept is None:
        return None
    before, now = _events(kept), list(digests.items())
    if len(before) == len(now) or before != now[: len(before)]:
        return None
    return _draws(kept)


def kept_fit(
    model: MissionModel, prior: LossPrior, digests: Mapping[str, str], store: CheckpointStore
) -> MissionFit | None:
    """The fit of these very events, with the same draws; None where none was kept."""
    kept = store.load(STATE)
    if kept is None or _events(kept) != list(digests.items()):
        return None
    draws = _draws(kept)
    losses = weighed_losses(model, prior, draws.z, draws.references)
    pareto_k, efficiency = kept["quality"].tolist()
    return MissionFit(
        **vars(draws),
        model=model,
        prior=prior,
        pareto_k=pareto_k,
        efficiency=efficiency,
        losses=losses,
    )


def _events(kept: Kept) -> list[tuple[str, str]]:
    """Events that draws were kept of, with their digests."""
    return list(json.loads(kept["text"].tobytes())["events"].items())


def _draws(kept: Kept) -> EarlierDraws:
    text = json.loads(kept["text"].tobytes())
    evidence = np.asarray(kept["evidence"], dtype=np.float64)
    return EarlierDraws(
        names=tuple(text["names"]),
        z=np.asarray(kept["z"], dtype=np.float64),
        log_density=np.asarray(kept["log_density"], dtype=np.float64),
        references={
            branch: tuple(Loss(thruster, onset) for thruster, onset in losses)
            for branch, losses in text["references"].items()
        },
        log_evidence=float(evidence[0]),
        log_evidence_se=float(evidence[1]),
    )
