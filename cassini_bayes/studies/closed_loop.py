"""The same bias in the closed-loop simulation, for comparison (``predict --simulate``)."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from typing import Any, Final

import numpy as np

from cassini_bayes.computing.arrays import Array
from cassini_bayes.errors import InputError
from cassini_bayes.prediction.learning import Learned
from cassini_bayes.prediction.predict import thrusts_at
from cassini_bayes.prediction.requests import BiasRequest

RCS: Final = {"rate_gain_s": 10.0, "hysteresis": 0.15, "rate_knowledge_rad_s": 5e-5}
"""Settings of the controller that come nearest to flight (docs/results/simulation-findings.md)."""
START_RATE_RAD_S: Final = 2e-5
_THRUSTS: Final = 1  # stream of the event's own departures of thrust


@dataclass(frozen=True)
class ClosedLoop:
    """Simulated biases, one per row: on-times (n, K) s, pulses (n, K), durations (n,) s."""

    on_time_s: Array
    pulses: Array
    duration_s: Array


def simulate_request(learned: Learned, request: BiasRequest, seeds: int, seed: int) -> ClosedLoop:
    """Fly the bias in closed loop with ``seeds`` draws of the fitted physics.

    Raises
    ------
    InputError
        Without a mass of the spacecraft (the simulation needs one), fewer than one seed, or a fit
        with effects.
    """
    from cassini_bayes.simulation import make_plan, simulate_plan
    from cassini_bayes.simulation.reader import scenario_of
    from cassini_bayes.studies.scenario import draw_truth

    if seeds < 1:
        raise InputError("--simulate", "at least one simulation", str(seeds), "ask for 1 or more")
    if names := ", ".join(effect.name for effect in learned.model.effects):
        fix = "leave --simulate out, or simulate a scenario with these effects in it"
        raise InputError("--simulate", "a fit of the standard physics", f"one with {names}", fix)
    if learned.mass is None:
        raise InputError("--simulate", "masses in the fit's events", "none", "fill in mass_kg")
    epoch = request.epoch or learned.last_epoch
    rng = np.random.default_rng((seed, _THRUSTS))
    thrusts = thrusts_at(learned, epoch, rng, still=False)
    rows = []
    for draw in range(min(seeds, learned.size)):
        document = _document(learned, request, draw, epoch, thrusts[draw])
        file = scenario_of(document, where="predict --simulate", craft=learned.model.spacecraft)
        truth = draw_truth(file, seed + draw)
        event = file.scenario.event[0]
        plan = make_plan(file.scenario, file.spacecraft, event, truth)
        motion = simulate_plan(plan, file.scenario, seed + draw).motion
        logs = [motion.pulses[name] for name in learned.model.thrusters]
        rows.append(
            (
                [float(log.width_s.sum()) for log in logs],
                [float(log.width_s.size) for log in logs],
                float(motion.duration_s),
            )
        )
    on_time, pulses, lasts = zip(*rows, strict=True)
    return ClosedLoop(np.array(on_time), np.array(pulses), np.array(lasts))


def _document(
    learned: Learned, request: BiasRequest, draw: int, epoch: datetime, thrust_n: Array
) -> dict[str, Any]:
    """A scenario of one bias with the physics of one draw, and its thrusts (K,) then."""
    model, physics = learned.model, learned.physics
    wheels = tuple(w.number for w in model.spacecraft.wheels if w.number in request.wheels)
    order = [request.wheels.index(number) for number in wheels]
    used = {
        name
        for wheel in model.spacecraft.wheels
        if wheel.number in wheels
        for name in wheel.parameters
    }
    used |= set(model.spacecraft.geometry_of(model.branch).parameters)
    wanted = ("tau_", "cm_", "inertia_")
    truth: dict[str, Any] = {
        name: float(np.broadcast_to(value, (physics.size,))[draw])
        for name, value in physics.parameters.items()
        if name.startswith(wanted) or name in used
    }
    truth["thrust_common_n"] = float(thrust_n.mean())
    truth["thrust_individual_n"] = {
        name: float(thrust_n[k] - thrust_n.mean()) for k, name in enumerate(model.thrusters)
    }
    assert learned.mass is not None
    truth["mass_kg"] = float(learned.mass.at(epoch)[draw])
    return {
        "spacecraft": {
            "name": model.spacecraft.name,
            "branch": model.branch,
            "wheels": list(wheels),
        },
        "truth": truth,
        "rcs": dict(RCS),
        "start": {"attitude_spread": 1.0, "rate_rad_s": START_RATE_RAD_S},
        "propulsion": {"pulse_shape": model.totals_rows.pulse_shape.name},
        "event": [
            {
                "id": "bias",
                "kind": "bias",
                "epoch": epoch,
                "from_rpm": [float(request.start_rpm[i]) for i in order],
                "to_rpm": [float(request.end_rpm[i]) for i in order],
            }
        ],
    }
