"""Simulation-based calibration of the totals model: do 90 % intervals hold 90 % of the truths?

Parameters are drawn from the priors, events are simulated by the mechanism of
``docs/topics/totals-likelihood.md`` §3 (the on-times that respond are solved for, exactly, not
through the likelihood), every simulated set is fitted, and the rank of each true value among its
posterior draws is kept. If likelihood, priors and sampler are right the ranks are uniform (Talts et
al. 2018, Modrák et al. 2023).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import ClassVar, Final, Literal

import numpy as np
from scipy.stats import kstest, norm

from cassini_bayes.balance.totals_terms import wheel_momentum
from cassini_bayes.computing.arrays import Array
from cassini_bayes.errors import CassiniBayesError, InputError
from cassini_bayes.events.totals import TotalsEvent, read_totals
from cassini_bayes.model.draws import Draws, draw, draw_prior
from cassini_bayes.model.posterior import Model, build_model, log_posterior
from cassini_bayes.model.totals import software_of
from cassini_bayes.priors.reader import Priors, read_priors
from cassini_bayes.results.ranks import Ranks, rank
from cassini_bayes.spacecraft import thruster_directions
from cassini_bayes.spacecraft.pulses import effective_on_time
from cassini_bayes.spacecraft.units import RAD_S_PER_RPM
from cassini_bayes.studies.posterior_draws import posterior_draws
from cassini_bayes.studies.repeated import Repeated

Control = Literal["none", "hold-rates-ignored", "rectangular-pulses"]
CONTROLS: Final[tuple[Control, ...]] = ("none", "hold-rates-ignored", "rectangular-pulses")

LEAST_ON_TIME_S: Final = 4.0
EFFORTS: Final = ((15.0, 1, 2_000),)
CONTROL_HOLD_RATE: Final = 1e-7
COVERAGE_TOLERANCE: Final = 0.03
LEAST_P_VALUE: Final = 0.01
SETTLED_S: Final = 1e-9
MOST_STEPS: Final = 500  # slow where a pulse lasts no longer than thrust takes to build up
MODULE: Final = "studies.totals_calibration"
"""Whose code, with all that it imports, a repetition runs through."""


@dataclass(frozen=True)
class Campaign(Repeated):
    """What a calibration campaign runs: template events, priors, control, seed."""

    events: Path
    priors: Path
    control: Control = "none"

    per_file: ClassVar[int] = 20

    def names(self) -> tuple[str, ...]:
        """Names of the ranked scalars, in the order of the ranks."""
        model = build_model(self._template(), read_priors(self.priors))
        return tuple(_flatten(draw_prior(model, 1, np.random.default_rng(0)), model))

    def _template(self) -> tuple[TotalsEvent, ...]:
        spacecraft = read_priors(self.priors).spacecraft
        return tuple(with_room(event) for event in read_totals(self.events, spacecraft))

    def repetition(self, index: int) -> dict[str, Array | float | bool]:
        """Draw, simulate, fit, rank: ranks (P,), Pareto k̂, and whether a chain stood in for it."""
        priors, template, rng = read_priors(self.priors), self._template(), self.stream(index)
        model = build_model(template, priors)
        truth = draw_prior(model, 1, rng)
        simulated = simulate_totals(template, model, truth, rng)
        fitted = build_model(
            simulated,
            _controlled(priors, self.control),
            pulse_shape="rectangular" if self.control == "rectangular-pulses" else "first_order",
        )
        density = partial(log_posterior, fitted)
        z, k, by_chain = posterior_draws(density, fitted.starts, rng, EFFORTS)
        drawn = _flatten(draw(fitted, z, rng), fitted)
        true_values = _flatten(truth, model)
        ranks = [
            rank(drawn[name], true_values[name][0], rng) if name in drawn else np.nan
            for name in true_values
        ]
        return {"ranks": np.array(ranks), "pareto_k": k, "by_chain": by_chain}


@dataclass(frozen=True)
class Verdict:
    """Whether a campaign passes: every parameter's coverage within the tolerance."""

    tolerance: float
    lowest: float
    highest: float
    failing: tuple[str, ...]
    smallest_p_value: float

    @property
    def passed(self) -> bool:
        """No parameter's coverage is outside the tolerance and no rank distribution is skewed."""
        return not self.failing and self.smallest_p_value > LEAST_P_VALUE


