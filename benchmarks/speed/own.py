"""Own times of this package: one bias, seven events, many samples, many events."""

from __future__ import annotations

import importlib
import os
import time
from dataclasses import fields, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from cassini_bayes.balance.statistics import Samples, reduce_chunks
from cassini_bayes.computing.arrays import Array
from cassini_bayes.model.draws import draw
from cassini_bayes.model.event_reduction import ReducedEvent
from cassini_bayes.model.posterior import Model, build_model, log_posterior
from cassini_bayes.results.fitting import Sampled, collapsed_size, fit_model
from cassini_bayes.sampling.ensembles import ProgressReport, SamplerSettings, sample, stored_ess
from cassini_bayes.sampling.warmstart import warm_start
from speed.problem import model_of, reduced_events

Row = dict[str, Any]
TARGET = 2_000
FIRST_CHECK = 300
CHECKED_STEPS = 600
REFERENCE = 50_000
POINTS = 400


class Stages:
    """When the effective sizes of the walked parameters were reached first, in a fit."""

    def __init__(self) -> None:
        self._began = time.perf_counter(), time.process_time()
        self.enough: tuple[float, float] | None = None

    def note(self, report: ProgressReport) -> None:
        """Take a progress report of the sampler."""
        if self.enough is None and not any(text.startswith("ESS") for text in report.failed):
            self.enough = self.now()

    def now(self) -> tuple[float, float]:
        """Wall and processor seconds since the start."""
        return time.perf_counter() - self._began[0], time.process_time() - self._began[1]


def fit_row(folders: list[Path], label: str, most_steps: int, quick: bool = False) -> Row:
    """From event folders to a fit with the effective draws asked for, stage by stage."""
    stages = Stages()
    events = reduced_events(folders)
    model = model_of(events)
    read = stages.now()
    settings = SamplerSettings(target_ess=100 if quick else TARGET, max_steps=most_steps)
    if quick:
        settings = replace(settings, first_check=40, max_steps=60)
    fitted = fit_model(model, settings, progress=stages.note, threads=os.cpu_count() or 1)
    wall, processor = stages.now()
    least, least_name = least_ess(fitted)
    enough = stages.enough or (np.nan, np.nan)
    return {
        "case": label,
        "rows": sum(event.reading.rows for event in events),
        "walked": len(model.space.names),
        "collapsed": collapsed_size(model),
        "reading_s": read[1],
        "enough_wall_s": enough[0],
        "enough_processor_s": enough[1],
        "wall_s": wall,
        "processor_s": processor,
        "least_ess": least,
        "least_ess_of": least_name,
        "steps": int(fitted.chains.convergence.step),
        "converged": fitted.chains.convergence.done,
        "pareto_k": float(fitted.warm.draws.pareto_k),
        **importance_row(folders),
    }


