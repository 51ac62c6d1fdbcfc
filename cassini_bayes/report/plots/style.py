"""One look for every figure: colours that survive colour blindness and grey print.

matplotlib is imported when a figure is made, not before.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    Handle = Line2D | Patch

STYLE: Final[Mapping[Any, object]] = MappingProxyType(
    {
        "font.family": "DejaVu Sans",
        "font.size": 9.0,
        "text.parse_math": False,  # a dollar in a name is a dollar
        "axes.titlesize": 9.5,
        "axes.labelsize": 9.0,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.edgecolor": "#555555",
        "axes.linewidth": 0.8,
        "axes.axisbelow": True,
        "axes.grid": False,
        "grid.color": "#dddddd",
        "grid.linewidth": 0.6,
        "xtick.color": "#333333",
        "ytick.color": "#333333",
        "xtick.labelsize": 8.0,
        "ytick.labelsize": 8.0,
        "legend.frameon": False,
        "legend.fontsize": 8.5,
        "figure.facecolor": "white",
        "savefig.facecolor": "white",
        "hatch.linewidth": 0.6,
        "svg.fonttype": "path",  # the same picture on a machine without this font
        "svg.hashsalt": "cassini_bayes",  # the same bytes from the same draws
    }
)

# Twelve colours told apart with the common kinds of colour blindness, dark ones first; markers
# differ as well, so that grey print keeps thrusters apart.
_COLOURS: Final = (
    "#332288", "#117733", "#CC6677", "#882255", "#44AA99", "#999933",
    "#AA4499", "#4477AA", "#661100", "#6699CC", "#BB8800", "#777777",
)  # fmt: skip
_MARKERS: Final = ("o", "s", "^", "D", "v", "P", "X", "h", "<", ">", "p", "d")

# Fills of the error budget: light enough for a hatch to show.
BLOCK_FILLS: Final = (
    ("#4477AA", ""), ("#EECC66", "//"), ("#994455", ""), ("#88CCEE", ".."), ("#117733", ""),
    ("#EE99AA", "\\\\"), ("#332288", ""), ("#DDDDAA", "xx"), ("#AA4499", ""), ("#99DDCC", "++"),
)  # fmt: skip

LEGEND_COLUMN_IN: Final = 3.0  # inches for one entry
INK: Final = "#222222"
PRIOR: Final = "#b9b9b9"
PRIOR_LINE: Final = "#8a4b08"
BASELINE: Final = "#444444"
POSTERIOR: Final = "#22558c"
VERDICT_COLOURS: Final[Mapping[str, str]] = MappingProxyType(
    {"conflict": "#b2182b", "informed": POSTERIOR, "prior returned": "#777777"}
)


@dataclass(frozen=True)
class ThrusterStyle:
    """Colour and marker of a thruster, the same in every figure."""

    colour: str
    marker: str


def thruster_styles(thrusters: Sequence[str]) -> dict[str, ThrusterStyle]:
    """A style per thruster, in the spacecraft's order; beyond twelve, colours come round again."""
    return {
        name: ThrusterStyle(
            _COLOURS[i % len(_COLOURS)],
            _MARKERS[(i + i // len(_COLOURS)) % len(_MARKERS)],
        )
        for i, name in enumerate(thrusters)
    }


def new_figure(width_in: float, height_in: float, *, by_hand: bool = False) -> Figure:
    """An empty figure outside any plotting session, laid out so that labels never overlap.

    ``by_hand``: the caller lays it out.
    """
    from matplotlib.figure import Figure

    return Figure(figsize=(width_in, height_in), layout=None if by_hand else "constrained")


@contextmanager
def styled_figure(width_in: float, height_in: float) -> Iterator[Figure]:
    """An empty figure to be drawn on in the house style."""
    import matplotlib

    with matplotlib.rc_context(dict(STYLE)):
        yield new_figure(width_in, height_in)


def headline(figure: Figure, text: str, **place: Any) -> None:
    """The title of a whole figure."""
    figure.suptitle(text, fontsize=11.5, fontweight="bold", color=INK, **place)


def label_axes(axes: Axes, across: str, up: str, title: str = "") -> None:
    """What stands along both axes, and a title at the left."""
    axes.set_xlabel(across)
    axes.set_ylabel(up)
    axes.set_title(title, loc="left")


def legend_below(
    figure: Figure, entries: Sequence[Artist] | Axes, ncols: int | None = None, **look: Any
) -> None:
    """A legend under the panels, of entries or of what an axes shows; as many columns as fit."""
    handles, labels = (
        (entries, [str(entry.get_label()) for entry in entries])
        if isinstance(entries, Sequence)
        else entries.get_legend_handles_labels()
    )
    columns = ncols or min(int(figure.get_figwidth() / LEGEND_COLUMN_IN), len(handles))
    figure.legend(handles, labels, loc="outside lower center", ncols=columns, **look)


def symbols(
    axes: Axes, x: Any, y: Any, marker: str, size: float, colour: str, *, hollow: bool = False,
    **look: Any,
) -> None:  # fmt: skip
    """Symbols without a line, filled or white inside."""
    axes.plot(x, y, **_symbol(marker, size, colour, hollow), **look)


def symbol(marker: str, size: float, colour: str, label: str, *, hollow: bool = False) -> Line2D:
    """A symbol for a legend."""
    return line(**_symbol(marker, size, colour, hollow), label=label)


def _symbol(marker: str, size: float, colour: str, hollow: bool) -> dict[str, Any]:
    inside = {"mfc": "white"} if hollow else {}
    return {"ls": "", "marker": marker, "ms": size, "color": colour, **inside}


def line(**look: Any) -> Line2D:
    """A line or symbol for a legend."""
    from matplotlib.lines import Line2D

    return Line2D([], [], **look)


def patch(**look: Any) -> Patch:
    """A filled area for a legend."""
    from matplotlib.patches import Patch

    return Patch(**look)


def event_axis(axes: Axes, labels: Sequence[str], axis_label: str = "event") -> None:
    """Events along x, one slot each, separated by hair lines."""
    axes.set_xlim(-0.5, len(labels) - 0.5)
    axes.set_xticks(range(len(labels)), labels, rotation=90 if len(labels) > 3 else 0)
    axes.tick_params(axis="x", length=0)
    axes.set_xlabel(axis_label)
    for i in range(1, len(labels)):
        axes.axvline(i - 0.5, color="#e4e4e4", lw=0.6, zorder=0)
