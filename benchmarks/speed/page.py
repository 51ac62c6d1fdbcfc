"""The page of the speed benchmark: tables, figure, and the same numbers as CSV."""

from __future__ import annotations

import csv
import io
from pathlib import Path
from typing import Any

from matplotlib import rc_context
from matplotlib.figure import Figure

from cassini_bayes.files.storage import write_bytes, write_text
from cassini_bayes.report.plots.style import STYLE
from speed.goals import goals
from speed.tables import Found, Row, rows_of, table

CORE = 1e6


def write(path: Path, found: Found, quick: bool, note: str = "") -> None:
    """Write the page, its figure and its CSV."""
    if not found:
        raise SystemExit("no part is finished")
    title = "# Speed of fitting telemetry" + (" (quick run)" if quick else "")
    sections = [
        title,
        _head(found, path),
        note,
        goals(found),
        _fits(found),
        _samplers(found),
        _calls(found),
        _reduction(found),
    ]
    write_text(path, "\n\n".join(section for section in sections if section) + "\n")
    write_bytes(path.with_suffix(".png"), _figure(found))
    write_text(path.with_suffix(".csv"), _csv(found))


def _head(found: Found, path: Path) -> str:
    one = next(iter(found.values()))["circumstances"]
    loads = [part["circumstances"]["load"] for part in found.values()]
    packages = ", ".join(f"{name} {number}" for name, number in sorted(_packages(found).items()))
    return (
        f"Made by `python benchmarks/telemetry_speed.py --page {path.as_posix()}` with version "
        f"{one['version']} on {one['date']}; seed 20101. {one['processor']}, Python "
        f"{one['python']}; {packages}. Fits use all {one['cores']} cores, all else one thread. The "
        f"machine was shared, its load {min(loads):.1f} to {max(loads):.1f}, so times are "
        "**processor seconds** unless they say wall; with one thread on an idle machine the two "
        f"agree.\n\n![Effective draws per second of every sampler, and the cost of a likelihood "
        f"call against samples and events]({path.with_suffix('.png').name})\n\nAll numbers: "
        f"[{path.with_suffix('.csv').name}]({path.with_suffix('.csv').name})."
    )


def _packages(found: Found) -> dict[str, str]:
    return {
        name: number
        for part in found.values()
        for name, number in part["circumstances"]["packages"].items()
        if number != "not installed"
    }


def _fits(found: Found) -> str:
    rows = rows_of(found, "fit-")
    if not rows:
        return ""
    header = (
        "events", "rows", "walked", "collapsed", "bulk and tail ESS ≥ 2,000 of all walked (s)",
        "the same, wall (s)", "whole stop rule and fit (s)", "the same, wall (s)",
        "least ESS at the end, walked and collapsed", "importance draws alone: wall (s), ESS",
    )  # fmt: skip
    lines = [
        (
            row["case"], f"{row['rows']:,}", str(row["walked"]), str(row["collapsed"]),
            f"{row['enough_processor_s']:.1f}", f"{row['enough_wall_s']:.1f}",
            f"{row['processor_s']:.1f}{_cut_off(row)}", f"{row['wall_s']:.1f}",
            f"{row['least_ess']:,.0f} ({row['least_ess_of']})",
            f"{row['importance_wall_s']:.1f}, {row['importance_ess']:,.0f}",
        )
        for row in rows
    ]  # fmt: skip
    return (
        "## From event folders to effective draws\n\n"
        + table(header, lines)
        + "\n\n`fit` with its default settings (four ensembles), from CSV files to the assembled "
        "fit. The first time is when the criterion on effective sizes held first, at one of the "
        "sampler's checks; the second includes the rest of the stop rule (length of 50 "
        "autocorrelation times, these settled to 5 %, R-hat), the draws of everything collapsed, "
        "their own sizes, and the fit's tables. Goals: 10 s and 60 s of wall time to ESS 2,000 on "
        "two cores."
    )


def _cut_off(row: Row) -> str:
    return "" if row["converged"] else f" (stopped at {row['steps']:,} steps)"


