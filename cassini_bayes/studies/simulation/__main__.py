"""``python -m cassini_bayes.studies.simulation``."""

from __future__ import annotations

from cassini_bayes.studies.simulation.page import main

if __name__ == "__main__":
    main()