def sampler_row(folders: list[Path], torque_noise: bool) -> tuple[Row, Array]:
    """Our sampler until the size wanted is there, as the others are timed, and many more draws.

    The clock starts at the event folder and includes reading, reduction and warm start.
    """
    importlib.import_module("arviz")  # two seconds; the others' imports do not count either
    clock = Stages()
    model = model_of(reduced_events(folders, torque_noise), torque_noise)
    log_density = partial(log_posterior, model)
    log_posterior(model, np.zeros((1, len(model.space.names))))
    warm = warm_start(log_density, len(model.space.names), np.random.default_rng(1))
    warm_s = clock.now()[1]
    settings = SamplerSettings(
        target_ess=TARGET, ensembles=2, first_check=FIRST_CHECK, max_steps=CHECKED_STEPS
    )
    began = time.process_time()
    chains = sample(log_density, warm.proposal, settings, progress=clock.note)
    sampling_s = time.process_time() - began
    kept = chains.z[:, chains.burn_in :]
    m, steps, walkers, d = kept.shape
    per_walker = np.moveaxis(kept, 2, 1).reshape(m * walkers, steps, d)
    ess = least_of(per_walker)
    flat = kept.reshape(-1, d)
    enough = clock.enough or (np.nan, np.nan)
    row = {
        "sampler": "cassini_bayes (emcee)",
        "torque_noise": torque_noise,
        "dimensions": d,
        "warm_start_s": warm_s,
        "enough_s": enough[1],
        "enough_wall_s": enough[0],
        "sampling_s": sampling_s,
        "ess": ess,
        "autocorrelation_steps": float(chains.convergence.autocorrelation_time.max()),
        "ess_per_s": ess / (warm_s + sampling_s),
        "sampling_ess_per_s": ess / sampling_s,
        "call_s": call_time(model, 5),
        "pareto_k": float(warm.draws.pareto_k),
        "importance_ess": float(warm.draws.efficiency * len(warm.draws.z)),
    }
    return row, flat[:: max(len(flat) // REFERENCE, 1)]


def least_of(chains: Array) -> float:
    """Smallest bulk or tail effective size of chains (chains, steps, dimensions)."""
    from arviz import ess

    return min(
        float(ess(chains[:, :, j], method=method))
        for j in range(chains.shape[2])
        for method in ("bulk", "tail")
    )


def least_ess(fitted: Sampled) -> tuple[float, str]:
    """Smallest bulk or tail effective size of the stored draws, walked and collapsed alike."""
    model, z = fitted.model, fitted.z
    m, n, _ = z.shape
    walkers = fitted.chains.z.shape[2]
    draws = draw(model, fitted.flat_z, np.random.default_rng(0))
    parts = {
        f"{name} of {term.id}": values.reshape(m * n, -1)
        for term, own in zip(model.telemetry, draws.integrated, strict=True)
        for name, values in own.items()
    }
    parts["thrust"] = draws.thrusts.thrust_n.reshape(m * n, -1)
    sizes = {name: min(stored_ess(z[:, :, i], walkers)) for i, name in enumerate(model.space.names)}
    for name, values in parts.items():
        for j in np.flatnonzero(values.std(0) > 0):
            sizes[f"{name} {j}"] = min(stored_ess(values[:, j].reshape(m, n), walkers))
    return min((size, name) for name, size in sizes.items())


def importance_row(folders: list[Path]) -> Row:
    """From event folders to importance draws alone."""
    began = time.perf_counter()
    model = model_of(reduced_events(folders))
    log_density = partial(log_posterior, model)
    warm = warm_start(log_density, len(model.space.names), np.random.default_rng(1))
    wall = time.perf_counter() - began
    ess = warm.draws.efficiency * len(warm.draws.z)
    return {"importance_wall_s": wall, "importance_ess": ess}


def denser(samples: Samples, times: int) -> Samples:
    """The same telemetry sampled ``times`` as often, every value held until the next."""
    step = np.diff(samples.time_s, append=samples.time_s[-1] + 1.0)
    part = np.tile(np.arange(times) / times, len(samples))
    held = {
        field.name: np.repeat(getattr(samples, field.name), times, axis=0)
        for field in fields(Samples)
    }
    return replace(Samples(**held), time_s=held["time_s"] + part * np.repeat(step, times))


def call_time(model: Model, repeats: int, points: int = POINTS) -> float:
    """Median processor time of a likelihood call per point, seconds."""
    rng = np.random.default_rng(0)
    z = 0.3 * rng.standard_normal((points, len(model.space.names)))
    log_posterior(model, z)
    times = []
    for _ in range(repeats):
        began = time.process_time()
        log_posterior(model, z)
        times.append(time.process_time() - began)
    return float(np.median(times)) / points


def sample_growth(
    reduced: ReducedEvent, samples: Samples, counts: list[int], repeats: int
) -> list[Row]:
    """Time of a likelihood call for one stretch of telemetry, sampled more and more often."""
    models = []
    for count in counts:
        whole = denser(samples.part(0, counts[0]), count // counts[0])
        sampling = replace(reduced.sampling, duration_s=float(whole.time_s[-1]))
        chunks = [whole.part(a, a + 100_000) for a in range(0, count, 100_000)]
        layout = reduced.statistics.layout
        statistics = reduce_chunks("bias", "bias", chunks, layout, sampling)
        event = replace(reduced, statistics=statistics, sampling=sampling)
        models.append(build_model([event], _priors()))
    # taken in turn, so that a busy machine slows all of them
    times = np.array([[call_time(model, 1) for model in models] for _ in range(repeats)])
    return [
        {"rows": count, "call_s": float(value)}
        for count, value in zip(counts, np.median(times, axis=0), strict=True)
    ]


def event_growth(event: ReducedEvent, counts: list[int], repeats: int) -> list[Row]:
    """Time of a likelihood call for more and more joint events, all like the first one.

    Different biases differ in what one costs, which would pass for growth.
    """
    models = []
    for count in counts:
        named = [
            replace(event, statistics=replace(event.statistics, event_id=f"e{i}"))
            for i in range(count)
        ]
        models.append(build_model(named, _priors()))
    times = np.array([[call_time(model, 1) for model in models] for _ in range(repeats)])
    return [
        {"events": count, "walked": len(model.space.names), "call_s": float(value)}
        for count, model, value in zip(counts, models, np.median(times, axis=0), strict=True)
    ]


def _priors() -> Any:
    from speed.problem import priors_of

    return priors_of()
