"""Files of drafted effects: a Python file and its table, as ``--effects`` takes them.

What is written runs as it is and says what was seen, not why: physics is the reader's to put in.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

from cassini_bayes.diagnosis.drafts import Draft
from cassini_bayes.files.storage import write_text
from cassini_bayes.report.templating import rendered

WIDER: Final = 3.0
"""Times the size found: a prior that holds it without having been fitted to it (judgement)."""
_UNITS: Final = {
    "thrust_share": "1",
    "torque_n_m": "N m",
    "momentum_n_m_s": "N m s",
    "cosine_n_m_s": "N m s",
    "sine_n_m_s": "N m s",
    "momentum_x_n_m_s": "N m s",
    "momentum_y_n_m_s": "N m s",
    "momentum_z_n_m_s": "N m s",
}


def draft_files(draft: Draft) -> tuple[str, str]:
    """The effect's Python file and its table."""
    numbers = {key: _number(value) for key, value in draft.numbers.items()}
    code = rendered(
        "draft_effect.py.jinja", draft=draft, says=_capital(draft.words), numbers=numbers
    )
    widths = {key: f"{WIDER * max(abs(mean), sd):.2g}" for key, (mean, sd) in draft.sizes.items()}
    if draft.form == "oscillation":
        (width,) = widths.values()
        widths = {"cosine_n_m_s": width, "sine_n_m_s": width}
    table = rendered(
        "draft_effect.toml.jinja",
        draft=draft,
        parameters=[(key, _UNITS[key], width) for key, width in widths.items()],
    )
    return code, table


def write_drafts(drafts: tuple[Draft, ...], folder: Path) -> None:
    """Write ``<name>.py`` and ``<name>.toml`` of every draft that predicts what was held out.

    Raises
    ------
    InputError
        The folder cannot be written.
    """
    for draft in drafts:
        if draft.is_gain:
            code, table = draft_files(draft)
            write_text(folder / f"{draft.name}.py", code)
            write_text(folder / f"{draft.name}.toml", table)


def _number(value: float) -> str:
    """As Python writes it; without end: infinity."""
    return "float('inf')" if value == float("inf") else f"{value:.6g}"


def _capital(text: str) -> str:
    return text[0].upper() + text[1:]
