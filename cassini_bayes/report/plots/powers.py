"""Powers of ten at logarithmic axes, as plain text.

Text in figures is never read as mathematics (:data:`~cassini_bayes.report.plots.style.STYLE`), so
that a name with a dollar in it is shown as it is; matplotlib's own labels are mathematics.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from matplotlib.axis import Axis

_RAISED: Final = str.maketrans("-−0123456789", "⁻⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_MARKUP: Final = re.compile(r"\$|\\mathdefault\{|\}$")


def plain(label: str) -> str:
    """Text of a label that matplotlib wrote as mathematics."""
    text = _MARKUP.sub("", label.removesuffix("$")).replace(r"\times", "×").replace("-", "−")
    return re.sub(r"\^\{([^}]*)\}", lambda found: found[1].translate(_RAISED), text)


def label_powers(axis: Axis, minor: bool = False) -> None:
    """Label a logarithmic axis; ``minor`` ticks too, where it spans less than a power."""
    from matplotlib.ticker import LogFormatterSciNotation

    class Powers(LogFormatterSciNotation):
        """``−2×10³`` in place of markup."""

        def __call__(self, x: float, pos: int | None = None) -> str:
            return plain(super().__call__(x, pos))

    axis.set_major_formatter(Powers())
    if minor:
        axis.set_minor_formatter(Powers())
