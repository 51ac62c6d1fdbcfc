"""The goals of speed, what was measured, and whether the figure reaches them."""

from __future__ import annotations

from speed.tables import Found, Row, rows_of, table


def goals(found: Found) -> str:
    """Every goal of speed, what was measured, and whether the figure reaches it."""
    lines = [_fit_goal(row, 10.0) for row in rows_of(found, "fit-one")]
    lines += [_fit_goal(row, 60.0) for row in rows_of(found, "fit-seven")]
    calls = rows_of(found, "calls-samples")
    if len(calls) > 1:
        ratio = calls[-1]["call_s"] / calls[0]["call_s"]
        what = f"call at {calls[-1]['rows']:,} rows against {calls[0]['rows']:,}"
        lines.append((what, "≤ 1.1", f"{ratio:.2f}", _met(ratio <= 1.1)))
    events = rows_of(found, "calls-events")
    if len(events) > 1:
        each = [row["call_s"] / row["events"] for row in events]
        spread = max(each) / min(each) - 1.0
        later = max(each[1:]) / min(each[1:]) - 1.0
        what = f"cost per event, {events[0]['events']} to {events[-1]['events']} events"
        measured = f"{spread:.0%}; from two events on {later:.0%}"
        lines.append((what, "flat within 20 %", measured, _met(spread <= 0.2)))
    speeds = [r["rows_per_s"] for r in rows_of(found, "reduction") if "used_rows" in r]
    if speeds:
        what = "reduction, rows per second and core"
        lines.append((what, "≥ 200,000", f"{max(speeds):,.0f}", _met(max(speeds) >= 2e5)))
    for noise in (True, False):
        lines += _ratio_goal(found, noise)
    header = ("goal", "wanted", "measured", "reached")
    return (
        "## Goals\n\n" + table(header, lines) + "\n\nWall times are those of the machine as it "
        "was, busy or not. A sampler without a figure within its time gives a bound only: where "
        "bounds leave it open, a goal is not shown to be reached."
    )


def _met(reached: bool) -> str:
    return "yes" if reached else "**no**"


def _fit_goal(row: Row, most_s: float) -> tuple[str, ...]:
    wall, processor = row["enough_wall_s"], row["enough_processor_s"]
    return (
        f"{row['case']}: bulk and tail ESS ≥ 2,000",
        f"≤ {most_s:.0f} s of wall time on two cores",
        f"{wall:.0f} s wall, {processor:.1f} s of one core",
        _met(wall <= most_s),
    )


def _ratio_goal(found: Found, noise: bool) -> list[tuple[str, ...]]:
    own = [row for row in rows_of(found, "own-") if row["torque_noise"] is noise]
    peers = [row for row in rows_of(found, "peer-") if row["torque_noise"] is noise]
    if not own or not peers:
        return []
    rate = own[0]["ess_per_s"]
    sure = rate / max(row["ess_per_s"] for row in peers)
    measured = [rate / row["ess_per_s"] for row in peers if not row["bound"]]
    text = f"{min(measured):,.0f} × the best measured; " if measured else ""
    missed = bool(measured) and min(measured) < 10.0
    names = ", ".join(row["sampler"] for row in peers)
    word = "with" if noise else "without"
    return [
        (
            f"draws per second against the best of {names}, {word} torque noise",
            "≥ 10 ×",
            text + f"at least {sure:,.1f} × by all bounds",
            "yes" if sure >= 10.0 else "**no**" if missed else "not shown",
        )
    ]
