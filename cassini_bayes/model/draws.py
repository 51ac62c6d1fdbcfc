"""Draws of everything in a model, walked or integrated out, and the density of data given them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cassini_bayes.balance.computed_delta_v import event_channel_log_likelihood
from cassini_bayes.balance.physics import Parameters, delta_v_variance
from cassini_bayes.computing.arrays import Array, joined, picked
from cassini_bayes.model.posterior import Collapsed, Model, collapse, thrust_factor
from cassini_bayes.model.terms import TORQUE, Points, TermAt, TermDraws
from cassini_bayes.model.thrusts import ThrustDraws, draw_thrusts, prior_thrusts

DrawnTerm = tuple[TermAt, Array, TermDraws]
"""A term at some points, its thrusts there, and what it has of its own."""


@dataclass(frozen=True)
class Draws:
    """One draw of everything per parameter point.

    ``parameters`` are the walked and fixed ones, ``thrusts`` those of the events that fire,
    ``integrated`` per term the nuisances that are integrated out.
    """

    parameters: Parameters
    thrusts: ThrustDraws
    integrated: tuple[TermDraws, ...]

    @property
    def size(self) -> int:
        """Number of draws n."""
        return len(self.thrusts.common_n)

    @property
    def torque_n_m(self) -> Array:
        """Steady external torque (n, E, 3) of all events."""
        return np.concatenate([part[TORQUE] for part in self.integrated], axis=1)


def draw(model: Model, z: Array, rng: np.random.Generator) -> Draws:
    """Draw all that is integrated out from its exact conditional at z (n, d)."""
    parts = [_drawn(model, collapse(model, z[rows]), rng) for rows in model.batches(len(z))]
    return Draws(model.space.to_parameters(z), *joined(parts))


def _drawn(
    model: Model, collapsed: Collapsed, rng: np.random.Generator
) -> tuple[ThrustDraws, tuple[TermDraws, ...]]:
    """Thrusts, then every term's own unknowns given its thrusts."""
    thrusts = draw_thrusts(model.thrust_prior, collapsed.thrusts, rng)
    return thrusts, draw_own(model, collapsed.terms, thrusts.thrust_n, rng)


def draw_own(
    model: Model, terms: Sequence[TermAt], thrust_n: Array, rng: np.random.Generator
) -> tuple[TermDraws, ...]:
    """Every term's own unknowns given the thrusts (n, E', K) of all events that fire."""
    pairs = zip(terms, model.fired_of_term, strict=True)
    return tuple(term.draw(thrust_n[:, fired], rng) for term, fired in pairs)


def draw_prior(model: Model, n: int, rng: np.random.Generator) -> Draws:
    """Everything drawn from its prior, before any data."""
    parameters = model.space.to_parameters(model.space.sample(rng, n))
    shape = (n, len(model.fired_ids))
    factor = thrust_factor(model, model.points_at(parameters, n))
    thrusts = prior_thrusts(model.thrust_prior, parameters, shape, rng, factor)
    return Draws(parameters, thrusts, draw_own_prior(model, n, rng))


def draw_own_prior(model: Model, n: int, rng: np.random.Generator) -> tuple[TermDraws, ...]:
    """Every term's own unknowns, n times from their priors."""
    normals = rng.standard_normal((n, len(model.event_ids), 3))
    torque = model.torque_mean_n_m + model.torque_sd_n_m * normals
    pairs = zip(model.terms, model.events_of_term, strict=True)
    return tuple(term.draw_prior(torque[:, events], rng) for term, events in pairs)


def drawn_terms(model: Model, points: Points, draws: Draws) -> list[DrawnTerm]:
    """Every term at the points of draws, with its thrusts and what it has of its own there."""
    each = zip(model.terms, model.fired_of_term, draws.integrated, strict=True)
    thrust_n = draws.thrusts.thrust_n
    return [(term.at(points), thrust_n[:, fired], own) for term, fired, own in each]


def event_log_density(model: Model, z: Array, draws: Draws) -> Array:
    """Log density (n, E) of each event's data given everything, its thrusts and torque included."""
    lots = [
        density_at(model, model.points(z[rows]), picked(draws, rows))
        for rows in model.batches(len(z))
    ]
    return np.concatenate(lots)


def density_at(model: Model, points: Points, draws: Draws) -> Array:
    """The same (n, E) at the points of draws, all at once."""
    each = drawn_terms(model, points, draws)
    return np.concatenate([term.log_density(thrust, own) for term, thrust, own in each], axis=1)


def event_log_marginal(model: Model, z: Array, level_n: Array, software: Array | None) -> Array:
    """Log density (n, E) of each event's data given what all events share.

    What is an event's own (departures of thrust, torque, initial momentum) is integrated out under
    its prior: the unit of leave-one-event-out, where the density given all of an event's own
    unknowns would judge it by what was fitted to it.

    Parameters
    ----------
    z, level_n
        Walked coordinates (n, d), and levels of all thrusters (n, K) in N.
    software
        Constants (n, 2) of the on-board ΔV, where a model has rows with one.
    """
    result = []
    for rows in model.batches(len(z)):
        points = model.points(z[rows])
        offset = level_n[rows] - points.common_n[:, None]
        parts = []
        for term in model.terms:
            at = term.at(points)
            if term.events[0].fires:
                factor = term.thrust_factor(points)
                moved = offset
                if factor is not None:
                    each = factor * level_n[rows, None, :]
                    moved = each - points.common_n[:, None, None]
                loading = model.thrust_prior.departures
                parts.append(at.information.without_departures(loading).about(moved).constant)
            else:
                parts.append(at.log_likelihood[:, None])
        for i, term in enumerate(model.totals):
            if term.computed is not None and software is not None:
                variance = delta_v_variance(points.parameters)
                parts[i] = parts[i] + event_channel_log_likelihood(
                    term.computed, software[rows], variance
                )
        result.append(np.concatenate(parts, axis=1))
    return np.concatenate(result)
