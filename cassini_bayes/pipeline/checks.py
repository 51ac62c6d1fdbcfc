"""All that is known of events and priors before anything is sampled, on one page."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Final

import numpy as np
import pandas as pd

from cassini_bayes.computing.log import Log, silent
from cassini_bayes.computing.threads import one_thread
from cassini_bayes.effects.effect import Effect
from cassini_bayes.events.plausibility import Policy
from cassini_bayes.events.totals import TotalsEvent
from cassini_bayes.model.gather import EventLike, PathLike
from cassini_bayes.model.observability import Observability, observability
from cassini_bayes.model.posterior import Event, Model, collapse, log_posterior
from cassini_bayes.model.thrusts import level_moments
from cassini_bayes.model.totals import DeltaVUse
from cassini_bayes.pipeline.models import PriorsLike, priors_of, read_model
from cassini_bayes.pipeline.starting import PLACEHOLDER
from cassini_bayes.priors.reader import Priors
from cassini_bayes.report.shown import html_of, with_interval
from cassini_bayes.results.fitting import collapsed_size
from cassini_bayes.results.sensitivity import conflicts
from cassini_bayes.sampling.ensembles import SamplerSettings
from cassini_bayes.sampling.warmstart import highest_mode

TYPICAL_STEPS: Final = (200, 1_000)
"""Steps of an ensemble after which the shipped runs met the stop rule: the first check, and five
times as many where counters leave much open."""
OVERHEAD: Final = 1.5
"""Of sampling over its likelihood calls: proposals, checks, checkpoints (measured on the demo)."""
_MOST_ROWS: Final = 14


@dataclass(frozen=True, eq=False, repr=False)
class CheckResult:
    """What was found before sampling.

    ``rows`` says what of every event is used; ``findings`` which mistakes were accepted and what
    fits nothing known; ``seen`` what the events can tell (linearised at the prior means);
    ``disagree`` what prior and data disagree on at the mode; ``seconds`` between which a run takes
    its draws here; ``placeholders`` which parameters have priors that ``init`` made up.
    """

    model: Model
    rows: pd.DataFrame
    findings: tuple[str, ...]
    seen: Observability
    disagree: pd.DataFrame
    seconds: tuple[float, float]
    placeholders: tuple[str, ...] = ()

    @property
    def warnings(self) -> tuple[str, ...]:
        """What has to be read first: placeholders, findings, unseen effects, conflicts."""
        found = (*self.findings, *self.seen.unseen_effects, *self._conflicts)
        if not self.placeholders:
            return found
        names = ", ".join(self.placeholders)
        return (f"{len(self.placeholders)} of the priors are placeholders: {names}", *found)

    @property
    def _conflicts(self) -> tuple[str, ...]:
        rows = self.disagree[self.disagree["verdict"] == "conflict"].to_dict(orient="records")
        return tuple(
            f"{row['name']}: the data pull it {row['surprise']:+.1f} standard deviations from its "
            f"prior ({row['prior']:.4g} → {row['mode']:.4g} {row['unit']}): something is wrong, and"
            " need not be wrong there; diagnose the events"
            for row in rows
        )

    def summary(self) -> pd.DataFrame:
        """What the events can see: prior and expected posterior width of every quantity.

        Returns
        -------
        DataFrame: ``quantity``, ``block``, ``unit``, ``prior_sd``, ``expected_sd``, ``ratio``,
        ``verdict``; widths are standard deviations, linearised at the prior means.
        """
        return with_interval(self.seen.table, "standard deviations, linearised")

    def as_record(self) -> dict[str, Any]:
        """Everything as plain JSON types."""
        return {
            "rows": self.rows.to_dict(orient="records"),
            "findings": list(self.findings),
            "placeholders": list(self.placeholders),
            "seen": self.seen.table.to_dict(orient="records"),
            "together": [list(pair) for pair in self.seen.together],
            "conflicts": list(self._conflicts),
            "walked": len(self.model.space.names),
            "collapsed": collapsed_size(self.model),
            "seconds": [round(entry, 1) for entry in self.seconds],
        }

    @property
    def sentences(self) -> tuple[str, ...]:
        """Size of the model, and how long sampling takes on this machine."""
        least, most = self.seconds
        count = len(self.model.event_ids)
        return (
            f"{count} event{'' if count == 1 else 's'}, {len(self.model.space.names)} walked and "
            f"{collapsed_size(self.model)} collapsed parameters.",
            f"Sampling takes about {least:.0f} to {most:.0f} s here (four ensembles, "
            f"{TYPICAL_STEPS[0]} to {TYPICAL_STEPS[1]:,} steps).",
            *self.seen.sentences,
        )

    def __repr__(self) -> str:
        table = self.seen.table.sort_values("ratio")
        columns = ["quantity", "unit", "prior_sd", "expected_sd", "ratio", "verdict"]
        more = max(0, len(table) - _MOST_ROWS)
        parts = [
            "Events",
            self.rows.drop(columns="mended").to_string(index=False, float_format="{:.4g}".format),
            *(
                f"mended in {row['event']}: {row['mended']}"
                for row in self.rows.to_dict(orient="records")
                if row["mended"]
            ),
            "",
            "What these events can see (posterior over prior width, linearised)",
            table.head(_MOST_ROWS)[columns].to_string(index=False, float_format="{:.3g}".format),
            *([f"… and {more} more (--json, or summary(), has all)"] if more else []),
            "",
            *self.sentences,
            "",
            *(self.warnings or ("Nothing contradicts: data, priors and physics agree.",)),
        ]
        return "\n".join(parts)

    def _repr_html_(self) -> str:
        lines = [*self.sentences, *self.warnings]
        return html_of("Before sampling", lines, self.summary())


@one_thread()
def check(
    events: EventLike | Iterable[EventLike] | Model,
    priors: PriorsLike | None = None,
    *,
    effects: Sequence[str | Effect] = (),
    effect_files: Sequence[PathLike] = (),
    pulse_shape: str = "first_order",
    delta_v: DeltaVUse = "as-declared",
    source: str = "flight",
    accept: Sequence[str] = (),
    leave_out: bool = False,
    log: Log = silent,
) -> CheckResult:
    """All that is known before sampling: plausibility, rows used, what can be seen, conflicts.

    The model is linearised at the prior means: with information matrix J of the data in standard
    normal coordinates, the expected posterior covariance is (1 + J)⁻¹. Conflicts are judged at the
    posterior's mode: mode / √(1 − s²), s the expected posterior over prior width, is a standard
    normal deviate where prior and data agree.

    Parameters
    ----------
    events, priors, effects, effect_files, pulse_shape, delta_v, source, accept, leave_out
        As for :func:`build_model`; or a model alone.
    log
        Told what was read.

    Raises
    ------
    InputError
        What a fit would refuse is refused here.
    """
    policy = Policy.of(accept, leave_out=leave_out)
    reading = (effects, effect_files, pulse_shape, delta_v, source, policy, log)
    known = None if priors is None else priors_of(priors)
    read = read_model(events, known, *reading)
    model = read.model
    seen = observability(model)
    mode = highest_mode(partial(log_posterior, model), model.starts)
    return CheckResult(
        model=model,
        rows=pd.DataFrame([_row(event) for event in read.events]),
        findings=read.findings,
        seen=seen,
        disagree=_disagreement(model, seen, mode),
        seconds=_seconds(model, mode),
        placeholders=() if known is None else _placeholders(known),
    )


def _placeholders(priors: Priors) -> tuple[str, ...]:
    """Parameters whose priors are still those of `init`, which knows nothing of the spacecraft."""
    every = priors.parameters.items()
    return tuple(name for name, prior in every if prior.source.startswith(PLACEHOLDER))


def _row(event: Event) -> dict[str, object]:
    """What is used of one event."""
    if isinstance(event, TotalsEvent):
        return {
            "event": event.id,
            "kind": f"totals ({event.source})",
            "rows_read": 1,
            "rows_used": 1,
            "duration_s": event.duration_s,
            "on_time_s": float(event.on_time_s.sum()),
            "mended": "",
        }
    reading = event.reading
    return {
        "event": event.id,
        "kind": event.kind,
        "rows_read": reading.rows,
        "rows_used": event.statistics.rows,
        "duration_s": reading.end_s - reading.start_s,
        "on_time_s": float(sum(reading.on_time_s)),
        "mended": "; ".join(reading.mends),
    }


def _disagreement(model: Model, seen: Observability, mode: Any) -> pd.DataFrame:
    """Prior against mode of every walked parameter that the linearisation judges."""
    ratio = dict(zip(seen.table["quantity"], seen.table["ratio"], strict=True))
    places = [i for i, name in enumerate(model.space.names) if name in ratio]
    names = [model.space.names[i] for i in places]
    width = np.array([ratio[name] for name in names])
    judged = conflicts(names, mode[places], width)
    at_mode, centre = model.space.to_parameters(mode), model.space.centre()
    walked = judged.assign(
        unit=[model.specs[name].unit for name in names],
        prior=[float(centre[name]) for name in names],
        mode=[float(at_mode[name]) for name in names],
    )
    return pd.concat([walked, *_thrusts_against_prior(model, mode)], ignore_index=True)


def _thrusts_against_prior(model: Model, mode: Any) -> Iterator[pd.DataFrame]:
    """Prior against mode of the common thrust; where it agrees, of every thruster's level.

    They are collapsed: what the data say of them is exact at the mode. Levels that effects change
    from event to event, or that an earlier fit gave, are not judged.
    """
    prior = model.thrust_prior
    if not model.fires or prior.shared.ndim != 2 or prior.chained is not None:
        return
    thrusts = collapse(model, mode[None]).thrusts
    moved, width = (values[0] for values in level_moments(prior, thrusts))
    names = ["thrust_common_n", *(f"thrust_level_n[{name}]" for name in model.thrusters)]
    sizes = np.sqrt([prior.common_sd_n**2, *np.diagonal(prior.shared @ prior.shared.T)])
    centre = float(thrusts.common_n[0])
    for group in (slice(0, 1), slice(1, None)):
        judged = conflicts(names[group], moved[group], width[group])
        at = centre + sizes[group] * moved[group]
        judged = judged.assign(unit="N", prior=centre, mode=at)
        if (judged["verdict"] == "conflict").any():
            yield judged
            return


def _seconds(model: Model, mode: Any) -> tuple[float, float]:
    """Least and most that sampling with the default settings takes, by timing its density."""
    settings = SamplerSettings()
    walkers = settings.walkers_for(model.space.dimension)
    points = mode + 0.1 * np.random.default_rng(0).standard_normal((walkers, len(mode)))
    log_posterior(model, points)
    began = time.perf_counter()
    log_posterior(model, points)
    step = (time.perf_counter() - began) * settings.ensembles * OVERHEAD
    return TYPICAL_STEPS[0] * step, TYPICAL_STEPS[1] * step
