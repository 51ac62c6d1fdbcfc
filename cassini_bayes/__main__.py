"""Start of the command line, ``python -m cassini_bayes`` as well."""

from __future__ import annotations

import gc


def main() -> None:
    """Import and run the command line.

    What is imported stays: to look for garbage meanwhile would take a fifth of the time.
    """
    gc.disable()
    from cassini_bayes.cli import main as command

    gc.enable()
    command()


if __name__ == "__main__":
    main()
