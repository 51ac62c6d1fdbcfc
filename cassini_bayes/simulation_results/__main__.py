"""``python -m cassini_bayes.simulation_results``."""

from __future__ import annotations

from cassini_bayes.simulation_results.page import main

if __name__ == "__main__":
    main()
