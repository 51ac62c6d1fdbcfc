"""A finished run as the report sees it: the fit, and tables worked out when asked for."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
import pandas as pd

from cassini_bayes.balance.inertia import Physicality, physicality
from cassini_bayes.computing.arrays import Array
from cassini_bayes.computing.arviz_import import arviz
from cassini_bayes.computing.cached import cached_property
from cassini_bayes.computing.processes import in_processes
from cassini_bayes.model.observability import Observability, event_worth, observability
from cassini_bayes.model.posterior import Model
from cassini_bayes.priors.reader import Priors
from cassini_bayes.results.delta_v_uses import thrusts_by_delta_v_use
from cassini_bayes.results.fitting import stop_rule_held
from cassini_bayes.results.inertia import inertia_table, tensors_of
from cassini_bayes.results.inertia_baselines import inertia_methods
from cassini_bayes.results.record import Fit
from cassini_bayes.results.sensitivity import error_budget
from cassini_bayes.results.tables import (
    balance_table,
    conflict_sentences,
    delta_v_table,
    event_table,
    nuisance_table,
    predictive_table,
    summarise,
    thrust_baselines,
    thrust_conflicts,
    wide_sentences,
    worst_convergence,
)
from cassini_bayes.results.telemetry_baselines import torque_methods
from cassini_bayes.results.time_series import EventSeries, event_series
from cassini_bayes.sampling.ensembles import MAX_RHAT

VARIANT_STREAM: Final = 3
SERIES_STREAM: Final = 4
LONGEST: Final = ("summary", "budget", "variants", "series", "baseline")


@dataclass(frozen=True)
class Review:
    """One run: its model and fit, what is to be said of it as a whole, and its tables.

    ``z`` (n, d) are the walked draws of the fit, flattened; ``notes`` sentences about anything that
    makes the draws doubtful; ``what_if`` asks for thrusts under other uses of ΔV, each of which
    takes a fit. Column names carry units. Every interval is a 90 % highest-density interval.
    """

    name: str
    model: Model
    priors: Priors
    fit: Fit
    z: Array
    convergence: pd.DataFrame
    facts: Mapping[str, str]
    notes: tuple[str, ...] = ()
    seed: int = 0
    what_if: bool = False

    def _stream(self, which: int) -> np.random.Generator:
        return np.random.default_rng(np.random.SeedSequence((self.seed, which)))

    def work_out(self, processes: int) -> None:
        """Work out the tables that take longest side by side; they are kept like any other."""
        arviz()  # before the processes part, which then need not
        tables = in_processes(lambda name: getattr(self, name), LONGEST, processes)
        vars(self).update(zip(LONGEST, tables, strict=True))

    @cached_property
    def warnings(self) -> tuple[str, ...]:
        """What has to be read first."""
        is_broken = self.model.telemetry and self.physicality.is_broken
        physical = (self.physicality.sentence,) if is_broken else ()
        unseen = self.observability.unseen_effects if self.model.effects else ()
        thrusts = thrust_conflicts(self.summary)
        thrusts = thrusts[~thrusts["name"].isin(self.nuisances["name"])]
        pulled = (*conflict_sentences(thrusts), *conflict_sentences(self.nuisances))
        wide = wide_sentences(self.model.space.names, self.z)
        return (*self.notes, *physical, *unseen, *pulled, *wide)

    @cached_property
    def summary(self) -> pd.DataFrame:
        """One row per scalar of the posterior."""
        return summarise(self.fit)

    @cached_property
    def nuisances(self) -> pd.DataFrame:
        """Prior against posterior of every walked parameter."""
        return nuisance_table(self.model, self.priors, self.z)

    @cached_property
    def budget(self) -> pd.DataFrame:
        """Where each thrust's variance comes from."""
        return error_budget(self.model, self.z)

    @cached_property
    def baseline(self) -> pd.DataFrame:
        """Thrusts by the methods this package replaces."""
        return thrust_baselines(self.model)

    @cached_property
    def predictive(self) -> pd.DataFrame:
        """On-times flown again."""
        return predictive_table(self.fit)

    @cached_property
    def balance(self) -> pd.DataFrame:
        """Momentum left over."""
        return balance_table(self.model, self.fit, self.z, self.series)

    @cached_property
    def delta_v(self) -> pd.DataFrame:
        """Printed ΔV against the on-board computation."""
        return delta_v_table(self.model, self.fit)

    @cached_property
    def variants(self) -> pd.DataFrame:
        """Thrusts under every use of ΔV."""
        if not self.what_if:
            return pd.DataFrame()
        rng = self._stream(VARIANT_STREAM)
        return thrusts_by_delta_v_use(self.model, self.priors, self.fit, rng)

    @cached_property
    def series(self) -> tuple[EventSeries, ...]:
        """Balances of telemetry, row by row."""
        return event_series(self.model, self.z, self._stream(SERIES_STREAM))

    @cached_property
    def events(self) -> pd.DataFrame:
        """Rows read and used of telemetry."""
        return event_table([term.event for term in self.model.telemetry], self.series)

    @cached_property
    def mends(self) -> tuple[str, ...]:
        """What was repaired in telemetry while it was read."""
        events = (term.event for term in self.model.telemetry)
        return tuple(f"{event.id}: {line}" for event in events for line in event.reading.mends)

    @cached_property
    def observability(self) -> Observability:
        """What the events can see, before anything is sampled."""
        return observability(self.model)

    @cached_property
    def worth(self) -> pd.DataFrame:
        """How much narrower shared quantities are for each event."""
        return event_worth(self.model)

    @cached_property
    def physicality(self) -> Physicality:
        """Whether a rigid body can have the inertia drawn."""
        return physicality(tensors_of(self.fit)[0])

    @cached_property
    def inertia(self) -> pd.DataFrame:
        """The inertia tensor both ways."""
        return inertia_table(*tensors_of(self.fit))

    @cached_property
    def inertia_methods(self) -> pd.DataFrame:
        """The papers' least squares for the inertia."""
        return inertia_methods(self.model)

    @cached_property
    def torque_methods(self) -> pd.DataFrame:
        """Torques from the wheels' drift."""
        return torque_methods(self.model)


def is_converged(review: Review) -> bool:
    """Whether the stop rule held, and every scalar has its R-hat and effective sample size."""
    rhat, bulk, tail = worst_convergence(review.summary)
    target = float(review.fit.attributes.get("target_ess", 0.0))
    return bool(
        stop_rule_held(review.fit) and rhat < MAX_RHAT and bulk >= target and tail >= target
    )
