"""What every test relies on: one BLAS thread, figures without a screen, repeatable hypothesis."""

from __future__ import annotations

import os

# Before numpy or matplotlib is imported by any test module.
for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(variable, "1")
os.environ["MPLBACKEND"] = "Agg"

import hypothesis

# The same examples on every run: a failure is the change's, not the day's. Deadlines off: a busy
# machine is no failure.
hypothesis.settings.register_profile("repeatable", derandomize=True, deadline=None)
hypothesis.settings.load_profile("repeatable")
