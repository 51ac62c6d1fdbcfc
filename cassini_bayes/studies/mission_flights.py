"""Simulated missions with known failures: fitted event by event, beside the rules of paper 003.

Everything is drawn from the priors file: levels, ageing, pressure law, tail-offs, and for every
thruster whether, when and by how much it fails. Biases are those of the flight, scaled, run
backwards and flown by either branch; their on-times are solved for by the mechanism of
``docs/topics/totals-likelihood.md`` §3, not through the likelihood.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from functools import partial
from pathlib import Path
from typing import Any, ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from cassini_bayes.computing.arrays import Array
from cassini_bayes.events.totals import TotalsEvent, read_totals
from cassini_bayes.model.draws import Draws
from cassini_bayes.model.mission.circumstances import EventFacts, circumstances_of
from cassini_bayes.model.mission.losses import Loss, loss_prior
from cassini_bayes.model.mission.mission_file import MissionTable, check_mission
from cassini_bayes.model.mission.model import BranchAt, BranchThrusts, MissionModel, build_mission
from cassini_bayes.model.terms import TORQUE
from cassini_bayes.model.thrusts import ThrustDraws
from cassini_bayes.priors.reader import Priors, read_priors
from cassini_bayes.results.mission.fitting import EarlierDraws, Losses, fit_mission
from cassini_bayes.results.mission.trend import LEAST_ON_TIME_S, draw_branches
from cassini_bayes.results.ranks import rank
from cassini_bayes.spacecraft.description import CONTROL_CYCLE_S
from cassini_bayes.studies.bias_estimates import bias_estimates
from cassini_bayes.studies.interim_analyses import analyses
from cassini_bayes.studies.repeated import Repeated
from cassini_bayes.studies.totals_calibration import simulate_totals, with_room

MODULE: Final = "studies.mission_flights"
FEWEST_BIASES, MOST_BIASES = 20, 60
START: Final = datetime(2005, 1, 1, tzinfo=UTC)
RECHARGE: Final = datetime(2006, 4, 10, tzinfo=UTC)
SWAP: Final = datetime(2009, 3, 12, tzinfo=UTC)
END: Final = datetime(2012, 1, 1, tzinfo=UTC)
PRESSURES: Final = (
    (START, 1_800.0),
    (RECHARGE - timedelta(seconds=1), 1_700.0),
    (RECHARGE, 2_700.0),
    (END, 2_000.0),
)
"""Readings near those of the flight (255 psia in 2005, 400 psia after the recharge), kPa."""
OPPOSITE: Final = (2, 3, 0, 1, 5, 4, 7, 6)
"""Thruster that answers the opposite demand: z1 and z3, z2 and z4, y1 and y2, y3 and y4."""
FIXED: Final = (
    *(f"inertia_{e}_kg_m2" for e in ("xx", "yy", "zz", "xy", "xz", "yz")),
    *("thruster_lx_m", "thruster_ly_m", "thruster_lzy_m", "thruster_lzz_m"),
    *(f"rwa{n}_inertia_kg_m2" for n in (1, 2, 3, 4)),
    *("rwa4_tilt_u_rad", "rwa4_tilt_v_rad", "tail_ageing_per_year", "tail_pressure_exponent"),
)
"""Nuisances held at their means: they shift all of a thruster's estimates alike."""
ROOM_S: Final = 10.0
MOST_FAILING: Final = 2
FIRST_ANALYSIS, EVERY = 6, 2
DRAWS, PROPOSALS = 400, 800


@dataclass(frozen=True)
class MissionFlights(Repeated):
    """What a study of simulated missions runs: template events, priors, seed."""

    events: Path
    priors: Path
    per_file: ClassVar[int] = 2

    def repetition(self, index: int) -> Mapping[str, NDArray[Any]]:
        """Draw, fly and fit one mission, event by event; one row per branch and thruster.

        ``failed`` and ``alarm`` hold the event of the branch at which a thruster failed, and at
        which the fit first gave it an alarm (−1: never).
        """
        rng, priors = self.stream(index), study_priors(self.priors)
        return judge_flight(fly(self.events, priors, rng), priors, rng)


@dataclass(frozen=True)
class Flown:
    """A simulated mission: its events, the table that describes it, and the truth."""

    events: tuple[TotalsEvent, ...]
    table: MissionTable
    model: MissionModel
    z: Array  # (1, d) of the truth
    losses: Mapping[str, tuple[Loss, ...]]
    shares: Mapping[str, Array]
    shared: Mapping[str, Array]  # branch → (q,) coefficients


def study_priors(path: Path) -> Priors:
    """The priors with most nuisances held."""
    priors = read_priors(path)
    for name in FIXED:
        priors = priors.with_fixed(name, priors.parameters[name].mean)
    branches = {
        branch: {name: prior for name, prior in table.items() if name not in FIXED}
        for branch, table in priors.of_branches.items()
    }
    return replace(priors, of_branches=branches)


