"""Mission files and circumstances: pressures by three ways, and what is refused in one line."""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, date, datetime
from typing import Any

import numpy as np
import pytest
from mission_cases import facts_of, mission_of, mission_table, mixed_events, utc
from totals_cases import ROOT

from cassini_bayes.errors import InputError
from cassini_bayes.model.mission.circumstances import EventFacts, circumstances_of
from cassini_bayes.model.mission.mission_file import MissionTable, check_mission

USED = {"used": [{"epoch": utc(2005, 1, 1), "kg": 0.0}, {"epoch": utc(2010, 1, 1), "kg": 50.0}]}
KNOWN_DRIFT = {"loc": 0.001, "scale": 0.0, "unit": "m/kg", "source": "x"}


def pressures(facts: list[EventFacts], **changes: Any) -> np.ndarray:
    """Pressures of events, kPa."""
    found = circumstances_of(mission_table(**changes), facts, "mission.toml")
    return found.tank.pressures_kpa(np.ones(1))[0]


def fact(name: str, epoch: datetime, branch: str = "A", kpa: float | None = None) -> EventFacts:
    """An event that fires."""
    return EventFacts(name, epoch, branch, True, kpa)


def test_pressure_is_the_events_own_else_between_readings() -> None:
    """Its own telemetry counts first; readings are linear in time."""
    middle = utc(2005, 1, 1) + (utc(2006, 4, 9) - utc(2005, 1, 1)) / 2
    found = pressures([fact("own", middle, kpa=1777.0), fact("table", middle)])
    np.testing.assert_allclose(found, [1777.0, 1750.0])


def test_no_reading_is_taken_across_a_recharge() -> None:
    """Between the last reading before and the first after there is no pressure: refused."""
    between = utc(2006, 4, 10)
    with pytest.raises(InputError, match=r"event x: expected a tank pressure, got none"):
        pressures([fact("x", between)])


def test_blowdown_law_follows_the_gas() -> None:
    """p V = constant by hand, anew after the recharge, with a factor on the mass used."""
    table = {
        "pressure": {
            "reference_kpa": 1800.0,
            "blowdown": {
                "start_kpa": 2000.0,
                "ullage_m3": 0.05,
                "density_kg_m3": 1000.0,
                "recharge_kpa": 2700.0,
            },
        },
        "propellant": {
            "used": [
                {"epoch": utc(2005, 1, 1), "kg": 0.0},
                {"epoch": utc(2006, 1, 1), "kg": 10.0},
                {"epoch": utc(2006, 4, 10), "kg": 10.0},
                {"epoch": utc(2007, 4, 10), "kg": 15.0},
            ],
            "computed": True,
        },
    }
    facts = [fact("a", utc(2006, 1, 1)), fact("b", utc(2007, 4, 10))]
    tank = circumstances_of(mission_table(**table), facts, "m").tank
    assert tank.is_circular
    expected = [[2000 * 0.05 / 0.06, 2700 * 0.06 / 0.065], [2000 * 0.05 / 0.07, 2700 * 0.07 / 0.08]]
    np.testing.assert_allclose(tank.pressures_kpa(np.array([1.0, 2.0])), expected)


