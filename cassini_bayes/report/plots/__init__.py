"""Figures as matplotlib objects outside any plotting session, and their files.

Importing this loads no matplotlib: it is loaded when a figure is drawn.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final, Literal

from cassini_bayes.computing.processes import in_processes
from cassini_bayes.files.storage import write_bytes

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = [
    "Figure",
    "Picture",
    "draw",
    "draw_encoded",
    "encode",
    "encoded",
    "is_corner",
    "save_figures",
    "save_pictures",
    "settle",
]

DOTS_PER_INCH: Final = 150  # of PNG: fine lines stay apart on a screen of twice the resolution
CORNER: Final = "corner"
Kind = Literal["png", "svg"]
_KINDS: Final[tuple[Kind, ...]] = ("png", "svg")
_METADATA: Final[Mapping[str, Mapping[str, None]]] = MappingProxyType(
    {"svg": {"Date": None}, "png": {}}  # the same bytes from the same draws
)
_NO_LAYOUT: Final[Mapping[Any, object]] = {
    "figure.autolayout": False,
    "figure.constrained_layout.use": False,
}


@dataclass(frozen=True)
class Picture:
    """A figure as it is written: its files by kind, of which a page shows the last."""

    files: Mapping[Kind, bytes]

    @property
    def shown(self) -> tuple[Kind, bytes]:
        """What a page shows: SVG where there is one."""
        kind: Kind = "svg" if "svg" in self.files else "png"
        return kind, self.files[kind]


def draw(drawings: Mapping[str, Callable[[], Figure | None]]) -> dict[str, Figure]:
    """Figures by name, in order, in the house style; one that has nothing to show is absent."""
    import matplotlib

    from cassini_bayes.report.plots.style import STYLE

    with matplotlib.rc_context(dict(STYLE)):
        result = {name: make() for name, make in drawings.items()}
        figures = {name: figure for name, figure in result.items() if figure is not None}
        for figure in figures.values():
            settle(figure)
            # a notebook shows it, whether or not a plotting session has been started there
            vars(figure)["_repr_png_"] = partial(encode, figure, "png")
    return figures


def draw_encoded(
    drawings: Mapping[str, Callable[[], Figure | None]], processes: int = 1
) -> dict[str, Picture]:
    """Figures by name, in order, drawn and encoded in several processes; see :func:`draw`.

    A figure takes up to some seconds, and no two share anything. Corner plots, the longest, begin.
    """
    import matplotlib.figure  # noqa: F401  before the processes part, which then need not

    def made(name: str) -> Picture | None:
        figures = draw({name: drawings[name]})
        return encoded(name, figures[name]) if figures else None

    order = sorted(drawings, key=is_corner, reverse=True)
    result = dict(zip(order, in_processes(made, order, processes), strict=True))
    return {name: own for name in drawings if (own := result[name]) is not None}


def encoded(name: str, figure: Figure) -> Picture:
    """The figure as PNG and, corner plots excepted, as SVG."""
    kinds = _KINDS[:1] if is_corner(name) else _KINDS
    return Picture({kind: encode(figure, kind) for kind in kinds})


def settle(figure: Figure, solutions: int = 2) -> None:
    """Lay the figure out once and for all: faster to write, and the same in every format.

    The layout is solved ``solutions`` times, because labels may change with the size of their axes;
    ticks get their size for good, because those made later would take it from the session's
    settings. A figure that keeps an engine, even one that does nothing, is drawn twice for every
    file.
    """
    import matplotlib

    from cassini_bayes.report.plots.style import STYLE

    engine = figure.get_layout_engine()
    if engine is not None:
        with matplotlib.rc_context(dict(STYLE) | dict(_NO_LAYOUT)):
            for axis in (axis for axes in figure.axes for axis in (axes.xaxis, axes.yaxis)):
                axis.set_tick_params(labelsize=axis.get_major_ticks(1)[0].label1.get_fontsize())
                if not axis.get_label_text():
                    axis.set_label_coords(0.0, 0.0)  # else it is placed anew beside the ticks
            for _ in range(solutions):
                engine.execute(figure)
            figure.set_layout_engine(None)


def is_corner(name: str) -> bool:
    """Whether a figure is a corner plot: many megabytes as SVG, so PNG only."""
    return name.startswith(CORNER)


def encode(figure: Figure, kind: Kind) -> bytes:
    """The figure as PNG (150 dpi) or SVG (text as outlines, no fonts needed), reproducibly."""
    import matplotlib

    from cassini_bayes.report.plots.style import STYLE

    stream = io.BytesIO()
    with matplotlib.rc_context(dict(STYLE)):
        figure.savefig(stream, format=kind, dpi=DOTS_PER_INCH, metadata=dict(_METADATA[kind]))
    return stream.getvalue()


def save_figures(figures: Mapping[str, Figure], folder: Path) -> list[Path]:
    """Write every figure as PNG and, corner plots excepted, as SVG; returns the paths.

    Each file appears whole or not at all.

    Raises
    ------
    InputError
        The folder cannot be written.
    """
    return save_pictures({name: encoded(name, figure) for name, figure in figures.items()}, folder)


def save_pictures(pictures: Mapping[str, Picture], folder: Path) -> list[Path]:
    """Write every file of every picture as ``<name>.<kind>``; as :func:`save_figures`."""
    written = []
    for name, picture in pictures.items():
        for kind, content in picture.files.items():
            path = folder / f"{name}.{kind}"
            write_bytes(path, content)
            written.append(path)
    return written


def __getattr__(name: str) -> Any:
    """matplotlib's class of figures, for those who ask for it here."""
    if name != "Figure":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from matplotlib.figure import Figure

    return Figure