def _samplers(found: Found) -> str:
    text = []
    for noise in (True, False):
        own = [row for row in rows_of(found, "own-") if row["torque_noise"] is noise]
        peers = [row for row in rows_of(found, "peer-") if row["torque_noise"] is noise]
        if not own:
            continue
        ours = own[0]
        rate = ours["ess_per_s"]
        header = (
            "sampler", "dimensions", "processor time (s)", "ESS reached",
            "effective draws per second", "ours, faster by", "shift of means (sd)",
            "change of sd", "remark",
        )  # fmt: skip
        lines = [
            (
                "**cassini_bayes (emcee)**", str(ours["dimensions"]),
                f"{ours['warm_start_s'] + ours['sampling_s']:.1f}", f"{ours['ess']:,.0f}",
                f"**{rate:,.0f}**", "1", "reference", "reference",
                f"reading, reduction and warm start {ours['warm_start_s']:.1f} s of it; without "
                f"them {ours['sampling_ess_per_s']:,.0f}/s; ESS 2,000 at {ours['enough_s']:.1f} s",
            )
        ]  # fmt: skip
        lines += [_peer_line(row, rate) for row in peers]
        word = "with" if noise else "without"
        text.append(f"### {word.capitalize()} torque noise\n\n" + table(header, lines))
        if peers:
            text.append(_verdict(peers, ours))
    if not text:
        return ""
    return "## The same posterior by other samplers\n\n" + "\n\n".join(
        [
            "One bias of about 1,200 rows. Every sampler is handed our own likelihood in standard "
            "coordinates; emcee runs with its default stretch move, ours with other moves. "
            "Samplers that need gradients are left out: the likelihood gives none. ESS is the "
            "smallest bulk or tail size over all walked parameters, that of nested samplers is of "
            "their weights. "
            "Our time starts with the data and includes reading, reduction and warm start, that of "
            "the others starts with the sampler, imports and compilation apart. To be on the safe "
            "side emcee and zeus begin at draws of the posterior, so they pay for no search. "
            "`<` marks upper bounds: a nested sampler not done within its time (2,000 over that "
            "time), and an ensemble whose ESS is below 100 or not yet twice the number of draws "
            "that it was given to start from.",
            *text,
        ]
    )


def _peer_line(row: Row, rate: float) -> tuple[str, ...]:
    below = "< " if row["bound"] else ""
    above = "> " if row["bound"] else ""
    shift, change = (
        (f"{row['largest_shift_sd']:.2f}", f"{row['largest_sd_ratio_change']:.0%}")
        if "largest_shift_sd" in row
        else ("–", "–")
    )
    return (
        row["sampler"], str(row["dimensions"]), f"{row['processor_s']:.0f}",
        f"{row['ess']:,.0f}", f"{below}{row['ess_per_s']:.3g}",
        f"{above}{rate / row['ess_per_s']:,.3g} ×", shift, change, row["note"],
    )  # fmt: skip


def _verdict(peers: list[Row], ours: Row) -> str:
    measured = [row for row in peers if not row["bound"]]
    if measured:
        best = max(measured, key=lambda row: row["ess_per_s"])
        ratio = ours["ess_per_s"] / best["ess_per_s"]
        steady = ours["sampling_ess_per_s"] / best["ess_per_s"]
        return (
            f"Against the best that was measured ({best['sampler']}): {ratio:,.0f} × (goal 10 ×), "
            f"or {steady:,.0f} × without our reading and warm start."
        )
    best = max(peers, key=lambda row: row["ess_per_s"])
    ratio = ours["ess_per_s"] / best["ess_per_s"]
    return (
        f"No other sampler had a figure within its time: by the loosest bound ({best['sampler']}) "
        f"ours is faster by at least {ratio:,.1f} × (goal 10 ×)."
    )


def _calls(found: Found) -> str:
    text = []
    samples, events = rows_of(found, "calls-samples"), rows_of(found, "calls-events")
    if samples:
        first = samples[0]["call_s"]
        lines = [
            (f"{r['rows']:,}", f"{r['call_s'] * CORE:.1f}", f"{r['call_s'] / first:.2f}")
            for r in samples
        ]
        whole = table(("rows of telemetry", "µs per point", "against the first"), lines)
        text.append("## Cost of a likelihood call\n\nOne bias; goal 1.1 at 10⁶ rows.\n\n" + whole)
    if events:
        lines = [
            (
                str(r["events"]), str(r["walked"]), f"{r['call_s'] * CORE:.0f}",
                f"{r['call_s'] * CORE / r['events']:.1f}",
            )
            for r in events
        ]  # fmt: skip
        each = [r["call_s"] / r["events"] for r in events]
        whole = table(("joint events", "walked", "µs per point", "µs per point and event"), lines)
        text.append(
            whole + f"\n\nCost per event from {min(each) * CORE:.1f} to {max(each) * CORE:.1f} µs; "
            f"from two events on it varies by {max(each[1:]) / min(each[1:]) - 1:.0%}, with the "
            f"first {max(each) / min(each) - 1:.0%} (goal 20 %). The events are one bias, "
            "repeated under other names: different biases differ in cost by up to 40 %."
        )
    return "\n\n".join(text)


