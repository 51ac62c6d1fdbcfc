"""ArviZ and corner without the notice that ArviZ prints on its first import of a day.

The notice announces ArviZ's next major version, which a user of this package need not heed. Both
take two seconds to import, and corner imports ArviZ: call these where they are needed.
"""

from __future__ import annotations

import importlib
import warnings
from functools import cache
from typing import Any, Final

_NOTICE: Final = r"\s*ArviZ is undergoing"  # the text starts with a newline


def arviz() -> Any:  # the library carries no types
    """The module ``arviz``."""
    return _quietly("arviz")


def corner() -> Any:  # the library carries no types
    """The module ``corner``."""
    return _quietly("corner")


@cache  # the filters are the whole process's: leave them alone once the module is there
def _quietly(name: str) -> Any:
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=_NOTICE, category=FutureWarning)
        try:
            return importlib.import_module(name)
        except (AttributeError, OSError, RuntimeError) as error:  # half installed, or too old
            raise ImportError(str(error), name=name) from error
