"""Figures of a sweep: tornado and overlays per quantity, what knowledge and events are worth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from scipy.stats import gaussian_kde

from cassini_bayes.computing.arrays import Array
from cassini_bayes.report.plots.panels import PANELS_ACROSS, some_panels
from cassini_bayes.report.plots.quantities import Scale, display_scale, short_events, short_name
from cassini_bayes.report.plots.style import INK, legend_below, styled_figure, symbol
from cassini_bayes.sweep.weights import trusted_rows

KNOBS_SHOWN: Final = 16  # rows of a tornado on one page
_GRID: Final = 300  # points of a curve
_TALLEST: Final = 4.0  # peaks above this many times the baseline's are cut
_FARTHEST: Final = 1.5  # and tails this many of the baseline's ranges beyond it
_SIZES: Final = (3.5, 4.8, 6.2, 7.6)  # of markers, in points: wider priors are larger
_LINES: Final = ("#4477AA", "#66CCEE", "#CCBB44", "#EE6677", "#AA3377", "#228833", "#BBBBBB")
_FAMILY_MARKERS: Final = {"normal": "o", "student-t": "D", "uniform": "s"}
_KIND_COLOURS: Final = {"width": "#4477AA", "shift": "#CC6677", "family": "#228833"}
_UNTRUSTED: Final = ("x", "#888888")  # marker and colour of what the draws cannot say
_ENDS: Final = {"width": "width", "shift": "centre", "family": "family"}


def tornado_figure(table: pd.DataFrame, quantity: str) -> Figure:
    """Shift and width of one quantity under every changed prior, the strongest on top.

    ``table`` is the sweep's table (reported rows are shown). One row per knob: widths of a group,
    families of a group, the centre of one parameter. Filled symbols are weighted draws, open ones
    new fits; bars are one Monte Carlo standard error. Grey crosses are weights that cannot be
    trusted: they neither make a bar longer nor lift a row.
    """
    rows = table[(table["quantity"] == quantity) & table["reported"] & (table["kind"] != "without")]
    knobs = _knobs(rows)
    with styled_figure(9.6, 1.9 + 0.27 * len(knobs)) as figure:
        left, right = figure.subplots(1, 2, sharey=True, width_ratios=(1.35, 1.0))
        for axes, value, error, neutral in (
            (left, "shift_sd", "shift_error", 0.0),
            (right, "width_ratio", "width_error", 1.0),
        ):
            axes.axvline(neutral, color=INK, lw=0.8, zorder=1)
            axes.grid(axis="x")
            for place, (_, cells) in enumerate(knobs):
                _draw_knob(axes, len(knobs) - 1 - place, cells, value, error)
        left.set_yticks(range(len(knobs)), [label for label, _ in reversed(knobs)])
        left.set_ylim(-0.7, len(knobs) - 0.3)
        left.set_xlabel("shift of the mean [posterior standard deviations]")
        right.set_xlabel("ratio of standard deviations")
        figure.suptitle(quantity, fontweight="bold", x=0.01, ha="left")
        legend_below(figure, _tornado_legend(rows), ncols=5)
    return figure


def _knobs(rows: pd.DataFrame) -> list[tuple[str, pd.DataFrame]]:
    """Label and cells of every knob, the strongest first."""
    result = []
    for (group, kind, parameters), cells in rows.groupby(
        ["group", "kind", "parameters"], sort=False
    ):
        name = parameters if kind == "shift" else group
        either = np.maximum(
            np.abs(cells["shift_sd"]) - cells["shift_error"],
            np.abs(np.log(cells["width_ratio"])) - cells["width_error"],
        )
        said = either[trusted_rows(cells)]
        strength = float(np.fmax.reduce(said, initial=-np.inf))  # NaN: draws reach no cell
        result.append((strength, f"{name}: {_ENDS[str(kind)]}", cells))
    result.sort(key=lambda knob: -knob[0])
    return [(label, cells) for _, label, cells in result[:KNOBS_SHOWN]]


def _draw_knob(axes: Axes, y: float, cells: pd.DataFrame, value: str, error: str) -> None:
    trusted = trusted_rows(cells).to_numpy()
    values = cells[value].to_numpy(dtype=float)[trusted]
    kind = str(cells["kind"].iloc[0])
    colour = _KIND_COLOURS[kind]
    neutral = 0.0 if value == "shift_sd" else 1.0
    reach = np.append(values[np.isfinite(values)], neutral)
    axes.hlines(y, reach.min(), reach.max(), color=colour, lw=7, alpha=0.25, zorder=2)
    for i, (_, cell) in enumerate(cells.iterrows()):
        marker, size = _symbol(kind, str(cell["change"]), i)
        if not trusted[i]:
            axes.plot(cell[value], y, ls="", marker=_UNTRUSTED[0], ms=size, color=_UNTRUSTED[1])
            continue
        anew = str(cell["estimate"]) != "reweighted"
        axes.errorbar(
            cell[value], y, xerr=cell[error], color=colour, marker=marker, ms=size, lw=0.9,
            mfc="white" if anew else colour, mec=colour, zorder=4,
        )  # fmt: skip


def _symbol(kind: str, change: str, place: int) -> tuple[str, float]:
    if kind == "family":
        return _FAMILY_MARKERS.get(change, "o"), 5.0
    if kind == "shift":
        return (">" if "+" in change else "<"), 6.0
    return "o", _SIZES[min(place, len(_SIZES) - 1)]


def _tornado_legend(rows: pd.DataFrame) -> list[Line2D]:
    widths = list(dict.fromkeys(rows[rows["kind"] == "width"]["change"]))
    families = list(dict.fromkeys(rows[rows["kind"] == "family"]["change"]))

    known = [("width", label, label) for label in widths]
    if (rows["kind"] == "shift").any():
        known += [("shift", "-", "centre moved down"), ("shift", "+", "centre moved up")]
    known += [("family", label, label) for label in families]
    crosses = ~trusted_rows(rows) & rows["shift_sd"].notna()
    untrusted = [symbol(_UNTRUSTED[0], 5.0, _UNTRUSTED[1], "draws cannot say")]
    return [
        *(
            symbol(*_symbol(kind, change, i), _KIND_COLOURS[kind], label)
            for i, (kind, change, label) in enumerate(known)
        ),
        symbol("o", 5.0, INK, "weighted draws"),
        symbol("o", 5.0, INK, "fitted anew", hollow=True),
        *(untrusted if crosses.any() else []),
    ]


def overlay_figure(
    quantity: str,
    unit: str,
    base: Array,
    cells: Sequence[tuple[str, str, str, Array]],
) -> Figure:
    """Posteriors of one quantity under every change, one panel per group, over the baseline's.

    base (n,) draws; cells: (group, kind, label, quantiles (199,)) in order with one to show;
    single shifts are left out (the tornado has them), and cells that draws do not reach.
    """
    shown = [cell for cell in cells if _laid_over(cell)]
    groups = list(dict.fromkeys(cell[0] for cell in shown))
    scale = display_scale(unit, float(np.abs(base).max()))
    across = min(PANELS_ACROSS, len(groups))
    down = -(-len(groups) // across)
    grid = _overlay_grid(base, [cell[3] for cell in shown])
    with styled_figure(2.9 * across + 0.2, 2.45 * down + 0.5) as figure:
        panels = some_panels(figure, len(groups), across, sharex=True, sharey=True)
        for axes, group in zip(panels, groups, strict=True):
            cells_of_group = [cell for cell in shown if cell[0] == group]
            _overlay_panel(axes, group, base, cells_of_group, grid, scale)
        tallest = max(float(_density(cell[3], grid).max()) for cell in shown)
        own_peak = float(_density(base, grid).max())
        panels[0].set_ylim(0.0, 1.05 * min(max(tallest, 1.8 * own_peak), _TALLEST * own_peak))
        for i, axes in enumerate(panels):
            if i + across >= len(groups):
                axes.tick_params(axis="x", labelbottom=True)
                axes.set_xlabel(f"[{scale.unit}]")
        figure.suptitle(
            f"{short_name(quantity, unit)}: posterior density, baseline (grey) and changed priors",
            fontweight="bold", x=0.01, ha="left",
        )  # fmt: skip
    return figure


def _laid_over(cell: tuple[str, str, str, Array]) -> bool:
    return cell[1] != "shift" and bool(np.isfinite(cell[3]).all())


def _overlay_grid(base: Array, quantiles: Sequence[Array]) -> Array:
    """Abscissae that hold the baseline and the changed posteriors, as far as these stay near it.

    Quantiles (199,) are at (i + 1)/200; the axis ends where one of them moves out of sight.
    """
    low, high = np.quantile(base, [0.0005, 0.9995])
    reach = high - low
    low = max(min(low, *(line[0] for line in quantiles)), low - _FARTHEST * reach)
    high = min(max(high, *(line[-1] for line in quantiles)), high + _FARTHEST * reach)
    margin = 0.05 * (high - low)
    start = low - margin if low < 0.0 else max(low - margin, 0.0)
    return np.linspace(start, high + margin, _GRID)


def _density(values: Array, grid: Array) -> Array:
    """Kernel estimate on the grid; what it smears beyond zero from positive values is folded back.

    A positive parameter has no density below zero.
    """
    estimate = gaussian_kde(values)
    folded = estimate(-grid) if values.min() >= 0.0 else 0.0
    return np.where((values.min() < 0.0) | (grid >= 0.0), estimate(grid) + folded, 0.0)


def _overlay_panel(
    axes: Axes,
    group: str,
    base: Array,
    cells: Sequence[tuple[str, str, str, Array]],
    grid: Array,
    scale: Scale,
) -> None:
    x = grid * scale.factor
    axes.fill_between(x, _density(base, grid), color="#cfcfcf", lw=0, zorder=1)
    names = short_events([label.removeprefix("without ") for _, _, label, _ in cells])
    for i, (_, kind, label, quantiles) in enumerate(cells):
        axes.plot(
            x, _density(quantiles, grid), color=_LINES[i % len(_LINES)], lw=1.2,
            ls="--" if kind == "family" or i >= len(_LINES) else "-",
            label=f"− {names[i]}" if kind == "without" else label,
        )  # fmt: skip
    axes.set_title(group, loc="left", fontweight="bold")
    axes.set_yticks([])
    axes.spines["left"].set_visible(False)
    axes.legend(fontsize=6.0, loc="upper right", handlelength=1.2, borderaxespad=0.0)


def worth_figure(knowledge: pd.DataFrame, worth: pd.DataFrame) -> Figure | None:
    """How much standard deviations shrink with perfect knowledge, and grow without an event, in %.

    Of events whose weights cannot be trusted nothing is shown.
    """
    blocks = knowledge[knowledge["level"] == "block"]
    quantities = list(dict.fromkeys(blocks["quantity"]))
    if not quantities:
        return None
    left_table = -100.0 * (1.0 - _grid(blocks, "known", quantities))
    parts: list[tuple[str, pd.DataFrame]] = [("known perfectly", left_table)]
    if not worth.empty:
        said = worth.assign(width_ratio=worth["width_ratio"].where(trusted_rows(worth)))
        parts.append(("left out", 100.0 * (_grid(said, "event", quantities) - 1.0)))
    rows = sum(len(part) for _, part in parts)
    with styled_figure(max(7.0, 2.6 + 0.62 * len(quantities)), 1.9 + 0.27 * rows) as figure:
        panels = figure.subplots(
            len(parts), 1, squeeze=False, sharex=True, height_ratios=[len(p) for _, p in parts]
        ).ravel()
        for axes, (title, part) in zip(panels, parts, strict=True):
            _heat(axes, title, part)
        labels = [quantity.replace("_n[", " [") for quantity in quantities]
        panels[-1].set_xticks(range(len(labels)), labels, rotation=60, ha="right")
    return figure


def _grid(table: pd.DataFrame, index: str, quantities: Sequence[str]) -> pd.DataFrame:
    order = list(dict.fromkeys(table[index]))
    wide = table.pivot(index=index, columns="quantity", values="width_ratio")
    return wide.reindex(index=order, columns=list(quantities))


def _heat(axes: Axes, title: str, part: pd.DataFrame) -> None:
    values = part.to_numpy(dtype=float)
    reach = float(np.fmax.reduce(np.abs(values), axis=None, initial=10.0))
    axes.imshow(values, cmap="PuOr", vmin=-reach, vmax=reach, aspect="auto")
    for (i, j), value in np.ndenumerate(values):
        if np.isfinite(value):
            dark = abs(value) > 0.5 * reach
            text = f"{value:+.0f}".replace("-", "−") if abs(value) >= 0.5 else "0"
            axes.text(
                j, i, text, ha="center", va="center", fontsize=7.5,
                color="white" if dark else INK,
            )  # fmt: skip
    names = short_events([str(name) for name in part.index], longest=24)
    axes.set_yticks(range(len(names)), names)
    axes.tick_params(length=0)
    axes.set_title(f"change of the standard deviation [%], {title}", loc="left")
    for spine in axes.spines.values():
        spine.set_visible(False)


def sweep_figures(
    table: pd.DataFrame,
    base: Mapping[str, tuple[str, Array]],
    quantiles: Sequence[tuple[str, str, str, Mapping[str, Array]]],
    knowledge: pd.DataFrame,
    worth: pd.DataFrame,
) -> dict[str, Figure]:
    """Every figure of a sweep by name: ``worth``, then ``tornado_1``, ``overlay_1`` … in order.

    A figure that would be empty is left out, and so are changes that the draws cannot say from
    the overlays.

    base: quantity → (unit, draws (n,)); quantiles: (group, kind, label, quantity → (199,)).
    """
    result: dict[str, Figure] = {}
    together = worth_figure(knowledge, worth)
    if together is not None:
        result["worth"] = together
    reported = table[table["reported"]]
    trusted = reported[trusted_rows(reported)]
    said = set(zip(trusted["group"], trusted["change"], strict=True))
    for i, (quantity, (unit, draws)) in enumerate(base.items(), start=1):
        if ((table["kind"] != "without") & table["reported"] & table["shift_sd"].notna()).any():
            result[f"tornado_{i}"] = tornado_figure(table, quantity)
        cells = [
            (group, kind, label, line[quantity])
            for group, kind, label, line in quantiles
            if (group, label) in said
        ]
        if any(_laid_over(cell) for cell in cells):
            result[f"overlay_{i}"] = overlay_figure(quantity, unit, draws, cells)
    return result
