"""The test-bed's wheel bias of paper 000 (section V), simulated."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from functools import partial
from typing import Final

import numpy as np

from cassini_bayes.computing.arrays import Array
from cassini_bayes.published import published_constants
from cassini_bayes.report.study_page import markdown_table
from cassini_bayes.simulation import Motion, SimulatedEvent, read_scenario
from cassini_bayes.spacecraft.pulses import PULSE_SHAPES
from cassini_bayes.studies.simulation.cases import SCENARIOS, simulated, with_settings

SEEDS: Final = range(1, 9)
DIGITS: Final = (2, 0, 0, 0, 1, 0, 3, 4, 3)


def naive_thrust_n(motion: Motion, thrusters: Sequence[str], lever_m: float) -> float:
    """Least-squares thrust from the Z balance at the samples (paper 000 eqs. 17, 22).

    ``thrusters`` of the −Z and +Z pair in the order (y1, y3, y2, y4), one lever for all.
    """
    time = motion.time_s
    momentum = motion.momentum_body_n_m_s()
    gyroscopic = np.cross(motion.rate_rad_s, momentum)
    steps = 0.5 * (gyroscopic[1:] + gyroscopic[:-1]) * np.diff(time)[:, None]
    integral = np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])
    balance = (momentum - momentum[0] + integral)[:, 2]
    logs = [motion.pulses[name].on_time_s(time) for name in thrusters]
    column = lever_m * (logs[2] + logs[3] - logs[0] - logs[1])
    return float(column @ balance / (column @ column))


def fsds_section() -> tuple[str, list[list[str]]]:
    """The FSDS case of paper 000 beside the paper's figures."""
    file = read_scenario(SCENARIOS / "fsds_2005.toml")
    lever = file.given()["thruster_lx_m"]
    header = [
        "case",
        "Y2 on-time [s]",
        *("pulses", "of 125 ms", "250 ms", "longer", "other thrusters"),
        *("naive thrust [N]", "effective / commanded", "corrected [N]"),
    ]
    rows = [["paper 000", *_paper_fsds_cells()]]
    for shape in ("first_order", "published_2005"):
        for name, updates in (("", {}), (", no hysteresis", {"hysteresis": 0.0})):
            propulsion = file.scenario.propulsion.model_copy(update={"pulse_shape": shape})
            rcs = file.scenario.rcs.model_copy(update=updates)
            changed = with_settings(file, propulsion=propulsion, rcs=rcs)
            result = [_figures(simulated(changed, seed)[0], lever) for seed in SEEDS]
            rows.append([f"{shape}{name}", *_cells(np.array(result))])
    return markdown_table(header, rows), [header, *rows]


def _paper_fsds_cells() -> list[str]:
    """What paper 000 prints of its case, in the order of the table."""
    value = partial(published_constants().value, "paper_000_fsds")
    short, longer, *longest = (round(value(f"pulses_{ms}_ms")) for ms in (125, 250, 500, 750))
    pulses = (short + longer + sum(longest), short, longer, sum(longest))
    thrust = ("estimated_thrust_n", "impulse_ratio", "corrected_thrust_n")
    return [
        f"{value('on_time_y2_s'):g}",
        *map(str, pulses),
        "–",
        *(f"{value(key):g}" for key in thrust),
    ]


def _figures(event: SimulatedEvent, lever: float) -> tuple[float, ...]:
    """The table's figures of one simulated event."""
    motion = event.motion
    widths = motion.pulses["y2"].width_s
    counted = Counter(round(1e3 * w) for w in widths)
    taus = [event.plan.parameters[f"tau_{which}_s"] for which in ("delay", "rise", "fall")]
    shape = PULSE_SHAPES[event.plan.propulsion.pulse_shape]
    ratio = float(np.sum(shape.effective_time(widths, *taus)) / np.sum(widths))
    thrust = naive_thrust_n(motion, ("y1", "y3", "y2", "y4"), lever)
    others = sum(log.width_s.size for k, log in motion.pulses.items() if k not in ("y2", "y4"))
    longer = widths.size - counted[125] - counted[250]
    return (
        *(float(widths.sum()), widths.size, counted[125], counted[250], longer, others),
        *(thrust, ratio, thrust / ratio),
    )


def _cells(found: Array) -> list[str]:
    """Mean ± standard deviation over seeds (rows of ``found``), each with its digits."""
    return [
        f"{mean:.{digits}f} ± {spread:.{digits}f}"
        for mean, spread, digits in zip(
            found.mean(axis=0), found.std(axis=0, ddof=1), DIGITS, strict=True
        )
    ]