LAW = {"start_kpa": 2635.0, "ullage_m3": 0.05, "density_kg_m3": 1004.0, "recharge_kpa": 2700.0}


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"pressure": {"reference_kpa": 1758.0, "blowdown": LAW}}, "event late: expected a date"),
        ({"drift": {"cm_x_m": KNOWN_DRIFT}}, r"event late: .*2010-01-01 .*; add an entry after it"),
        (
            {
                "drift": {"cm_x_m": KNOWN_DRIFT},
                "trend": {"reference_epoch": utc(2004, 12, 31)},
            },
            r"reference_epoch: expected a date from 2005-01-01 .*; add an entry before it",
        ),
    ],
)
def test_hydrazine_is_not_taken_beyond_its_table(given: dict[str, Any], message: str) -> None:
    """It does not stand still after the last entry; who has its own pressure asks for none."""
    facts = [fact("early", utc(2005, 3, 1)), fact("late", utc(2010, 3, 1), "B")]
    with pytest.raises(InputError, match=message) as refused:
        circumstances_of(mission_table(propellant=USED, **given), facts, "mission.toml")
    assert "\n" not in str(refused.value)
    own = mission_table(propellant=USED, pressure={"reference_kpa": 1758.0, "blowdown": LAW})
    facts[1] = replace(facts[1], pressure_kpa=2000.0)
    still = replace(facts[1], id="still", fires=False, pressure_kpa=None)
    tank = circumstances_of(own, [*facts, still], "mission.toml").tank
    assert np.isnan(tank.known_kpa).tolist() == [True, False, False]
    kg = 50.0 * (utc(2005, 3, 1) - utc(2005, 1, 1)) / (utc(2010, 1, 1) - utc(2005, 1, 1))
    expected = 2635.0 * 0.05 / (0.05 + kg / 1004.0)
    np.testing.assert_allclose(tank.pressures_kpa(np.ones(1))[0, :2], [expected, 2000.0])


def test_gas_at_a_recharge_before_the_table_is_unknown() -> None:
    """The hydrazine used by then is part of the volume that the law starts anew from."""
    used = [{"epoch": utc(2007, 1, 1), "kg": 40.0}, {"epoch": utc(2010, 1, 1), "kg": 50.0}]
    with pytest.raises(InputError, match="event x: the recharge before it: expected a date"):
        pressures(
            [fact("x", utc(2008, 1, 1))],
            pressure={"reference_kpa": 1758.0, "blowdown": LAW},
            propellant={"used": used},
        )


@pytest.mark.parametrize(
    ("facts", "message"),
    [
        (
            [fact("a", utc(2005, 3, 1), kpa=255.0)],
            r"kPa, not far from the reference of 1758 kPa, got 255; if it is psia, write 1758 kPa",
        ),
        (
            [fact("late", utc(2007, 1, 1)), fact("early", utc(2005, 3, 1))],
            r"events: early: expected events in order of time: none before late",
        ),
        (
            [fact("a", utc(2010, 3, 1), branch="A")],
            r"branch: expected branch B, in use since the swap of 2009-03-12",
        ),
        (
            [fact("a", utc(2007, 3, 1)), fact("b", utc(2008, 3, 1), branch="B")],
            r"event b: branch: expected another branch before the swap to B of 2009-03-12",
        ),
    ],
)
def test_events_that_cannot_be_are_refused(facts: list[EventFacts], message: str) -> None:
    """A pressure in psia, events out of order, a branch out of use: one line with the fix."""
    with pytest.raises(InputError, match=message) as refused:
        circumstances_of(mission_table(), facts, "mission.toml")
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("epoch", "branch", "message"),
    [
        (
            utc(2012, 1, 1),
            "C",
            r"trend\.forecast\[1\]\.branch: expected .* fires \(A, B\), got 'C'",
        ),
        (utc(2009, 8, 1), "B", r"forecast\[1\]\.epoch: expected a date not before the last event"),
        (date(2005, 1, 1), "A", r"last event of branch A, 2007-a of 2007-03-01.*got 2005-01-01"),
    ],
)
def test_forecasts_that_cannot_be_are_refused(
    epoch: datetime | date, branch: str, message: str
) -> None:
    """Of a branch without events, or of a date before some loss had set in; another branch's
    events may be later, and the date of the last event will do.
    """
    facts = facts_of(mixed_events())

    def asking(when: datetime | date, what: str) -> MissionTable:
        forecast = [{"epoch": when, "branch": what, "pressure_kpa": 2000.0}]
        trend = {"reference_epoch": utc(2005, 1, 1), "forecast": forecast}
        return mission_table(trend=trend)

    circumstances_of(asking(utc(2007, 3, 1), "A"), facts, "mission.toml")
    with pytest.raises(InputError, match=message):
        circumstances_of(asking(epoch, branch), facts, "mission.toml")
    still = [replace(event, fires=event.branch == "A") for event in facts]
    with pytest.raises(InputError, match=r"fires \(A\), got 'B'"):
        circumstances_of(asking(utc(2012, 1, 1), "B"), still, "mission.toml")


