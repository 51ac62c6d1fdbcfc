"""Draws of the physics that a prediction starts from, and what they make of wheels and thrusters.

They come from a fit (``fit.nc``), or straight from the posterior of a model by importance
sampling (leave-one-event-out needs eight posteriors).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np
import xarray as xr

from cassini_bayes.balance.physics import Modifier, Physics, effective_on_times
from cassini_bayes.balance.totals_system import NOISE, steady_impulse
from cassini_bayes.computing.arrays import Array, mapped
from cassini_bayes.errors import InputError
from cassini_bayes.files.netcdf import read_groups
from cassini_bayes.model.draws import draw
from cassini_bayes.model.posterior import Model, log_posterior
from cassini_bayes.model.totals import software_of
from cassini_bayes.prediction.demand import PairSolver, pair_layout, pair_solver
from cassini_bayes.prediction.firing import Features
from cassini_bayes.prediction.wheel_profile import WheelManager, piece_times_s, segments_rpm
from cassini_bayes.results.record import Fit
from cassini_bayes.spacecraft.parameters import SOFTWARE, THRUST_COMMON
from cassini_bayes.spacecraft.units import RAD_S_PER_RPM

RECORDED: Final = ("rate_rad_s", "rwa_rpm")
"""Channels that a fit of telemetry has observed."""
SAME_VALUE: Final = 1e-9  # relative: a fixed value through a file and back


@dataclass(frozen=True)
class PhysicsDraws:
    """Joint draws of everything a fit infers that a prediction needs; leading axis n.

    ``parameters`` are the walked and fixed ones by name, those of effects among them; ``thrust_n``
    (n, E, K) of the fitted events, ``level_n`` (n, K) of every thruster over all events, effects
    apart, ``software`` (n, 2) factor and on-time per pulse of the on-board ΔV.
    """

    parameters: Mapping[str, Array | float]
    thrust_n: Array
    level_n: Array
    software: Array
    _balances: dict[tuple[Modifier, ...], Physics] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )

    @property
    def size(self) -> int:
        """Number of draws."""
        return len(self.level_n)

    def balance(self, model: Model) -> Physics:
        """The physics of the momentum balance at every draw, with the effects of the model."""
        modifiers = model.totals_rows.modifiers
        if modifiers not in self._balances:
            each = {
                name: np.broadcast_to(value, (self.size,))
                for name, value in self.parameters.items()
            }
            self._balances[modifiers] = model.points_at(each, self.size).physics(modifiers)
        return self._balances[modifiers]

    def delivered_n(self, model: Model) -> Array:
        """Thrust (n, K) that thrusters deliver on average: level times factor of effects."""
        return np.asarray(self.level_n * self.balance(model).thrust_factor)

    def at_mean(self) -> PhysicsDraws:
        """Every draw replaced by the mean of all: the physics as if it were known."""
        result: PhysicsDraws = mapped(
            lambda draws: np.broadcast_to(draws.mean(0), draws.shape), self
        )
        return result


def importance_physics(
    model: Model, rng: np.random.Generator, size: int
) -> tuple[PhysicsDraws, float]:
    """Draws from the posterior of a model: mode, Laplace, importance sampling, resampling.

    Returns the draws and the Pareto k̂ of the importance draws.
    """
    from cassini_bayes.sampling.warmstart import warm_start

    warm = warm_start(partial(log_posterior, model), model.space.dimension, rng, draws=8_000)
    draws = draw(model, warm.draws.resample(rng, size), rng)
    values = {**draws.parameters, **model.idle}
    thrusts, (integrated,) = draws.thrusts, draws.integrated
    software = (
        software_of(integrated) if model.totals_rows.computed is not None else np.zeros((size, 2))
    )
    physics = PhysicsDraws(values, thrusts.thrust_n, thrusts.level_n, software)
    return physics, warm.draws.pareto_k


def physics_of_fit(
    model: Model, fit: Path | Fit, rng: np.random.Generator, size: int
) -> PhysicsDraws:
    """``size`` random draws of a fit or of its file, checked against the events of the model.

    Of a fit of telemetry the model is that of its biases' totals. What only totals rows tell
    (how well attitude is held) comes from its prior there: the fit says nothing of it.

    Raises
    ------
    InputError
        The file is missing, is no fit, is that of a mission, or was made of other events.
    """
    needed = {"posterior": (), "observed_data": ("event", "on_time_s")}
    path = fit if isinstance(fit, Path) else Path("fit")
    groups = (
        read_groups(fit, needed, "a fit.nc of this package")[0]
        if isinstance(fit, Path)
        else fit.groups
    )
    posterior = groups["posterior"]
    check_one_branch(path, posterior)
    _check_events(model, path, groups["observed_data"])
    chains, draws = posterior[THRUST_COMMON].shape
    chosen = np.sort(rng.choice(chains * draws, min(size, chains * draws), False))
    values = {
        str(name): np.asarray(variable.values, dtype=float).reshape(
            chains * draws, *variable.shape[2:]
        )[chosen]
        for name, variable in posterior.data_vars.items()
        if variable.dims[:2] == ("chain", "draw")
    }
    values["thrust_n"] = values["thrust_n"][:, _places(model, posterior), :]
    values |= _held(model, groups["observed_data"], values, rng)
    wheels = posterior.coords["wheel"].values.tolist() if "wheel" in posterior.coords else []
    return _from_values(model, values, wheels, path)


def check_one_branch(fit: Path, posterior: xr.Dataset) -> None:
    """Refuse a fit of a mission: its thrusts change from event to event by laws of their own.

    Every fit of one branch has draws of the level that all thrusters share.

    Raises
    ------
    InputError
        The posterior has no common level of thrusters.
    """
    if THRUST_COMMON not in posterior:
        raise InputError(
            str(fit),
            "a fit of one branch",
            f"one of a mission (no {THRUST_COMMON} in its posterior)",
            "predict and plan from a fit of that branch's events: fit EVENT... --priors FILE; "
            "the forecast of a mission is that of trend",
        )


def _places(model: Model, posterior: xr.Dataset) -> list[int]:
    """Where the model's events are among those of the fit."""
    ids = [str(name) for name in posterior["event"].values]
    return [ids.index(name) for name in model.event_ids]


