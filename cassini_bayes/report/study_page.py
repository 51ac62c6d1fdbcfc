"""Results pages for the documentation: one frame around every study's own text.

A page says what made it (command, seed, versions, digest of the code) and nothing of the machine it
was made on; its tables and figures lie beside it under its name.
"""

from __future__ import annotations

import importlib.metadata
import platform
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import pandas as pd

from cassini_bayes import __version__
from cassini_bayes.files.code import code_digest
from cassini_bayes.files.storage import write_bytes, write_text
from cassini_bayes.files.tables import frame_csv
from cassini_bayes.report.plots import Figure, encode

LIBRARIES: Final = ("numpy", "scipy", "numba")


@dataclass(frozen=True)
class Made:
    """What made a page: the command line, its seed, and the module whose code it ran."""

    command: Sequence[str]
    seed: int
    module: str

    def line(self) -> str:
        """The last line of a page."""
        versions = ", ".join(f"{name} {importlib.metadata.version(name)}" for name in LIBRARIES)
        return (
            f"Made by `{' '.join(map(_without_place, self.command))}` (seed {self.seed}) with "
            f"cassini_bayes {__version__}, Python {platform.python_version()}, {versions}; SHA-256 "
            f"of the code `{code_digest(self.module)[:16]}…`."
        )


def write_page(
    page: Path,
    title: str,
    body: str,
    made: Made,
    tables: Mapping[str, pd.DataFrame | str],
    figures: Mapping[str, Figure | bytes],
) -> None:
    """Write a page and what lies beside it, each file whole or not at all.

    Parameters
    ----------
    page
        The Markdown file.
    title, body
        Heading and text.
    tables, figures
        By what their name has beyond the page's: ``""`` is ``<page>.csv``, ``-worth``
        ``<page>-worth.csv``. A table is a data frame or CSV text, a figure may be PNG bytes.
    """
    for name, figure in figures.items():
        content = figure if isinstance(figure, bytes) else encode(figure, "png")
        write_bytes(page.with_name(f"{page.stem}{name}.png"), content)
    for name, table in tables.items():
        text = table if isinstance(table, str) else frame_csv(table, digits=6)
        write_text(page.with_name(f"{page.stem}{name}.csv"), text)
    write_text(page, f"# {title}\n\n{body.strip()}\n\n{made.line()}\n")


def markdown_table(header: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """A table in Markdown: names of columns, and the cells of every row."""
    names = list(header)
    lines = [names, ["---"] * len(names), *rows]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in lines)


def table_of(rows: pd.DataFrame | Iterable[Mapping[str, Any]], header: str, cells: str) -> str:
    """Rows in Markdown: names of columns, and cells of a row (``{name:.2f}``), parted by ``|``."""
    known = rows.to_dict(orient="records") if isinstance(rows, pd.DataFrame) else rows
    written = (cells.format_map(row).split(" | ") for row in known)
    return markdown_table(header.split(" | "), written)


def _without_place(argument: str) -> str:
    """An argument without where on this machine it points."""
    path = Path(argument)
    if not path.is_absolute():
        return argument
    return str(path.relative_to(Path.cwd())) if path.is_relative_to(Path.cwd()) else path.name