def swap_to(branch: str, epoch: Any) -> dict[str, Any]:
    """A dated swap."""
    return {"epoch": epoch, "what": "branch_swap", "branch": branch, "source": "x"}


def test_swaps_there_and_back_are_read() -> None:
    """To B, back to A, and to B again."""
    dates = zip("BAB", (2009, 2010, 2011), strict=True)
    mission = mission_table(dated=[swap_to(b, utc(year, 3, 12)) for b, year in dates])
    assert [fact.branch for fact in mission.dated] == ["B", "A", "B"]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"dated": [{"what": "branch_swap", "branch": "B", "source": "x"}]}, "epoch"),
        (
            {"dated": [{"epoch": utc(2009, 3, 12), "what": "branch_swap", "source": "x"}]},
            r"dated\[1\].branch: expected the branch in use from then on",
        ),
        (
            {"dated": [swap_to("B", utc(2009, 3, 12)), swap_to("B", utc(2010, 3, 12))]},
            r"dated\[2\].branch: expected another branch than B, in use since .* 2009-03-12",
        ),
        ({"dated": [{"epoch": utc(2009, 3, 12), "what": "swop", "source": "x"}]}, "branch_swap"),
        ({"pulse_shape": "square"}, "pulse_shape: expected one of"),
        ({"drift": {"cm_x_m": KNOWN_DRIFT}}, r"propellant: .*which \[drift\] needs, got no such"),
        ({"spacecraft": {"nam": "voyager"}}, r"spacecraft\.nam: .*did you mean 'name'"),
    ],
)
def test_mission_files_that_cannot_be_are_refused(change: dict[str, Any], message: str) -> None:
    """A swap without a date or branch, or to that in use; an unknown fact or pulse."""
    with pytest.raises(InputError, match=message):
        mission_table(**change)


@pytest.mark.parametrize("degraded", [2, 0.0, 1.0, -3.0, np.nan, np.inf])
def test_losses_are_shares_of_thrust(degraded: float) -> None:
    """Per cent are a likely slip: the table had rows of losses beyond all thrust."""
    trend = {"reference_epoch": utc(2005, 1, 1), "degraded": [0.02, degraded]}
    with pytest.raises(InputError, match=r"trend\.degraded\[2\]: expected a (share|finite)"):
        mission_table(trend=trend)


@pytest.mark.parametrize("number", [np.nan, np.inf])
@pytest.mark.parametrize(
    ("key", "table"),
    [
        ("loc", lambda x: {"drift": {"cm_x_m": {**KNOWN_DRIFT, "loc": x}}}),
        ("scale", lambda x: {"drift": {"cm_x_m": {**KNOWN_DRIFT, "scale": x}}}),
        ("reference_kpa", lambda x: {"pressure": {"reference_kpa": x}}),
        (
            r"readings\[1\].kpa",
            lambda x: {
                "pressure": {
                    "reference_kpa": 1758.0,
                    "readings": [{"epoch": utc(2005, 1, 1), "kpa": x}],
                }
            },
        ),
        (
            r"used\[1\].kg",
            lambda x: {"propellant": {"used": [{"epoch": utc(2005, 1, 1), "kg": x}]}},
        ),
        (
            r"forecast\[1\].pressure_kpa",
            lambda x: {
                "trend": {
                    "reference_epoch": utc(2005, 1, 1),
                    "forecast": [{"epoch": utc(2012, 1, 1), "branch": "B", "pressure_kpa": x}],
                }
            },
        ),
    ],
)
def test_numbers_of_a_mission_are_finite(
    key: str, table: Callable[[float], dict[str, Any]], number: float
) -> None:
    """TOML has inf and nan; no mass, pressure or change is one."""
    with pytest.raises(InputError, match=rf"{key}: expected a finite number"):
        mission_table(**table(number))