def mission_table() -> MissionTable:
    """The mission file of all simulated missions."""
    table: dict[str, object] = {
        "events": ["events.csv"],
        "priors": "priors.toml",
        "dated": [
            {"epoch": RECHARGE, "what": "recharge", "source": "paper 001"},
            {"epoch": SWAP, "what": "branch_swap", "branch": "B", "source": "paper 001"},
        ],
        "pressure": {
            "reference_kpa": 1758.0,
            "readings": [{"epoch": at, "kpa": kpa} for at, kpa in PRESSURES],
        },
        "trend": {"reference_epoch": START},
    }
    return check_mission(table, "simulated mission")


def fly(events: Path, priors: Priors, rng: np.random.Generator) -> Flown:
    """A mission with everything drawn from the priors."""
    spacecraft = priors.spacecraft
    number = int(rng.integers(FEWEST_BIASES, MOST_BIASES + 1))
    epochs = sorted(START + (END - START) * share for share in rng.uniform(0.0, 1.0, number))
    flight = read_totals(events, spacecraft)
    template = tuple(
        _bias(flight[int(rng.integers(len(flight)))], f"{i:03d}", epoch, rng)
        for i, epoch in enumerate(epochs)
    )
    table = mission_table()
    model = _model(template, table, priors)
    z = rng.standard_normal((1, model.space.dimension))
    losses: dict[str, tuple[Loss, ...]] = {}
    shares: dict[str, Array] = {}
    shared: dict[str, Array] = {}
    thrusts: dict[str, Array] = {}
    branches, _ = model.at(z)
    prior = loss_prior(priors)
    for branch in branches:
        own, name = branch.thrusts, branch.thrusts.branch
        failing = np.flatnonzero(rng.uniform(size=len(own.thrusters)) < prior.probability)
        failing = rng.permutation(failing)[:MOST_FAILING] if len(own.events) > 1 else failing[:0]
        losses[name] = tuple(Loss(int(k), int(rng.integers(1, len(own.events)))) for k in failing)
        shares[name] = np.abs(prior.scale * rng.standard_normal((len(failing),)))
        shared[name] = rng.standard_normal((own.levels.shape[1] + own.ageing.shape[1],))
        thrusts[name] = _true_thrusts(
            own, branch.scale[0], losses[name], shares[name], shared[name], rng
        )
    flown = list(template)
    parameters = model.space.to_parameters(z)
    for part in model.parts:
        own = next(b for b in model.branches if b.branch == part.branch)
        truth = Draws(
            part.parameters_at(parameters, np.ones(1), 0.0),
            ThrustDraws(thrusts[part.branch][None, part.places], np.zeros(1), np.zeros((1, 8))),
            ({TORQUE: part.model.torque_mean_n_m + part.model.torque_sd_n_m
              * rng.standard_normal((1, len(part.places), 3))},),
        )  # fmt: skip
        rows = simulate_totals(part.model.totals_rows.rows, part.model, truth, rng)
        for place, row in zip(own.events[part.places], rows, strict=True):
            flown[int(place)] = row
    return Flown(tuple(flown), table, _model(flown, table, priors), z, losses, shares, shared)


def _bias(event: TotalsEvent, name: str, epoch: datetime, rng: np.random.Generator) -> TotalsEvent:
    """A flight bias, scaled and perhaps run backwards, flown by the branch of its date.

    The thrusters of the flight had less thrust than pressures and tail-offs of the priors may give:
    the limit cycle gets more room, so that no on-time comes out negative.
    """
    size, backwards = rng.uniform(0.7, 1.3), rng.uniform() < 0.5
    start, end = event.rwa_start_rpm * size, event.rwa_end_rpm * size
    on_time, pulses = size * (event.on_time_s + ROOM_S), np.asarray(event.pulses)
    pulses = pulses + ROOM_S / CONTROL_CYCLE_S
    if backwards:
        start, end = end, start
        on_time, pulses = on_time[list(OPPOSITE)], pulses[list(OPPOSITE)]
    before = epoch < SWAP
    return with_room(
        replace(
            event,
            id=name,
            epoch=epoch,
            branch="A" if before else "B",
            wheels=(1, 2, 3) if before else event.wheels,
            rwa_start_rpm=start,
            rwa_end_rpm=end,
            on_time_s=on_time,
            pulses=np.maximum(np.rint(pulses * size), on_time > 0),
            delta_v_m_s=None,
            delta_v_source=None,
        )
    )


def _model(events: Sequence[TotalsEvent], table: MissionTable, priors: Priors) -> MissionModel:
    facts = [EventFacts(e.id, e.epoch, e.branch, True, None) for e in events]
    where = "simulated"
    return build_mission(table, priors, events, circumstances_of(table, facts, where), where)


def _true_thrusts(
    own: BranchThrusts,
    scale: Array,
    losses: Sequence[Loss],
    shares: Array,
    shared: Array,
    rng: np.random.Generator,
) -> Array:
    """Thrusts (E, K) of a branch from drawn coefficients, losses and departures."""
    level = own.common_n + own.rows(own.years) @ shared
    for loss, share in zip(losses, shares, strict=True):
        level[loss.onset :, loss.thruster] -= own.common_n * share
    departures = rng.standard_normal((len(own.events), own.departures.shape[1])) @ own.departures.T
    return np.asarray(scale[:, None] * level + departures)