def _held(
    model: Model, observed: xr.Dataset, values: Mapping[str, Array], rng: np.random.Generator
) -> dict[str, Array]:
    """Prior draws of the noise of totals rows, where the fit has no such rows."""
    names = [name for name in NOISE if name in model.space.names and name not in values]
    if not names or not set(observed.data_vars) & set(RECORDED):
        return {}
    z = model.space.sample(rng, len(values["thrust_level_n"]))
    drawn = model.space.to_parameters(z)
    return {name: np.asarray(drawn[name]) for name in names}


def _check_events(model: Model, path: Path, observed: xr.Dataset) -> None:
    ids = tuple(str(name) for name in observed["event"].values)
    stack = model.totals_rows.stack
    # slews and burns of a fit of telemetry teach no firing logic, and are not among the model's
    recorded = bool(set(observed.data_vars) & set(RECORDED))
    known = set(stack.event_ids) <= set(ids) if recorded else stack.event_ids == ids
    on_time = observed["on_time_s"].sel(event=list(stack.event_ids)).values if known else None
    if on_time is None or not np.allclose(on_time, stack.on_time_s, atol=1e-9):
        raise InputError(
            str(path),
            f"a fit of the events {', '.join(stack.event_ids)}",
            "other on-times" if known else f"one of {', '.join(ids)}",
            "name the events that the fit was made of (--events)",
        )


def _from_values(
    model: Model, values: dict[str, Array], wheels: list[str], path: Path
) -> PhysicsDraws:
    parameters: dict[str, Array | float] = {**model.space.fixed, **model.idle}
    if "rwa_inertia_kg_m2" in values:
        spins = dict(zip(wheels, values["rwa_inertia_kg_m2"].T, strict=True))
        named = [wheel for wheel in model.spacecraft.wheels if wheel.name in spins]
        values = {**{wheel.inertia_parameter: spins[wheel.name] for wheel in named}, **values}
    for name, fixed in model.space.fixed.items():
        if name in values:
            _check_fixed(path, name, fixed, values[name])
    for name in model.space.names:
        if name not in values:
            raise InputError(
                str(path), f"draws of {name}", "none", "name the priors file of the fit (--priors)"
            )
        parameters[name] = values[name]
    size = len(values["thrust_level_n"])
    software = np.zeros((size, 2))
    if model.totals_rows.computed is not None:
        software = np.stack([values[name] for name in SOFTWARE], axis=-1)
    return PhysicsDraws(parameters, values["thrust_n"], values["thrust_level_n"], software)


