"""What the tests of prediction share: flight events, a small fit, what it teaches (made once)."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from pathlib import Path

import numpy as np
import tomli_w
from totals_cases import B_BRANCH, FLIGHT, flight

from cassini_bayes.computing.arrays import Array
from cassini_bayes.events.totals import TotalsEvent, read_totals
from cassini_bayes.files.storage import digest
from cassini_bayes.model import Model, build_model, draw
from cassini_bayes.model.totals import DeltaVUse, software_of
from cassini_bayes.pipeline.inputs import read_inputs
from cassini_bayes.pipeline.provenance import recorded
from cassini_bayes.pipeline.run_file import check_run
from cassini_bayes.prediction.beliefs import Beliefs, read_beliefs
from cassini_bayes.prediction.learning import Learned, learn
from cassini_bayes.prediction.leave_one_out import HeldOut, fold
from cassini_bayes.prediction.physics import PhysicsDraws
from cassini_bayes.priors.reader import Priors, read_priors
from cassini_bayes.results.fitting import ALL_MET
from cassini_bayes.results.groups import build_fit
from cassini_bayes.results.record import save_fit

SIZE = 400


@cache
def beliefs() -> Beliefs:
    """The package's own priors of prediction."""
    return read_beliefs()


@cache
def flights(first: int = 8) -> tuple[tuple[TotalsEvent, ...], Priors]:
    """Flight events and priors."""
    return flight(first)


@cache
def model() -> Model:
    """The totals model of the eight events."""
    events, priors = flights()
    return build_model(events, priors)


def physics(n: int = SIZE, seed: int = 3) -> PhysicsDraws:
    """Draws near the prior's centre with thrusts drawn from their exact conditional."""
    rng = np.random.default_rng(seed)
    z = 0.3 * rng.standard_normal((n, len(model().space.names)))
    draws = draw(model(), z, rng)
    full: Mapping[str, Array | float] = {**draws.parameters, **model().idle}
    return PhysicsDraws(
        full, draws.thrusts.thrust_n, draws.thrusts.level_n, software_of(draws.integrated[0])
    )


@cache
def learned() -> Learned:
    """What the eight events teach with those draws."""
    events, _ = flights()
    return learn(model(), events, physics(), beliefs(), np.random.default_rng(4), SIZE)


@cache
def folds() -> tuple[HeldOut, ...]:
    """Three folds over the first three events."""
    events, priors = flights(3)
    return tuple(fold(events, row, priors, beliefs(), 5, SIZE) for row in range(3))


def write_run_folder(
    folder: Path,
    table: Path = FLIGHT,
    priors: Path = B_BRANCH,
    stop_rule: str = ALL_MET,
    delta_v: DeltaVUse = "as-declared",
) -> Path:
    """A run folder with a small fit of a table's events; returns the path of ``fit.nc``."""
    rng = np.random.default_rng(6)
    read = read_priors(priors)
    own = build_model(read_totals(table, read.spacecraft), read, delta_v=delta_v)
    z = 0.3 * rng.standard_normal((1, SIZE, len(own.space.names)))
    fit = build_fit(own, z, np.zeros((1, SIZE)), rng, {"seed": 6, "stop_rule": stop_rule}, 50)
    run = folder / "small"
    run.mkdir(parents=True)
    save_fit(fit, run / "fit.nc")
    said = {"events": [str(table)], "source": "flight", "priors": str(priors)}
    said |= {"model": {"delta_v": delta_v}}
    (run / "resolved.toml").write_text(tomli_w.dumps(said))
    digests = ", ".join(f'"{path}": "{digest(path)}"' for path in (table, priors))
    (run / "provenance.json").write_text('{"sha256": {' + digests + "}}")
    return run / "fit.nc"


def write_earlier(path: Path, seed: int = 2) -> Path:
    """A fit of the flight events whose draws are near normal: priors can begin with it."""
    rows, priors = flights()
    own, rng = build_model(rows, priors, delta_v="ignore"), np.random.default_rng(seed)
    z = 0.3 * rng.standard_normal((1, 2_000, own.space.dimension))
    path.parent.mkdir(parents=True, exist_ok=True)
    save_fit(build_fit(own, z, np.zeros((1, 2_000)), rng, {"seed": seed}, 50), path)
    return path


def write_chained(folder: Path) -> tuple[Path, Path]:
    """A run whose priors begin with an earlier fit, in its record; both files' paths, it last."""
    earlier, priors = write_earlier(folder / "first" / "fit.nc"), folder / "chained.toml"
    priors.write_text(f'from_fit = "first/fit.nc"\n{B_BRANCH.read_text()}')
    fit = write_run_folder(folder, priors=priors, delta_v="ignore")
    said = {"events": [str(FLIGHT)], "priors": str(priors), "model": {"delta_v": "ignore"}}
    digests = read_inputs(check_run(said, "run"), Path()).digests
    (fit.parent / "provenance.json").write_text(recorded({}, digests, 1, ()).as_json())
    return earlier, fit
