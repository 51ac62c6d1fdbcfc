"""Mistakes hidden in honest data: which are refused by name, and are honest events let be?"""

from __future__ import annotations

from cassini_bayes.studies.mistakes.campaign import FULL, QUICK
from cassini_bayes.studies.mistakes.page import run_mistakes

__all__ = ["FULL", "QUICK", "run_mistakes"]