def judge_flight(
    flown: Flown, priors: Priors, rng: np.random.Generator
) -> Mapping[str, NDArray[Any]]:
    """Fit a mission event by event; each rule's verdict on every thruster, branch A then B."""
    prior, names = loss_prior(priors), ("A", "B")
    chances = np.zeros((2, MOST_BIASES, 8))

    def note(events: int, weighed: Sequence[Losses]) -> None:
        for losses in weighed:
            branch = next(b for b in flown.model.branches if b.branch == losses.branch)
            last = int((branch.events < events).sum()) - 1
            chances[names.index(losses.branch), last] = losses.failing(8)

    whole = len(flown.events)
    counts = range(FIRST_ANALYSIS + (whole - FIRST_ANALYSIS) % EVERY, whole, EVERY)
    first = _model(flown.events[: counts[0]], flown.table, priors)
    fit = partial(fit_mission, draws=DRAWS, proposals=PROPOSALS)
    begun = fit(first, prior, rng)
    note(counts[0], begun.losses)
    earlier: EarlierDraws = begun
    untrusted = 0
    for interim in analyses(flown.model, prior, earlier, counts[1:], DRAWS, rng):
        note(interim.events, interim.losses)
        untrusted, earlier = untrusted + (not interim.trusted), interim.draws
    fits = fit(flown.model, prior, rng, earlier=earlier)
    note(whole, fits.losses)
    drawn = draw_branches(fits, rng).branches
    estimates = bias_estimates(flown.model, flown.events)
    result: dict[str, NDArray[Any]] = {
        "converged": np.array(fits.converged),
        "untrusted": np.array(untrusted),
        "looks": np.array(len(counts) - 1),
        "chances": chances,
        "estimates": np.full((2, MOST_BIASES, 8), np.nan),
        "events": np.zeros(2),
        "failed": np.full((2, 8), -1.0),
        "share": np.zeros((2, 8)),
        "onset": np.full((2, 8), -1.0),
        "oracle": np.full((2, 8), -1.0),
        "onset_rank": np.full((2, 8), np.nan),
        "slope_rank": np.full(2, np.nan),
        "fired": np.zeros((2, MOST_BIASES, 8), dtype=bool),
    }
    truth, _ = flown.model.at(flown.z)
    for at, losses in zip(truth, fits.losses, strict=True):
        thrusts = at.thrusts
        place, count = names.index(thrusts.branch), len(thrusts.events)
        result["events"][place] = count
        result["estimates"][place, :count] = estimates[thrusts.branch]
        fired = np.array([flown.events[i].on_time_s for i in thrusts.events]) > LEAST_ON_TIME_S
        result["fired"][place, :count] = fired
        for loss, share in zip(
            flown.losses[thrusts.branch], flown.shares[thrusts.branch], strict=True
        ):
            k = loss.thruster
            onset = losses.onsets(k, count)
            result["failed"][place, k], result["share"][place, k] = loss.onset, share
            if onset.any():
                result["onset"][place, k] = int(np.argmax(onset))
                likely = rng.choice(count, size=200, p=onset).astype(float)
                result["onset_rank"][place, k] = rank(likely, float(loss.onset), rng)
        for k, likeliest in _oracle_onsets(at, flown).items():
            result["oracle"][place, k] = likeliest
        of_branch = drawn[thrusts.branch]
        true = replace(of_branch, shared=flown.shared[thrusts.branch][None]).slope
        result["slope_rank"][place] = rank(of_branch.slope, float(true[0]), rng)
    values = flown.model.space.to_parameters(flown.z)
    walked = fits.model.space.to_parameters(fits.z)
    ranked = [n for n in fits.model.space.names if np.ndim(values[n])]
    result["names"] = np.array(ranked)
    result["ranks"] = np.array(
        [rank(np.asarray(walked[n]), float(np.asarray(values[n])[0]), rng) for n in ranked]
    )
    return result


def _oracle_onsets(branch: BranchAt, flown: Flown) -> dict[int, int]:
    """Likeliest onset of every failing thruster for one who knows everything else exactly."""
    thrusts = branch.thrusts
    shared = flown.shared[thrusts.branch]
    scale = branch.scale[0]
    level = thrusts.common_n + thrusts.rows(thrusts.years) @ shared
    result = {}
    losses, shares = flown.losses[thrusts.branch], flown.shares[thrusts.branch]
    for i, loss in enumerate(losses):
        known = level.copy()
        for j, other in enumerate(losses):
            if j != i:
                known[other.onset :, other.thruster] -= thrusts.common_n * shares[j]
        mean = scale[:, None] * known - thrusts.reference_n[:, None]
        left = branch.information.about(mean[None]).without_departures(thrusts.departures)
        lost = -thrusts.common_n * scale * shares[i]
        k = loss.thruster
        gain = lost * left.vector[0, :, k] - 0.5 * lost**2 * left.matrix[0, :, k, k]
        total = np.flip(np.cumsum(np.flip(gain)))
        result[k] = 1 + int(np.argmax(total[1:]))
    return result
