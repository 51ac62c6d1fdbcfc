"""Hidden and found sizes of two-wheel events: a platform's angle, a leak."""

from __future__ import annotations

from typing import Final

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from cassini_bayes.report.plots.style import INK, POSTERIOR, label_axes, styled_figure

PANELS: Final = (("articulation", 1e3, "platform off by", "mrad"), ("leak", 1e6, "leak", "µN"))
_WRONG: Final = "#CC6677"


def two_wheel_figure(table: pd.DataFrame) -> Figure:
    """Found against hidden sizes with a standard deviation, per stratum.

    ``table`` has the columns event, stratum, named, size, found and found_sd (rad, N); an open
    marker is a trial in which another cause was first.
    """
    events = list(dict.fromkeys(table["event"]))
    with styled_figure(8.0, 4.0 * len(events)) as figure:
        grid = figure.subplots(len(events), len(PANELS), squeeze=False)
        for line, event in zip(grid, events, strict=True):
            for axes, (stratum, factor, label, unit) in zip(line, PANELS, strict=True):
                rows = table[(table["event"] == event) & (table["stratum"] == stratum)]
                rows = rows[np.isfinite(rows["size"].astype(float))]
                for hit, colour, marker in ((True, POSTERIOR, "o"), (False, _WRONG, "D")):
                    part = rows[rows["named"] == hit]
                    look = {"ms": 4, "mfc": colour if hit else "white", "color": colour}
                    x, y, bar = (factor * part[name] for name in ("size", "found", "found_sd"))
                    name = "named" if hit else "another cause first"
                    axes.errorbar(x, y, yerr=bar, fmt=marker, label=name, **look)
                axes.axline((0.0, 0.0), slope=1.0, lw=0.8, color=INK, zorder=0)
                title = f"{event}, {len(rows)} trials"
                found = f"found, given the cause ({unit})"
                label_axes(axes, f"hidden: {label} ({unit})", found, title)
        grid[0, 0].legend()
    return figure
