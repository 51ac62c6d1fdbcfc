"""Published figures of the Cassini papers, transcribed and checked by their own arithmetic.

``docs/reference/published-data.md`` says what is here, from which table, and which cells contradict
themselves. ``flight_2009_2010.csv`` holds the eight flight events of paper 001 in the totals format
of the package; everything else is read through the functions below. Papers: 000 inertia and
thruster estimation (2005), 001 flight-calibrated on-times (2010), 002 inertia extended abstract,
003 thruster calibration (2012), 004 hybrid controllers (2012).
"""

from cassini_bayes.published.arithmetic import Published, all_checks, published
from cassini_bayes.published.checks import Check, contradictions
from cassini_bayes.published.constants import Constants, published_constants
from cassini_bayes.published.mass import TableMass, table_mass
from cassini_bayes.published.printed import Interval, Printed
from cassini_bayes.published.tables import (
    a_branch_thrusts,
    b_branch_thrusts,
    bias_thrusts,
    day_28_pulses,
    inertia_comparisons,
    inertia_tensors,
    perturbations,
    torque_estimates,
)
from cassini_bayes.published.totals import totals_csv
from cassini_bayes.published.wheel_bias import WheelBiasTable, wheel_bias_tables

__all__ = [
    "Check",
    "Constants",
    "Interval",
    "Printed",
    "Published",
    "TableMass",
    "WheelBiasTable",
    "a_branch_thrusts",
    "all_checks",
    "b_branch_thrusts",
    "bias_thrusts",
    "contradictions",
    "day_28_pulses",
    "inertia_comparisons",
    "inertia_tensors",
    "perturbations",
    "published",
    "published_constants",
    "table_mass",
    "torque_estimates",
    "totals_csv",
    "wheel_bias_tables",
]
