"""Results of the simulation, by one command: ``python -m cassini_bayes.studies.simulation``.

Writes ``simulation.md``, its CSV tables and figures into a folder (``docs/results``): momentum,
order of the integrator, impulse, speed, the FSDS case of paper 000, the eight biases of paper 001,
the specific impulse behind printed hydrazine, and which settings of the thruster controller the
flight data support.
"""

from __future__ import annotations

from cassini_bayes.studies.simulation.page import main, make_report

__all__ = ["main", "make_report"]
