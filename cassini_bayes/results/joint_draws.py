"""Draws of everything in a joint model of telemetry and totals, and their densities per event."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cassini_bayes.balance.computed_delta_v import draw_software
from cassini_bayes.balance.measured_delta_v import DeltaVStatistics, delta_v_information
from cassini_bayes.balance.physics import Physics
from cassini_bayes.balance.telemetry_terms import INITIAL_SD_N_M_S
from cassini_bayes.model.posterior import (
    Model,
    collapse,
    draw,
    full_parameters,
    physics_at,
    system_of,
)
from cassini_bayes.model.predictive import event_log_likelihood
from cassini_bayes.model.thrusts import (
    LinearDraws,
    ThrustDraws,
    draw_torque,
    moments_of,
)
from cassini_bayes.model.totals import linear_system
from cassini_bayes.results.record import prior_software, prior_thrusts
from cassini_bayes.spacecraft import thruster_directions

Array = NDArray[np.float64]
BATCH: Final = 1_000  # points worked up at a time: normal equations take 10 kB each


@dataclass(frozen=True)
class Draws:
    """One draw of everything per parameter point.

    ``parameters`` are the walked and fixed ones; ``thrusts`` those of the events that fire (None
    without any), ``torque_n_m`` (n, E, 3) of all events, totals rows first; ``own`` per telemetry
    event the initial momentum (3), the torque (3) and the cut tails (not in a prior sample).
    """

    parameters: Mapping[str, Array | float]
    thrusts: ThrustDraws | None
    torque_n_m: Array
    own: tuple[Array, ...]
    software: Array

    @property
    def size(self) -> int:
        """Number of draws n."""
        return len(self.torque_n_m)

    def at(self, places: NDArray[np.int64]) -> Draws:
        """Some of the draws, by their places among the n."""
        thrusts = self.thrusts
        if thrusts is not None:
            every = (thrusts.thrust_n, thrusts.common_n, thrusts.level_n)
            thrusts = ThrustDraws(*(values[places] for values in every))
        return Draws(
            {
                name: values[places] if isinstance(values, np.ndarray) else values
                for name, values in self.parameters.items()
            },
            thrusts,
            self.torque_n_m[places],
            tuple(own[places] for own in self.own),
            self.software[places],
        )

    def totals(self, model: Model) -> LinearDraws:
        """The part of the totals rows."""
        assert self.thrusts is not None  # totals rows fire
        assert model.totals is not None
        rows = len(model.totals.stack.event_ids)
        return LinearDraws(
            self.thrusts.thrust_n[:, :rows],
            self.thrusts.common_n,
            self.thrusts.level_n,
            self.torque_n_m[:, :rows],
            self.software,
        )


def batches(n: int) -> Iterator[slice]:
    """Slices of at most ``BATCH`` points that cover n of them."""
    for start in range(0, n, BATCH):
        yield slice(start, min(start + BATCH, n))


def draw_all(model: Model, z: Array, rng: np.random.Generator) -> Draws:
    """Draw thrusts, torques, initial momenta and cut tails from their exact conditional at z."""
    parts = [_draw_batch(model, z[rows], rng) for rows in batches(len(z))]
    return Draws(
        parameters=model.space.to_parameters(z),
        thrusts=None if parts[0].thrusts is None else _joined([p.thrusts for p in parts]),
        torque_n_m=np.concatenate([p.torque_n_m for p in parts]),
        own=tuple(np.concatenate(own) for own in zip(*(p.own for p in parts), strict=True)),
        software=np.concatenate([p.software for p in parts]),
    )


def _joined(parts: list[ThrustDraws | None]) -> ThrustDraws:
    found = [part for part in parts if part is not None]
    return ThrustDraws(
        np.concatenate([part.thrust_n for part in found]),
        np.concatenate([part.common_n for part in found]),
        np.concatenate([part.level_n for part in found]),
    )


def _draw_batch(model: Model, z: Array, rng: np.random.Generator) -> Draws:
    draws = draw(model, collapse(model, z), rng)
    torques = [own[:, None, 3:6] for own in draws.own]
    software = np.zeros((len(z), 2))
    if model.totals is not None:
        assert draws.thrusts is not None  # totals rows fire
        system = linear_system(model.totals, full_parameters(model, z))
        rows = len(model.totals.stack.event_ids)
        torque = draw_torque(model.totals, system, draws.thrusts.thrust_n[:, :rows], rng)
        torques.insert(0, torque)
        if model.totals.computed is not None:
            software = draw_software(model.totals.computed, system.delta_v_variance, rng)
    return Draws({}, draws.thrusts, np.concatenate(torques, axis=1), draws.own, software)


def prior_sample(model: Model, n: int, rng: np.random.Generator) -> Draws:
    """Everything drawn from its prior, before any data."""
    parameters = model.space.to_parameters(model.space.sample(rng, n))
    thrusts = None
    if model.fired_ids:
        thrusts = prior_thrusts(model.thrust_prior, parameters, (n, len(model.fired_ids)), rng)
    normals = rng.standard_normal((n, len(model.event_ids), 3))
    torque = model.torque_mean_n_m + model.torque_sd_n_m * normals
    rows = len(model.event_ids) - len(model.telemetry)
    own = []
    for place, terms in enumerate(model.telemetry):
        start = terms.initial_mean_n_m_s + INITIAL_SD_N_M_S * rng.standard_normal((n, 3))
        own.append(np.concatenate([start, torque[:, rows + place]], axis=1))
    software = np.zeros((n, 2)) if model.totals is None else prior_software(model.totals, n, rng)
    return Draws(parameters, thrusts, torque, tuple(own), software)


def thrust_places(model: Model) -> list[int]:
    """Place among all events of every event with thrusts."""
    ids = list(model.event_ids)
    return [ids.index(name) for name in model.fired_ids]


def event_log_density(model: Model, z: Array, sample: Draws) -> Array:
    """Log density (n, E) of each event's data given everything, its thrusts and torque included.

    The torque noise of telemetry is integrated out: it has no value of its own in the fit.
    """
    found = [_log_likelihood_batch(model, z, sample, rows) for rows in batches(len(z))]
    return np.concatenate(found)


def _log_likelihood_batch(model: Model, z: Array, sample: Draws, rows: slice) -> Array:
    full = full_parameters(model, z[rows])
    columns: list[Array] = []
    place = 0
    if model.totals is not None:
        totals = sample.totals(model)
        part = LinearDraws(
            totals.thrust_n[rows],
            totals.common_n[rows],
            totals.level_n[rows],
            totals.external_torque_n_m[rows],
            totals.software[rows],
        )
        density = event_log_likelihood(model.totals, full, part)
        columns.extend(density.T)
        place = density.shape[1]
    physics = physics_at(model, full) if model.telemetry else None
    for terms, own in zip(model.telemetry, sample.own, strict=True):
        assert physics is not None  # there is telemetry
        system = system_of(model, terms, physics, full)
        unknowns = [-own[rows], np.ones((len(own[rows]), 1))]
        if terms.fires:
            assert sample.thrusts is not None  # the event fires
            unknowns.insert(0, -sample.thrusts.thrust_n[rows, place])
            place += 1
        vector = np.concatenate(unknowns, axis=1)
        square = np.einsum("ni,nij,nj->n", vector, system.normal, vector)
        density = system.log_scale - 0.5 * square
        for own_delta_v in model.delta_v:
            if own_delta_v.event_id == terms.id:
                thrust_n = -vector[:, : terms.pattern.thrusters]
                density = density + _delta_v_density(model, own_delta_v, physics, full, thrust_n)
        columns.append(density)
    return np.stack(columns, axis=1)


def _delta_v_density(
    model: Model,
    statistics: DeltaVStatistics,
    physics: Physics,
    full: Mapping[str, Array],
    thrust_n: Array,
) -> Array:
    """Log density (n,) of a burn's velocity changes at its thrusts (n, K), the offset unknown."""
    directions = thruster_directions(model.spacecraft, model.branch)
    reference = np.zeros(len(thrust_n))
    matrix, vector, constant = delta_v_information(statistics, physics, directions, full, reference)
    square = np.einsum("nk,nkl,nl->n", thrust_n, matrix, thrust_n)
    return np.asarray(constant + (vector * thrust_n).sum(-1) - 0.5 * square)


def thrust_moments_of(model: Model, z: Array) -> tuple[Array, Array]:
    """Conditional mean and variance (n, E, K) of the thrusts given the walked parameters z."""
    found = []
    for rows in batches(len(z)):
        collapsed = collapse(model, z[rows])
        assert collapsed.thrusts is not None  # asked for where events fire
        found.append(moments_of(model.thrust_prior, collapsed.thrusts, collapsed.common_n))
    return np.concatenate([f[0] for f in found]), np.concatenate([f[1] for f in found])