def judge(ranks: Ranks) -> Verdict:
    """Coverage of 90 % intervals against the tolerance, and uniformity of all ranks.

    The tolerance is ±3 %, or what binomial scatter alone reaches once in a hundred campaigns where
    that is wider (few repetitions). ``smallest_p_value`` is the least Kolmogorov-Smirnov p-value
    over all parameters times their number (Holm's first step).
    """
    ranks = ranks.of_fitted()
    coverage = ranks.coverage()
    n, parameters = ranks.ranks.shape
    scatter = norm.isf(0.005 / parameters) * np.sqrt(0.9 * 0.1 / n)
    tolerance = max(COVERAGE_TOLERANCE, float(scatter))
    outside = np.abs(coverage - 0.9) > tolerance
    p_values = [float(kstest(column, "uniform").pvalue) for column in ranks.ranks.T]
    return Verdict(
        tolerance=tolerance,
        lowest=float(coverage.min()),
        highest=float(coverage.max()),
        failing=tuple(name for name, bad in zip(ranks.names, outside, strict=True) if bad),
        smallest_p_value=min(1.0, min(p_values) * len(p_values)),
    )


def with_room(event: TotalsEvent) -> TotalsEvent:
    """The event with at least some seconds of on-time on every thruster, at the same pulse width.

    A simulated bias may need less of a pair than the flight did; the limit cycle's own on-time,
    which does not depend on the parameters, is raised so that no on-time turns negative.
    """
    if event.pulses is None:
        raise InputError(
            f"event {event.id}: pulses",
            "the number of pulses of every thruster",
            "none",
            "take rows of a source with pulse counts as the template",
        )
    width = np.where(event.pulses > 0, event.on_time_s / np.maximum(event.pulses, 1), 0.125)
    on_time = event.on_time_s + LEAST_ON_TIME_S
    return replace(event, on_time_s=on_time, pulses=np.maximum(np.rint(on_time / width), 1.0))


def simulate_totals(
    template: tuple[TotalsEvent, ...],
    model: Model,
    truth: Draws,
    rng: np.random.Generator,
) -> tuple[TotalsEvent, ...]:
    """Fly the template's wheel biases with given true values (a batch of one).

    Wheel rates are those of the template up to their printed step; body rates and attitude errors
    at both ends are drawn; the on-times of the responding pairs are solved for by iteration on the
    full pulse-shape formula. Pulse counts are the on-time over the template's mean width, rounded;
    on-times are rounded to their printed step.

    Raises
    ------
    CassiniBayesError
        An on-time came out negative (the template needs more room).
    """
    stack = model.totals_rows.stack
    points = model.points_at(truth.parameters, 1)
    one = {name: value[0] for name, value in points.parameters.items()}
    physics = points.physics(())
    axes, inertias = physics.wheel_axes[0], physics.wheel_inertia_kg_m2[0]
    arms, inertia = physics.arms_m[0], physics.inertia_kg_m2[0]
    half_step = 0.5 * one["wheel_resolution_rpm"] * RAD_S_PER_RPM * stack.wheel_is_prime
    shape = stack.wheel_start_rad_s.shape
    start = wheel_momentum(
        axes, inertias, stack.wheel_start_rad_s + half_step * rng.uniform(-1, 1, shape)
    )
    end = wheel_momentum(
        axes, inertias, stack.wheel_end_rad_s + half_step * rng.uniform(-1, 1, shape)
    )
    n_events = len(stack.event_ids)
    rates = rng.normal(0.0, one["hold_rate_rad_s"], (2, n_events, 3))
    attitude = rng.normal(0.0, one["hold_attitude_rad"], (2, n_events, 3))
    body = (rates[1] - rates[0]) @ inertia.T
    held = np.cross(attitude[1], end) - np.cross(attitude[0], start)
    torque = truth.torque_n_m[0] * stack.duration_s[:, None]
    impulse = end - start + body + held - torque
    shape_values = (one["tau_delay_s"], one["tau_rise_s"], one["tau_fall_s"])
    width = stack.on_time_s / stack.pulses
    force = arms[None] * truth.thrusts.thrust_n[0][:, None, :]

    matrix = force @ stack.response

    def solve(on_time: Array, pulses: Array) -> Array:
        # with the number of pulses given, a second more on-time is a second more of steady thrust
        for _ in range(MOST_STEPS):
            effective = effective_on_time(
                model.totals_rows.pulse_shape, on_time, pulses, *shape_values
            )
            missing = impulse - (force @ effective[..., None])[..., 0]
            step = np.linalg.solve(matrix, missing[..., None])
            on_time = on_time + (stack.response @ step)[..., 0]
            if np.abs(step).max() < SETTLED_S:
                return on_time
        raise CassiniBayesError("the simulated on-times did not settle")

    on_time = solve(stack.on_time_s, stack.on_time_s / width)
    for _ in range(20):  # more on-time means more pulses of the same width
        on_time = solve(on_time, on_time / width)
    pulses = np.maximum(np.rint(on_time / width), 1.0)
    on_time = solve(on_time, pulses)
    if on_time.min() <= 0:
        raise CassiniBayesError(f"a simulated on-time is negative: {on_time.min():.2f} s")
    step = float(one["on_time_resolution_s"])
    printed = np.rint(on_time / step) * step
    computed = _on_board_delta_v(model, printed, pulses, one, truth, rng)
    return tuple(
        replace(event, on_time_s=u, pulses=n, delta_v_m_s=v, source="simulation")
        for event, u, n, v in zip(template, printed, pulses, computed, strict=True)
    )