def test_readings_out_of_order_are_refused() -> None:
    """The place in the list is named."""
    readings = [
        {"epoch": utc(2006, 1, 1), "kpa": 1700.0},
        {"epoch": utc(2005, 1, 1), "kpa": 1800.0},
    ]
    with pytest.raises(InputError, match=r"pressure.readings\[2\]: expected an epoch not before"):
        mission_table(pressure={"reference_kpa": 1758.0, "readings": readings})


def test_pressures_in_two_units_are_refused() -> None:
    """A reference in psia beside readings in kPa, or a forecast or a law in psia; pressures that a
    tank spans go through, and a forecast where the mission has none.
    """
    facts = [fact("a", utc(2005, 3, 1), kpa=1758.0)]

    def table(reference: float, forecast: float, start: float = 2635.0) -> dict[str, Any]:
        asked = {"epoch": utc(2012, 1, 1), "branch": "A", "pressure_kpa": forecast}
        return {
            "pressure": {"reference_kpa": reference, "blowdown": {**LAW, "start_kpa": start}},
            "propellant": USED,
            "trend": {"reference_epoch": utc(2005, 1, 1), "forecast": [asked]},
        }

    for given, message in (
        (table(255.0, 255.0), r"1758; if the reference is psia, write 1758 kPa"),
        (table(1758.0, 255.0), r"forecast\[1\]\.pressure_kpa: .* if it is psia, write 1758 kPa"),
        (table(1758.0, 2000.0, 382.0), r"blowdown\.start_kpa: .* if it is psia, write 2634 kPa"),
    ):
        with pytest.raises(InputError, match=message):
            pressures(facts, **given)
    pressures(facts, **table(1000.0, 3999.0))
    pressures(facts, **{**table(1758.0, 1.0), "pressure": None})


def test_only_what_may_change_does() -> None:
    """A fact cannot change a thrust, and its unit has to be the parameter's."""
    events = mixed_events()
    for name, unit, message in (
        ("thrust_common_n", "N", "a parameter of centre of mass"),
        ("cm_y_m", "mm", "unit: expected 'm', got 'mm'"),
        ("cm_y_m", "mm", r"^mission\.toml: dated\[1\]\.change\.cm_y_m\.unit: "),
    ):
        change = {name: {"loc": 0.0, "scale": 0.01, "unit": unit, "source": "x"}}
        dated = [{"epoch": utc(2006, 4, 10), "what": "burn", "source": "x", "change": change}]
        with pytest.raises(InputError, match=message):
            mission_of(events, mission_table(dated=dated))


def test_a_drift_that_cannot_be_names_the_file() -> None:
    """Its key stands behind the mission file, whether the name or the unit is wrong."""
    for name, message in (
        ("thrust_common_n", r"^mission\.toml: drift\.thrust_common_n: expected a parameter of"),
        ("cm_x_m", r"^mission\.toml: drift\.cm_x_m\.unit: expected 'm/kg'"),
    ):
        drift = {name: {**KNOWN_DRIFT, "unit": "m"}}
        with pytest.raises(InputError, match=message):
            mission_of(mixed_events()[:2], mission_table(drift=drift, propellant=USED))


def test_one_parameter_is_changed_once_at_a_moment() -> None:
    """Two facts of one epoch that change one parameter are refused (the later one would count
    twice); at two times of a day, or of two parameters, both are taken.
    """

    def facts(*changed: tuple[datetime | date, str, float]) -> list[dict[str, Any]]:
        return [
            {
                "epoch": epoch,
                "what": "burn",
                "source": "x",
                "change": {name: {"loc": loc, "scale": 0.0, "unit": "m", "source": "x"}},
            }
            for epoch, name, loc in changed
        ]

    day, noon = date(2005, 6, 1), datetime(2005, 6, 1, 12, tzinfo=UTC)
    for same in (day, utc(2005, 6, 1)):
        with pytest.raises(InputError, match=r"dated\[2\]\.change\.cm_y_m: expected one change"):
            mission_table(dated=facts((day, "cm_y_m", 0.005), (same, "cm_y_m", -0.003)))
    table = mission_table(
        dated=facts((day, "cm_y_m", 0.005), (day, "cm_x_m", 0.1), (noon, "cm_y_m", -0.003))
    )
    model = mission_of(mixed_events()[:2], table)
    parameters = model.space.to_parameters(np.zeros((1, model.space.dimension)))
    early, late = (
        float(np.squeeze(part.parameters_at(parameters, np.ones(1), 0.0)["cm_y_m"]))
        for part in model.parts
    )
    assert late - early == pytest.approx(0.002)


