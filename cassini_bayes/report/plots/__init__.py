"""Figures of a review, as matplotlib objects outside any plotting session."""

from __future__ import annotations

import io
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, Literal

import matplotlib
from matplotlib.figure import Figure

from cassini_bayes.files.storage import write_bytes
from cassini_bayes.report.plots.budget import budget_figure
from cassini_bayes.report.plots.checks import (
    balance_figure,
    convergence_figure,
    predictive_figure,
)
from cassini_bayes.report.plots.corners import nuisance_corners, thrust_corner
from cassini_bayes.report.plots.delta_v import delta_v_figure, delta_v_thrust_figure
from cassini_bayes.report.plots.inertia import inertia_figure, observability_figure
from cassini_bayes.report.plots.nuisances import nuisance_figure, torque_figure
from cassini_bayes.report.plots.style import STYLE
from cassini_bayes.report.plots.thrusts import thrust_figure
from cassini_bayes.report.plots.time_series import series_figures
from cassini_bayes.results.review import Review

__all__ = ["Figure", "encode", "is_corner", "make_figures", "save_figures", "settle"]

DOTS_PER_INCH: Final = 150
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


def make_figures(review: Review) -> dict[str, Figure]:
    """Every figure of a review by name, in the order of the report.

    Names: ``thrusts``, ``corner_thrusts``, ``nuisances``, ``torques``, ``corner_nuisances_1`` …,
    ``budget``, ``predictive``, ``balance``, ``delta_v``, ``delta_v_thrusts``, ``convergence``; with
    telemetry also ``inertia``, ``observability`` and ``series_1`` …. A figure that has nothing to
    show (no ΔV, fewer than two free parameters) is absent.
    """
    with matplotlib.rc_context(dict(STYLE)):
        found: dict[str, Figure | None] = {
            "thrusts": thrust_figure(review),
            "corner_thrusts": thrust_corner(review),
            "inertia": inertia_figure(review),
            "observability": observability_figure(review),
            "nuisances": nuisance_figure(review),
            "torques": torque_figure(review),
        }
        for i, page in enumerate(nuisance_corners(review), start=1):
            found[f"corner_nuisances_{i}"] = page
        found |= {
            "budget": budget_figure(review),
            "predictive": predictive_figure(review),
            "balance": balance_figure(review),
            "delta_v": delta_v_figure(review),
            "delta_v_thrusts": delta_v_thrust_figure(review),
            "convergence": convergence_figure(review),
            **series_figures(review),
        }
        figures = {name: figure for name, figure in found.items() if figure is not None}
        for figure in figures.values():
            settle(figure)
    return figures


def settle(figure: Figure, solutions: int = 2) -> None:
    """Lay the figure out once and for all: faster to write, and the same in every format.

    The layout is solved ``solutions`` times, because labels may change with the size of their axes;
    ticks get their size for good, because those made later would take it from the session's
    settings. A figure that keeps an engine, even one that does nothing, is drawn twice for every
    file.
    """
    engine = figure.get_layout_engine()
    if engine is not None:
        for axes in figure.axes:
            axes.tick_params(labelsize=STYLE["xtick.labelsize"])
        with matplotlib.rc_context(dict(STYLE) | dict(_NO_LAYOUT)):
            for _ in range(solutions):
                engine.execute(figure)
            figure.set_layout_engine(None)


def is_corner(name: str) -> bool:
    """Whether a figure is a corner plot: many megabytes as SVG, so PNG only."""
    return name.startswith(CORNER)


def encode(figure: Figure, kind: Kind) -> bytes:
    """The figure as PNG (150 dpi) or SVG (text as outlines, no fonts needed), reproducibly."""
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
    written = []
    for name, figure in figures.items():
        for kind in _KINDS[:1] if is_corner(name) else _KINDS:
            path = folder / f"{name}.{kind}"
            write_bytes(path, encode(figure, kind))
            written.append(path)
    return written