def _on_board_delta_v(
    model: Model,
    on_time: Array,
    pulses: Array,
    parameters: Mapping[str, Array],
    truth: Draws,
    rng: np.random.Generator,
) -> list[Array | None]:
    """What the flight software would print: its own thrust, mass and tail-off in it."""
    stack = model.totals_rows.stack
    if model.totals_rows.computed is None:
        return [None] * len(on_time)
    directions = thruster_directions(model.spacecraft, model.branch)
    impulse = on_time @ directions.T
    along = impulse / np.linalg.norm(impulse, axis=-1, keepdims=True)
    software = software_of(truth.integrated[0])[0]
    counted = software[0] * on_time + software[1] * pulses
    size = ((counted @ directions.T) * along).sum(-1) * stack.thrust_predicted_n / stack.mass_kg
    size = size + rng.normal(0.0, parameters["delta_v_noise_m_s"], len(size))
    step = float(parameters["delta_v_resolution_m_s"])
    return list(np.rint(size[:, None] * along / step) * step)


def _controlled(priors: Priors, control: Control) -> Priors:
    """Priors of a negative control: the hold rates taken as (almost) zero."""
    if control == "hold-rates-ignored":
        return priors.with_fixed("hold_rate_rad_s", CONTROL_HOLD_RATE)
    return priors


def _flatten(draws: Draws, model: Model) -> dict[str, Array]:
    """Every inferred scalar as name → (n,)."""
    names = [*model.space.names, *model.totals_rows.integrated]
    values = {**draws.parameters, **draws.integrated[0]}
    flat = {name: np.asarray(values[name]) for name in names}
    thrusts, torque = draws.thrusts, draws.torque_n_m
    flat["thrust_common_n"] = thrusts.common_n
    for k, thruster in enumerate(model.thrusters):
        flat[f"thrust_level_n[{thruster}]"] = thrusts.level_n[:, k]
    for e, event in enumerate(model.event_ids):
        for k, thruster in enumerate(model.thrusters):
            flat[f"thrust_n[{event},{thruster}]"] = thrusts.thrust_n[:, e, k]
        for c, axis in enumerate("xyz"):
            flat[f"external_torque_n_m[{event},{axis}]"] = torque[:, e, c]
    return flat