def test_changes_and_drift_move_parameters() -> None:
    """A change counts from its date on, a drift with the hydrazine used."""
    change = {"cm_z_m": {"loc": 0.02, "scale": 0.0, "unit": "m", "source": "x"}}
    table = mission_table(
        dated=[{"epoch": utc(2006, 4, 10), "what": "burn", "source": "x", "change": change}],
        drift={"cm_x_m": {"loc": 0.001, "scale": 0.0, "unit": "m/kg", "source": "x"}},
        propellant=USED,
    )
    model = mission_of(mixed_events()[:2], table)
    parameters = model.space.to_parameters(np.zeros((1, model.space.dimension)))
    used = model.circumstances.used_kg
    for part, z_shift, kg in zip(model.parts, (0.0, 0.02), used, strict=True):
        own = part.parameters_at(parameters, np.ones(1), 0.0)
        assert float(np.squeeze(own["cm_z_m"])) == pytest.approx(1.064 + z_shift)
        assert float(np.squeeze(own["cm_x_m"])) == pytest.approx(0.13 + 0.001 * kg)
    assert used[1] > used[0] > 0


@pytest.mark.parametrize("computed", [True, False])
def test_a_factor_on_computed_hydrazine_is_one_on_drifts(computed: bool) -> None:
    """Also where all pressures are read: 20 % more hydrazine is 20 % more drift. The factor is not
    there where the mass was measured.
    """
    table = mission_table(
        drift={"cm_x_m": KNOWN_DRIFT},
        propellant={**USED, "computed": computed},
    )
    model = mission_of(mixed_events()[:2], table)
    assert ("hydrazine_used_factor" in model.space.names) == computed
    parameters = dict(model.space.to_parameters(np.zeros((1, model.space.dimension))))
    if computed:
        parameters["hydrazine_used_factor"] = np.array([1.2])
    for part, kg in zip(model.parts, model.circumstances.used_kg, strict=True):
        own = part.parameters_at(parameters, np.ones(1), 0.0)
        drifted = 0.001 * (1.2 if computed else 1.0) * kg
        assert float(np.squeeze(own["cm_x_m"])) == pytest.approx(0.13 + drifted)


def test_two_branches_without_a_mission_are_refused() -> None:
    """A plain model of both branches names the branch that is too much, and the mission file."""
    from mission_cases import PRIORS

    from cassini_bayes.model import build_model
    from cassini_bayes.priors.reader import read_priors

    with pytest.raises(InputError, match=r"branch A.*trend MISSION.toml"):
        build_model(mixed_events(), read_priors(PRIORS))


def test_the_example_of_the_documentation_is_a_mission_file() -> None:
    """What docs/topics/mission.md shows is read, with every key that it names."""
    text = (ROOT / "docs" / "topics" / "mission.md").read_text("utf-8")
    example = text.split("```toml")[1].split("```")[0]
    table = check_mission(tomllib.loads(example), "docs/topics/mission.md")
    assert table.dated[0].change["cm_y_m"].scale == 0.005
    assert table.propellant is not None
    assert table.trend.forecast[0].branch == "B"


def test_the_swap_needs_no_change() -> None:
    """The made-up mission of the tests is one that can be."""
    table = mission_table()
    assert facts_of([replace(mixed_events()[0])])[0].branch == "A"
    assert check_mission(table.model_dump(), "again") == table
