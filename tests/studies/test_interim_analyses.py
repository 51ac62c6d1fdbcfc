"""A pool of points: a shorter mission as the first events of a longer one, mixed proposals."""

from __future__ import annotations

import numpy as np
import pytest
from mission_cases import PRIORS, mission_of, mission_table, mixed_events
from scipy.special import logsumexp

from cassini_bayes.model.mission.losses import Loss, loss_prior
from cassini_bayes.results.mission.fitting import fit_mission, target
from cassini_bayes.sampling.warmstart import Proposal
from cassini_bayes.studies import interim_analyses
from cassini_bayes.studies.interim_analyses import Pool, analyses
from cassini_bayes.studies.mission_flights import study_priors


def test_a_pool_has_the_density_of_a_shorter_mission(monkeypatch: pytest.MonkeyPatch) -> None:
    """First three of four events, with a loss on each branch, as a mission of their own."""
    monkeypatch.setattr(interim_analyses, "POINTS", 6)
    priors, events = study_priors(str(PRIORS)), mixed_events()
    whole, short = (mission_of(some, mission_table(), priors) for some in (events, events[:3]))
    assert whole.space.names == short.space.names
    d, rng = whole.space.dimension, np.random.default_rng(1)
    one, other = Proposal(np.zeros(d), np.eye(d), 15.0), Proposal(np.ones(d), 0.5 * np.eye(d), 15.0)
    pool = Pool.begun(whole, one, rng).grown(other, rng)
    references, prior = {"A": (Loss(2, 1),), "B": ()}, loss_prior(priors)
    found = pool.log_density(pool.first(3), references, prior)
    np.testing.assert_allclose(found, target(short, references, prior)(pool.z), rtol=1e-9)
    both = np.stack([one.log_density(pool.z), other.log_density(pool.z)])
    np.testing.assert_allclose(pool.log_mixture, logsumexp(both, axis=0, b=0.5))
    # negative control: the whole mission says something else
    every = pool.log_density(pool.first(4), references, prior)
    assert np.abs(every - found).min() > 1e-3


def test_interim_analyses_agree_with_a_fit_of_each_mission() -> None:
    """Probabilities of losses after three events, from the pool and from a fit of these alone."""
    priors, events = study_priors(str(PRIORS)), mixed_events()
    prior, size = loss_prior(priors), {"draws": 400, "proposals": 800}
    whole, short, first = (mission_of(events[:n], mission_table(), priors) for n in (4, 3, 2))
    begun = fit_mission(first, prior, np.random.default_rng(1), **size)
    (interim,) = analyses(whole, prior, begun, range(3, 4), 400, np.random.default_rng(2))
    assert interim.trusted
    fit = fit_mission(short, prior, np.random.default_rng(3), **size)
    for one, other in zip(interim.losses, fit.losses, strict=True):
        assert one.branch == other.branch
        np.testing.assert_allclose(one.failing(8), other.failing(8), atol=0.02)
    np.testing.assert_allclose(interim.draws.z.mean(0), fit.z.mean(0), atol=0.4)
