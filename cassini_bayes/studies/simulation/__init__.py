"""Results of the simulation, by one command: ``cassini-bayes calibrate simulation``.

Writes a page with its tables and figures: momentum, order of the integrator, impulse, speed, the
FSDS case of paper 000, the eight biases of paper 001, the specific impulse behind printed
hydrazine, and which settings of the thruster controller the flight data support.
"""

from __future__ import annotations

from cassini_bayes.studies.simulation.page import FULL, QUICK, simulation_results

__all__ = ["FULL", "QUICK", "simulation_results"]