def _reduction(found: Found) -> str:
    rows = rows_of(found, "reduction")
    if not rows:
        return ""
    lines = [
        (
            r["step"], f"{r['rows']:,}", f"{r['processor_s']:.1f}", f"{r['rows_per_s']:,.0f}",
            f"{r['peak_mib']:.0f}" if "peak_mib" in r else "–",
        )
        for r in rows
    ]  # fmt: skip
    header = ("step", "rows", "processor time (s)", "rows per second and core", "peak memory (MiB)")
    return (
        "## Reduction\n\n" + table(header, lines) + "\n\nPeak memory is that of the whole process, "
        "interpreter and libraries included. Rows of the reduction are made up on the fly, "
        "chunks of 100,000 at a time. Goal: 200,000 rows per second and core." + _long(found)
    )


def _long(found: Found) -> str:
    """What the long parts are, which a run of the benchmark takes over from an earlier one."""
    text = ""
    if "reduction-long" in found:
        part = found["reduction-long"]
        text += (
            f"\n\n10⁸ rows, three years at 1 Hz, were streamed once (`--long`, "
            f"{part['circumstances']['date']}, load {part['circumstances']['load']:.1f}), in "
            f"{part['rows'][0]['peak_mib']:.0f} MiB."
        )
    if "reduction-file" in found:
        row = found["reduction-file"]["rows"][0]
        text += (
            f"\n\nThe large file is a slew set written {row['rows'] // 3_601:,} times over, read "
            "once for its hash and once, row by row and checked, into Gram matrices, as `fit` "
            "does."
        )
    return text


def _csv(found: Found) -> str:
    rows = [{"part": name, **row} for name, part in found.items() for row in part["rows"]]
    fields = list(dict.fromkeys(key for row in rows for key in row))
    stream = io.StringIO()
    writer = csv.DictWriter(stream, fields, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return stream.getvalue()


def _figure(found: Found) -> bytes:
    stream = io.BytesIO()
    with rc_context(dict(STYLE)):
        figure = Figure(figsize=(10.0, 6.6), layout="constrained")
        grid = figure.add_gridspec(2, 2)
        for column, noise in enumerate((True, False)):
            _bars(figure.add_subplot(grid[0, column]), found, noise)
        _line(figure.add_subplot(grid[1, 0]), rows_of(found, "calls-samples"), "rows", 1.1)
        _line(figure.add_subplot(grid[1, 1]), rows_of(found, "calls-events"), "events", 1.2)
        figure.savefig(stream, format="png", dpi=130, metadata={"Software": None})
    return stream.getvalue()


def _bars(axes: Any, found: Found, noise: bool) -> None:
    own = [row for row in rows_of(found, "own-") if row["torque_noise"] is noise]
    peers = [row for row in rows_of(found, "peer-") if row["torque_noise"] is noise]
    labels = ["cassini_bayes", *(row["sampler"] for row in peers)]
    if not peers:
        axes.set_ylim(-0.5, 4.5)
    if own:
        axes.barh(0, own[0]["ess_per_s"], 0.7, color="#22558c")
        axes.text(own[0]["ess_per_s"] * 1.15, 0, f"{own[0]['ess_per_s']:,.0f}", va="center")
    open_bar = {"facecolor": "none", "edgecolor": "#88aacc", "hatch": "///"}
    for place, row in enumerate(peers, 1):
        axes.barh(
            place, row["ess_per_s"], 0.7, **(open_bar if row["bound"] else {"color": "#88aacc"})
        )
        text = f"{'< ' if row['bound'] else ''}{_short(row['ess_per_s'])}"
        axes.text(row["ess_per_s"] * 1.15, place, text, va="center", fontsize=8)
    axes.set_xscale("log")
    axes.set_xlim(1e-2, 1e5)
    axes.set_yticks(range(len(labels)), labels)
    axes.invert_yaxis()
    axes.set_xlabel("effective draws per second")
    axes.set_title(f"One bias {'with' if noise else 'without'} torque noise; hatched: upper bound")


def _short(value: float) -> str:
    return f"{value:,.0f}" if value >= 10.0 else f"{value:.2g}"


def _line(axes: Any, rows: list[Row], against: str, band: float) -> None:
    if not rows:
        axes.set_axis_off()
        return
    x = [row[against] for row in rows]
    each = [row["call_s"] * CORE / (row["events"] if against == "events" else 1) for row in rows]
    start = each[0] if against == "rows" else min(each)
    axes.axhspan(0, band * start, color="#eeeeee", lw=0)
    axes.plot(x, each, "o-", color="#22558c")
    axes.set_xscale("log")
    axes.set_ylim(0, 1.5 * max(each))
    if against == "rows":
        axes.set_xlabel("rows of telemetry")
        axes.set_ylabel("likelihood call (µs per point)")
        axes.set_title("Cost against rows; grey: within 10 % of the first")
    else:
        axes.set_xticks(x, [str(value) for value in x])
        axes.minorticks_off()
        axes.set_xlabel(f"joint events (walked parameters: {rows[0]['walked']} for all)")
        axes.set_ylabel("likelihood call (µs per point and event)")
        axes.set_title("Cost per event; grey: within 20 % of the least")
