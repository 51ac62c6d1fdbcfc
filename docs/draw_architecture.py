"""Draw the packages and their imports for ``docs/topics/architecture.md``, from the sources alone.

``python docs/draw_architecture.py`` writes ``docs/figures/architecture.png``. Rows are layers, from
the longest chain of imports: a package is one row above the highest that it imports. An import that
follows from others is left out (reading events by way of the model needs no arrow of its own).
Where an arrow passes a row it has a place there as a box has, so none runs behind a box.
"""

from __future__ import annotations

import ast
from functools import cache
from itertools import chain, pairwise
from pathlib import Path as File

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch, FancyBboxPatch
from matplotlib.path import Path
from scipy.optimize import linprog

ROOT = File(__file__).parents[1] / "cassini_bayes"
OUT = File(__file__).parent / "figures" / "architecture.png"
HEIGHT = 0.42  # of a box; rows are 1 apart
SWEEPS = 20
WEIGHTS = (8.0, 2.0, 1.0)  # of a line's way sideways, by how many boxes are at its ends

Node = str | tuple[str, str, int]  # a package, or where an import passes a row


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


def chains(layer: dict[str, int]) -> list[list[Node]]:
    """Every direct import from box to box, by a place of its own in each row that it passes."""
    return [
        [name, *((name, other, row) for row in range(layer[name] - 1, layer[other], -1)), other]
        for name, others in sorted(direct(packages()).items())
        for other in sorted(others)
    ]


def ordered(layer: dict[str, int], lines: list[list[Node]]) -> list[list[Node]]:
    """Boxes and passing lines of every row from left to right: in order of what they are joined to.

    Row by row downwards and upwards, by the mean place of all neighbours.
    """
    joined: dict[Node, list[Node]] = {name: [] for name in sorted(layer)}
    for line in lines:
        for one, other in pairwise(line):
            joined.setdefault(one, []).append(other)
            joined.setdefault(other, []).append(one)
    levels: list[list[Node]] = [[] for _ in range(max(layer.values()) + 1)]
    for node in joined:
        levels[row_of(node, layer)].append(node)
    place = {node: (i + 0.5) / len(level) for level in levels for i, node in enumerate(level)}
    for sweep in range(SWEEPS):
        for level in levels if sweep % 2 else levels[::-1]:
            level.sort(key=lambda node: float(np.mean([place[other] for other in joined[node]])))
            place |= {node: (i + 0.5) / len(level) for i, node in enumerate(level)}
    return levels


def across(levels: list[list[Node]], lines: list[list[Node]]) -> dict[Node, float]:
    """Where they are: lines as straight as the order lets them be.

    The least sum of what lines move sideways, those that pass other rows weighed more: a linear
    programme.
    """
    number = {node: i for i, node in enumerate(chain(*levels))}
    joints = [joint for line in lines for joint in pairwise(line)]
    beside = [pair for level in levels for pair in pairwise(level)]
    apart = np.zeros((len(beside), len(number)))
    moved = np.zeros((len(joints), len(number)))
    for table, pairs in ((apart, beside), (moved, joints)):
        for row, (one, other) in zip(table, pairs, strict=True):
            row[[number[one], number[other]]] = 1.0, -1.0
    most = -np.eye(len(joints))  # how far each joint moves at most, either way
    table = np.block([[apart, np.zeros((len(beside), len(joints)))], [moved, most], [-moved, most]])
    room = [-0.5 * (width(one) + width(other)) for one, other in beside]
    weights = [WEIGHTS[sum(isinstance(node, str) for node in joint)] for joint in joints]
    found = linprog([0.0] * len(number) + weights, A_ub=table, b_ub=room + 2 * len(joints) * [0.0])
    return {node: float(found.x[i]) for node, i in number.items()}


def row_of(node: Node, layer: dict[str, int]) -> int:
    """The row that a box or a passing line is in."""
    return layer[node] if isinstance(node, str) else node[2]


def width(node: Node) -> float:
    """Room that a box or a passing line takes."""
    return 0.5 + 0.09 * len(node) if isinstance(node, str) else 0.5


def path_of(line: list[Node], layer: dict[str, int], place: dict[Node, float]) -> Path:
    """From the lower edge of a box to the upper edge of another, straight down past other rows."""
    points: list[tuple[float, float]] = []
    for one, other in pairwise(line):
        high, low = (row_of(node, layer) for node in (one, other))
        start, end = high - 0.5 * HEIGHT, low + 0.5 * HEIGHT
        middle = 0.5 * (start + end)
        a, b = place[one], place[other]
        points += [(a, start), (a, middle), (b, middle), (b, end)]
    codes = [Path.MOVETO, *3 * [Path.CURVE4]]
    codes += (len(line) - 2) * [Path.LINETO, *3 * [Path.CURVE4]]
    return Path(points, codes)


def draw() -> Figure:
    """Boxes in rows, the lowest layer at the bottom, and an arrow for every direct import."""
    layer = rows(packages())
    lines = chains(layer)
    place = across(ordered(layer, lines), lines)
    figure = Figure(figsize=(7.0, 8.5), layout="constrained")
    axes = figure.add_subplot()
    for line in lines:
        path = path_of(line, layer, place)
        axes.add_patch(
            FancyArrowPatch(
                path=path, arrowstyle="-|>", mutation_scale=9, color="0.45", fill=True, lw=0.9
            )
        )
    for name, y in layer.items():
        x, wide = place[name], width(name) - 0.3
        axes.add_patch(
            FancyBboxPatch(
                (x - 0.5 * wide, y - 0.5 * HEIGHT), wide, HEIGHT,
                boxstyle="round,pad=0,rounding_size=0.08",
                facecolor="#e8f0f8", edgecolor="#5b7fa6",
            )
        )  # fmt: skip
        axes.text(x, y, name, ha="center", va="center_baseline", fontsize=10)
    sides = [place[name] + side * 0.5 * width(name) for name in layer for side in (-1, 1)]
    axes.set_xlim(min(sides), max(sides))
    axes.set_ylim(-0.5, max(layer.values()) + 0.5)
    axes.axis("off")
    return figure


if __name__ == "__main__":
    draw().savefig(OUT, dpi=110)
