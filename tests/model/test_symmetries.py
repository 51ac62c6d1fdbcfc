"""What does not depend on the size of a craft: the posterior of one whose masses are k times."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest
import tomli_w
from telemetry_cases import PRIORS, event_of, made_up_samples

from cassini_bayes.computing.arrays import Array
from cassini_bayes.model import build_model, log_posterior
from cassini_bayes.priors.reader import read_priors

OF_MASS = ("N", "kg m2", "N m", "kg", "N m s0.5", "N/year")
"""Units that are proportional to a mass where lengths and times stay."""


def gained(folder: Path, masses: float) -> Array:
    """Log posteriors over that at the prior's centre, of priors with all masses times so much."""
    content = tomllib.loads(PRIORS.read_text(encoding="utf-8"))
    for table in content["parameters"].values():
        if table["unit"] in OF_MASS:
            scaled = {"loc", "scale", "low", "high", "fixed"} & table.keys()
            table.update({key: masses * table[key] for key in scaled})
    path = folder / "priors.toml"
    path.write_text(tomli_w.dumps(content), encoding="utf-8")
    priors, rng = read_priors(path), np.random.default_rng(5)
    samples = made_up_samples(rng, 120), made_up_samples(rng, 110, fires=False)
    model = build_model([event_of(own, priors, f"e{i}") for i, own in enumerate(samples)], priors)
    z = np.r_[np.zeros((1, model.space.dimension)), 0.3 * model.space.sample(rng, 4)]
    values = log_posterior(model, z)
    return np.asarray(values - values[0])


@pytest.mark.parametrize("masses", [0.01, 100.0])
def test_data_say_the_same_of_a_craft_of_any_size(tmp_path: Path, masses: float) -> None:
    """Masses, forces and torques times k leave the same motion, and so the same posterior.

    A width of 10 N m s for the initial momentum had been one of the craft's size.
    """
    wanted = gained(tmp_path, 1.0)
    assert np.abs(wanted).min(initial=np.inf, where=np.arange(5) > 0) > 1.0
    assert gained(tmp_path, masses) == pytest.approx(wanted, abs=0.01)
