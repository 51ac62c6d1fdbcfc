"""The density of one event given what all share, against the collapsed likelihood of them all."""

from __future__ import annotations

import numpy as np
from event_cases import events, priors

from cassini_bayes.model import ReducedEvent, build_model, draw, log_likelihood
from cassini_bayes.model.draws import event_log_density, event_log_marginal
from cassini_bayes.priors.reader import Priors

POINTS = 6


def both() -> tuple[ReducedEvent, ...]:
    """A bias and slews."""
    return events("bias", "slews")


def known_levels() -> Priors:
    """Priors under which every thruster's level is known, its departures in an event are not."""
    known = priors()
    for name in ("thrust_common_n", "thrust_individual_n"):
        known = known.with_fixed(name, known.parameters[name].mean)
    return known


def test_with_known_levels_the_events_add_up() -> None:
    """Nothing linear is shared: the sum over events is the likelihood, collapsed all at once."""
    model = build_model(both(), known_levels())
    z = 0.3 * np.random.default_rng(5).standard_normal((POINTS, model.space.dimension))
    level = np.full((POINTS, len(model.thrusters)), model.thrust_prior.common_mean_n)
    own = event_log_marginal(model, z, level, None)
    assert own.shape == (POINTS, len(both()))
    np.testing.assert_allclose(own.sum(1), log_likelihood(model, z), rtol=1e-10)


def test_levels_matter_to_events_that_fire_alone() -> None:
    """Other levels change the bias, not the slews."""
    model = build_model(both(), known_levels())
    z = np.zeros((1, model.space.dimension))
    level = np.full((1, len(model.thrusters)), model.thrust_prior.common_mean_n)
    before, after = (event_log_marginal(model, z, own, None)[0] for own in (level, 1.1 * level))
    fires = np.array([event.fires for event in model.events])
    assert (before != after).tolist() == fires.tolist()


def test_it_spreads_less_than_the_density_given_everything() -> None:
    """Over draws, an event's own unknowns make the full density scatter more: worse to reweight."""
    model = build_model(both(), priors())
    rng = np.random.default_rng(7)
    z = np.zeros((400, model.space.dimension))
    draws = draw(model, z, rng)
    own = event_log_marginal(model, z, draws.thrusts.level_n, None)
    full = event_log_density(model, z, draws)
    fires = np.array([event.fires for event in model.events])
    assert (own[:, fires].std(0) < full[:, fires].std(0)).all()
