"""Draw the packages and their imports for ``docs/topics/architecture.md``, from the sources alone.

``python docs/draw_architecture.py`` writes ``docs/figures/architecture.png``. Rows are layers, from
the longest chain of imports: a package is one row above the highest that it imports. An import that
follows from others is left out (reading events by way of the model needs no arrow of its own).
"""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path

from matplotlib.figure import Figure

ROOT = Path(__file__).parents[1] / "cassini_bayes"
OUT = Path(__file__).parent / "figures" / "architecture.png"


def packages() -> dict[str, set[str]]:
    """What every top-level package or module imports of the others."""
    names = {path.stem for path in ROOT.iterdir() if path.suffix == ".py" or path.is_dir()}
    names = {name for name in names if not name.startswith("__")}
    found: dict[str, set[str]] = {name: set() for name in names}
    for path in ROOT.rglob("*.py"):
        top = path.relative_to(ROOT).parts[0].removesuffix(".py")
        if top not in found:
            continue
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith(ROOT.name + "."):
                other = node.module.split(".")[1] if node.module else ""
                if other in names and other != top:
                    found[top].add(other)
    return found


def rows(imports: dict[str, set[str]]) -> dict[str, int]:
    """The layer of every package."""

    @cache
    def layer(name: str) -> int:
        return 1 + max((layer(other) for other in imports[name]), default=-1)

    return {name: layer(name) for name in imports}


def direct(imports: dict[str, set[str]]) -> dict[str, set[str]]:
    """Imports that do not follow from others."""

    @cache
    def below(name: str) -> frozenset[str]:
        return frozenset(imports[name]).union(*(below(other) for other in imports[name]))

    return {
        name: {
            other
            for other in others
            if not any(other in below(between) for between in others - {other})
        }
        for name, others in imports.items()
    }


def draw() -> Figure:
    """Boxes in rows, the lowest layer at the bottom, and an arrow for every direct import."""
    imports = packages()
    layer = rows(imports)
    by_row: dict[int, list[str]] = {}
    for name in sorted(layer):
        by_row.setdefault(layer[name], []).append(name)
    place = {
        name: ((i + 1) / (len(names) + 1), row)
        for row, names in by_row.items()
        for i, name in enumerate(names)
    }
    figure = Figure(figsize=(7.0, 8.0), layout="constrained")
    axes = figure.add_subplot()
    for name, others in direct(imports).items():
        for other in others:
            axes.annotate(
                "",
                place[other],
                place[name],
                arrowprops={"arrowstyle": "->", "color": "0.45", "shrinkA": 12, "shrinkB": 12},
            )
    for name, (x, y) in place.items():
        axes.text(
            x, y, name, ha="center", va="center", fontsize=10,
            bbox={"boxstyle": "round,pad=0.35", "facecolor": "#e8f0f8", "edgecolor": "#5b7fa6"},
        )  # fmt: skip
    axes.set_xlim(0.0, 1.0)
    axes.set_ylim(-0.6, max(by_row) + 0.6)
    axes.axis("off")
    return figure


if __name__ == "__main__":
    draw().savefig(OUT, dpi=110)
