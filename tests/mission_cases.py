"""Small missions of both branches, made of the flight events."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime
from typing import Any

import numpy as np
from totals_cases import FLIGHT, ROOT

from cassini_bayes.events.totals import TotalsEvent, read_totals
from cassini_bayes.model.mission.circumstances import Circumstances, EventFacts, circumstances_of
from cassini_bayes.model.mission.mission_file import MissionTable, check_mission
from cassini_bayes.model.mission.model import MissionModel, build_mission
from cassini_bayes.priors.reader import Priors, read_priors

PRIORS = ROOT / "priors" / "cassini_mission.toml"
DAY = 86_400.0


def mission_table(**changes: Any) -> MissionTable:
    """A mission with a recharge, a swap and pressures between 1758 and 2700 kPa."""
    table: dict[str, Any] = {
        "events": ["events.csv"],
        "priors": str(PRIORS),
        "dated": [
            {"epoch": utc(2006, 4, 10), "what": "recharge", "source": "paper 001"},
            {
                "epoch": utc(2009, 3, 12),
                "what": "branch_swap",
                "branch": "B",
                "source": "paper 001",
                "change": {
                    "cm_y_m": {"loc": 0.004, "scale": 0.01, "unit": "m", "source": "made up"}
                },
            },
        ],
        "pressure": {
            "reference_kpa": 1758.0,
            "readings": [
                {"epoch": utc(2005, 1, 1), "kpa": 1800.0},
                {"epoch": utc(2006, 4, 9), "kpa": 1700.0},
                {"epoch": utc(2006, 4, 11), "kpa": 2700.0},
                {"epoch": utc(2011, 1, 1), "kpa": 2100.0},
            ],
        },
        "trend": {"reference_epoch": utc(2005, 1, 1)},
    }
    return check_mission({**table, **changes}, "mission.toml")


def utc(year: int, month: int, day: int) -> datetime:
    """A day."""
    return datetime(year, month, day, tzinfo=UTC)


def a_branch_event(event: TotalsEvent, name: str, epoch: datetime) -> TotalsEvent:
    """The same bias flown by the A branch on wheels 1, 2 and 3, before wheel 4 replaced wheel 3."""
    return replace(event, id=name, epoch=epoch, branch="A", wheels=(1, 2, 3))


def mixed_events() -> tuple[TotalsEvent, ...]:
    """Two events of the A branch (wheels 1 2 3), two of the B branch (wheels 1 2 4)."""
    priors = read_priors(PRIORS)
    flown = read_totals(FLIGHT, priors.spacecraft)
    return (
        a_branch_event(flown[1], "2005-a", utc(2005, 3, 1)),
        a_branch_event(flown[3], "2007-a", utc(2007, 3, 1)),
        flown[0],
        flown[2],
    )


def facts_of(events: Sequence[TotalsEvent]) -> list[EventFacts]:
    """What the mission has to know of totals rows."""
    return [EventFacts(e.id, e.epoch, e.branch, True, None) for e in events]


def mission_of(
    events: Sequence[TotalsEvent], table: MissionTable, priors: Priors | None = None
) -> MissionModel:
    """The model of totals rows in a mission."""
    where = "mission.toml"
    circumstances: Circumstances = circumstances_of(table, facts_of(events), where)
    return build_mission(table, priors or read_priors(PRIORS), events, circumstances, where)


def values_at(model: MissionModel, z: np.ndarray) -> dict[str, float]:
    """Mission parameters of one point as floats."""
    found = model.space.to_parameters(z[None])
    return {k: float(np.asarray(v).reshape(-1)[0]) for k, v in found.items()}
