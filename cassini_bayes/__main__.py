"""Start of the command line, ``python -m cassini_bayes`` as well."""

from __future__ import annotations

import sys


def main() -> None:
    """Import and run the command line; an interrupt meanwhile is one line, exit status 130."""
    try:
        from cassini_bayes.cli import main as command

        command()
    except KeyboardInterrupt:
        sys.stderr.write("stopped\n")
        sys.exit(130)


if __name__ == "__main__":
    main()