def _check_fixed(path: Path, name: str, fixed: float, draws: Array) -> None:
    """A fit has draws of every prime wheel's inertia: fixed ones are all the value it was given."""
    is_free = np.ptp(draws) > 0
    if is_free or not np.allclose(draws, fixed, rtol=SAME_VALUE, atol=0.0):
        own = "free" if is_free else f"{draws.flat[0]:.10g}"
        raise InputError(
            str(path),
            f"priors in which {name} is {own}, as in the fit",
            "a fixed value" if is_free else f"{fixed:.10g}",
            "name the priors file of the fit (--priors)",
        )


def momentum_per_rpm(model: Model, physics: PhysicsDraws, wheels: tuple[int, ...] = ()) -> Array:
    """Momentum (n, 3, W), N m s per rev/min, of wheels by number, or of all in file order."""
    weights = physics.balance(model).wheel_weights * RAD_S_PER_RPM
    each = np.broadcast_to(weights, (physics.size, *weights.shape[-2:]))
    numbers = [wheel.number for wheel in model.spacecraft.wheels]
    return each[:, :, [numbers.index(n) for n in wheels]] if wheels else each


def wheel_momentum(
    model: Model, physics: PhysicsDraws, wheels: tuple[int, ...], rates_rpm: Array
) -> Array:
    """Momentum (n, S, 3) of wheel rates or changes (S, len(wheels)), N m s."""
    momentum = momentum_per_rpm(model, physics, wheels)
    return np.asarray(np.swapaxes(momentum @ rates_rpm.T, -1, -2))


def stretch(model: Model, physics: PhysicsDraws, pulses_per_second: Array | float) -> Array:
    """Impulse over thrust and commanded on-time (n, K) at a mean width of 1/pulses_per_second."""
    rate = np.broadcast_to(np.asarray(pulses_per_second, dtype=np.float64), (physics.size,))
    one = np.ones((physics.size, 1, len(model.thrusters)))
    shape, balance = model.totals_rows.pulse_shape, physics.balance(model)
    return effective_on_times(shape, balance, one, rate[:, None, None] * one)[:, 0]


def arms_of(model: Model, physics: PhysicsDraws) -> Array:
    """Lever arms (n, 3, K), m."""
    arms = physics.balance(model).arms_m
    return np.broadcast_to(arms, (physics.size, *arms.shape[-2:]))


def solver_of(
    model: Model, physics: PhysicsDraws, thrust_n: Array, pulses_per_second: Array | float
) -> PairSolver:
    """Pair solver at thrusts (n, K)."""
    layout = pair_layout(model.spacecraft, model.branch)
    force = thrust_n * stretch(model, physics, pulses_per_second)
    return pair_solver(arms_of(model, physics), force, layout.pairs)


def demand_of(
    model: Model,
    physics: PhysicsDraws,
    manager: WheelManager,
    wheels: tuple[int, ...],
    ends_rpm: tuple[Array, Array],
    duration_s: Array | float,
) -> Array:
    """Momentum (n, S, 3) that thrusters have to give in each piece of a wheel bias, N m s.

    That is the wheels' change less what a steady torque of the fit's effects gives, which acts all
    the time. ``ends_rpm`` are the rates (W,) at start and end, ``duration_s`` is (n,) or one.
    """
    changes = wheel_momentum(model, physics, wheels, segments_rpm(manager, wheels, *ends_rpm))
    times = piece_times_s(manager, wheels, ends_rpm[1] - ends_rpm[0])
    lasts = np.broadcast_to(np.asarray(duration_s, dtype=np.float64), (physics.size,))
    each = lasts[:, None] * np.diff(times) / times[-1]
    return np.asarray(changes - steady_impulse(physics.balance(model), each))


def features_of(
    model: Model, solver: PairSolver, demand_n_m_s: Array, duration_s: Array | float
) -> Features:
    """Features of the firing model from the momentum (n, S, 3) that is asked of thrusters."""
    layout = pair_layout(model.spacecraft, model.branch)
    pairs = solver.on_times(demand_n_m_s).sum(1)
    plus, minus = pairs[:, 0::2], pairs[:, 1::2]
    lesser, demand = np.minimum(plus, minus), plus + minus
    a, b = layout.ring_axes
    c = layout.couple_axis
    return Features(
        duration_s=np.broadcast_to(np.asarray(duration_s, dtype=np.float64), (len(pairs),)),
        reversal_ring_s=lesser[:, a] + lesser[:, b],
        reversal_couple_s=lesser[:, c],
        demand_ring_s=demand[:, a] + demand[:, b],
        demand_couple_s=demand[:, c],
        common_s=np.minimum(demand[:, a], demand[:, b]),
    )
