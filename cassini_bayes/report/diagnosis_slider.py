"""Had priors of the causes' sizes been wider or narrower: probabilities that follow a slider."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

from cassini_bayes.report.page import Slider, SliderPrior, SliderRow
from cassini_bayes.report.plots.quantities import MISSING, display_scale
from cassini_bayes.report.priors import width_label
from cassini_bayes.sampling.warmstart import TRUSTED_K

Record = Mapping[str, Any]
LEAST: Final = 0.001  # probability that a hypothesis has at some width, to be shown
MOST: Final = 6  # hypotheses shown


def width_slider(record: Record) -> Slider | None:
    """Probabilities of the best hypotheses, and the best cause's sizes, at every width."""
    rows: Sequence[Record] = record.get("by_width") or []
    trusted = [row for row in rows if row["trusted"]]
    start = next((i for i, row in enumerate(rows) if row["width"] == 1.0), None)
    if start is None or not rows[start]["trusted"]:
        return None
    names = _names(record, trusted)
    sizes = list(_sizes(record, trusted))
    return Slider(
        quantities=(*(label for label, *_ in sizes), *(f"probability of {name}" for name in names)),
        units=(*(unit for _, unit, *_ in sizes), *("1" for _ in names)),
        widths=tuple(width_label(row["width"]) for row in rows),
        start=start,
        priors=(
            SliderPrior(
                name="size of every cause",
                notes=tuple(_note(row) for row in rows),
                trusted=tuple(row["trusted"] for row in rows),
                rows=tuple(_cells(row, sizes, names) for row in rows),
            ),
        ),
        shown="mean ± sd or probability",
        numbers="diagnosis.json (by_width)",
    )


def _names(record: Record, trusted: Sequence[Record]) -> list[str]:
    """Hypotheses that have some probability at any width, the most probable as diagnosed first."""
    told = {
        name for row in trusted for name, share in row["probabilities"].items() if share >= LEAST
    }
    return [cause["name"] for cause in record["causes"] if cause["name"] in told][:MOST]


Axis = tuple[str, str, str, float, float, float]


def _sizes(record: Record, trusted: Sequence[Record]) -> Iterator[Axis]:
    """Label, unit, key, factor to the unit and ends of the axis of every size of a named cause."""
    name = trusted[0]["cause"]
    if record["causes"][0]["name"] != name:  # nothing is named
        return
    parameters: Record = next((c["parameters"] for c in record["causes"] if c["name"] == name), {})
    for key, size in parameters.items():
        if key not in trusted[0]["sizes"]:
            continue
        ends = [end for row in trusted for end in row["sizes"][key]["hdi_90"]]
        scale = display_scale(size["unit"], size["mean"], size["sd"])
        low, high = min(ends), max(ends)
        if high > low:
            unit = "1" if scale.unit == MISSING else scale.unit
            yield f"{name}: {key}", unit, key, scale.factor, low, high


def _cells(
    row: Record, sizes: Sequence[Axis], names: Sequence[str]
) -> tuple[SliderRow | None, ...]:
    if not row["trusted"]:
        return tuple(None for _ in (*sizes, *names))
    cells = []
    for _, _, key, factor, low, high in sizes:
        size = row["sizes"][key]
        mean, sd, left, right = (factor * v for v in (size["mean"], size["sd"], *size["hdi_90"]))
        cells.append(SliderRow.of(mean, sd, (left, right), (factor * low, factor * high)))
    for name in names:
        share = row["probabilities"].get(name, 0.0)
        cells.append(SliderRow(f"{share:.3f}", "–", 0.0, round(100.0 * share, 1)))
    return tuple(cells)


def _note(row: Record) -> str:
    """How far the draws can be trusted."""
    k = row["pareto_k"]
    if row["trusted"]:
        return "as diagnosed" if k is None else f"Pareto k̂ {max(k, 0.0):.2f} at worst"
    if k is not None and k > TRUSTED_K:
        return f"The draws of this diagnosis cannot say: Pareto k̂ is {k:.2f}, above {TRUSTED_K}"
    return "The draws of this diagnosis cannot say: the cause has none that can be weighted"
