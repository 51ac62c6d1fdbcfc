"""``python tests/fuzz``: see :mod:`fuzzing`."""

from __future__ import annotations

import sys
from pathlib import Path


def start() -> int:
    """Find the tests' own modules, as pytest does, and run."""
    sys.path.insert(0, str(Path(__file__).parents[1]))
    import fuzzing

    return fuzzing.main()


if __name__ == "__main__":
    sys.exit(start())
