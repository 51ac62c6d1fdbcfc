"""What two wheels give inference: the spin measures I_zz and the angle of wheel 4's platform."""

from __future__ import annotations

import copy
import tomllib
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from study_cases import study_in

from cassini_bayes.errors import InputError
from cassini_bayes.model.event_reduction import reduce_samples, sampling_of
from cassini_bayes.model.posterior import build_model, log_posterior
from cassini_bayes.priors.reader import Priors, read_priors
from cassini_bayes.sampling.warmstart import warm_start
from cassini_bayes.simulation import SimulatedEvent, scenario_of
from cassini_bayes.studies.hybrid import FIGURES, SPIN_UP, HybridFlights, fly_hybrid, with_products
from cassini_bayes.studies.scenario import simulate_file, simulated_samples

Array = NDArray[np.float64]
SCENARIO = Path("runs/scenarios/hybrid_2012.toml")
DOCUMENT = tomllib.loads(SCENARIO.read_text(encoding="utf-8"))
PRIORS = Path("priors/cassini_hybrid_2012.toml")
ANGLE = "rwa4_articulation_rad"
INERTIA = "inertia_zz_kg_m2"


def flown(priors: Priors, hidden_rad: float) -> SimulatedEvent:
    """The spin-up with parameters from the priors, the platform off by a hidden angle."""
    document = copy.deepcopy(DOCUMENT)
    document["event"] = [e for e in document["event"] if e["id"] == SPIN_UP]
    document["truth"] = {ANGLE: priors.parameters[ANGLE].mean + hidden_rad}
    for channel in ("attitude_noise_rad", "rate_noise_rad_s", "wheel_noise_rpm"):
        del document["telemetry"][channel]
    return simulate_file(scenario_of(document), 3, priors=priors).events[0]


def posterior(event: SimulatedEvent, priors: Priors) -> Mapping[str, Any]:
    """Draws of the walked parameters by importance sampling."""
    rng = np.random.default_rng(3)
    samples, thrusters = simulated_samples(event)
    sampling = sampling_of(priors, thrusters, float(samples.time_s[-1]), "first_order")
    own = event.plan.event
    reduced = reduce_samples(
        own.id, own.kind, event.plan.wheel_numbers, thrusters, samples, sampling
    )
    model = build_model([reduced], priors)
    found = warm_start(partial(log_posterior, model), model.space.dimension, rng, draws=1500)
    return model.space.to_parameters(found.draws.resample(rng, 1500))


def test_the_spin_finds_a_hidden_angle_and_the_inertia() -> None:
    """30 mrad of platform, three prior sigmas, come out to a tenth; I_zz narrows sevenfold."""
    priors = read_priors(PRIORS)
    event = flown(priors, 0.03)
    draws = posterior(event, priors)
    hidden = np.asarray(draws[ANGLE]) - priors.parameters[ANGLE].mean
    assert hidden.std() < 0.3 * priors.parameters[ANGLE].sd
    assert abs(hidden.mean() - 0.03) < 3.0 * hidden.std() < 0.012
    inertia = np.asarray(draws[INERTIA])
    assert inertia.std() < 0.17 * priors.parameters[INERTIA].sd
    assert abs(inertia.mean() - event.plan.parameters[INERTIA]) < 3.0 * inertia.std()


def test_a_platform_without_its_wheel_is_refused(tmp_path: Path) -> None:
    """A prior of the angle without wheel 4 among the wheels: file, key and fix in one line."""
    text = PRIORS.read_text(encoding="utf-8").replace("wheels = [2, 4]", "wheels = [1, 2]")
    path = tmp_path / "priors.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=rf"parameters\.{ANGLE}.*wheel 4.*add 4"):
        read_priors(path)


def test_page_has_every_figure(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every row of the table has the published and our figure; products change the scenario."""
    figures = {f"{figure.event}.{figure.key}": 1.5 for figure in FIGURES}

    def flown(flights: HybridFlights, index: int) -> dict[str, float]:
        return {key: value + 0.5 * (-1) ** index for key, value in figures.items()}

    monkeypatch.setattr(HybridFlights, "repetition", flown)
    study = study_in(tmp_path, tmp_path / "hybrid.md")
    fly_hybrid(study, SCENARIO, {"seeds": 4})
    text = study.page.read_text(encoding="utf-8")
    for figure in FIGURES:
        assert f"| {figure.event} | {figure.label} | {figure.published} | 1.5 ± 0.5 |" in text
    assert with_products(DOCUMENT)["truth"]["inertia_xy_kg_m2"] == -164.0
    assert DOCUMENT["truth"]["inertia_xy_kg_m2"] == 0.0
