"""A made-up review of realistic size and shape, for figures and reports. No flight data in it."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, cast

import numpy as np
import pandas as pd
import xarray as xr

from cassini_bayes.computing.arrays import Array
from cassini_bayes.report import figures_of, render_report, sections_of
from cassini_bayes.report.plots import Picture, encoded
from cassini_bayes.results.record import Fit
from cassini_bayes.results.review import Review
from cassini_bayes.results.tables import hdi

if TYPE_CHECKING:
    from cassini_bayes.report.page import Section
    from cassini_bayes.report.plots import Figure


DATES = (
    "2009-08-22", "2009-10-05", "2009-12-13", "2010-02-13",
    "2010-03-03", "2010-03-19", "2010-03-24", "2010-03-29",
)  # fmt: skip
# name, unit, block, meaning, prior mean, prior sd, shift in prior sds, contraction
NUISANCES = (
    ("tau_fall_s", "s", "tail-off", "tail-off time constant", 0.050, 0.012, -0.8, 0.35),
    ("cm_x_m", "m", "centre of mass", "centre of mass along X", 0.13, 0.013, 0.4, 0.55),
    ("cm_y_m", "m", "centre of mass", "centre of mass along Y", -0.06, 0.006, -3.1, 0.40),
    ("cm_z_m", "m", "centre of mass", "centre of mass along Z", 1.35, 0.05, 0.1, 0.02),
    ("thruster_lx_m", "m", "geometry", "thruster corner, X", 1.234, 0.004, 0.0, 0.01),
    ("thruster_ly_m", "m", "geometry", "thruster corner, Y", 1.61, 0.005, 0.2, 0.01),
    ("thruster_lzz_m", "m", "geometry", "height of the Z thrusters", 3.019, 0.01, 0.0, 0.0),
    ("thruster_lzy_m", "m", "geometry", "height of the Y thrusters", 2.88, 0.01, -0.1, 0.0),
    ("rwa1_inertia_kg_m2", "kg m2", "wheel inertia", "spin inertia, wheel 1",
     0.161, 0.0008, 0.1, 0.06),
    ("rwa2_inertia_kg_m2", "kg m2", "wheel inertia", "spin inertia, wheel 2",
     0.161, 0.0008, 0.3, 0.02),
    ("rwa4_inertia_kg_m2", "kg m2", "wheel inertia", "spin inertia, wheel 4",
     0.161, 0.0008, 0.0, 0.01),
    ("rwa4_tilt_u_rad", "rad", "wheel alignment", "tilt of wheel 4, first axis",
     0.0, 0.003, 0.5, 0.10),
    ("rwa4_tilt_v_rad", "rad", "wheel alignment", "tilt of wheel 4, second axis",
     0.0, 0.003, -0.4, 0.30),
    ("inertia_xx_kg_m2", "kg m2", "inertia", "inertia about X", 6560.0, 66.0, 0.0, 0.0),
    ("inertia_yy_kg_m2", "kg m2", "inertia", "inertia about Y", 5500.0, 55.0, 0.0, 0.0),
    ("inertia_zz_kg_m2", "kg m2", "inertia", "inertia about Z", 3600.0, 36.0, 0.0, 0.0),
    ("hold_rate_rad_s", "rad/s", "noise", "body rate left in the dead-band", 4e-5, 2e-5, 0.3, 0.75),
    ("hold_attitude_rad", "rad", "noise", "attitude error in the dead-band",
     1.2e-3, 2e-4, 0.0, 0.0),
    ("mass_factor", "1", "mass", "common factor on the table mass", 1.0, 0.02, 0.2, 0.2),
    ("fsw_acceleration_factor", "1", "flight software", "factor on thrust/mass",
     1.0, 0.02, 0.1, 0.8),
    ("fsw_impulse_offset_s", "s", "flight software", "on-time added per pulse",
     0.01, 0.005, 0.2, 0.9),
    ("delta_v_noise_m_s", "m s-1", "noise", "noise of the computed velocity change",
     1e-4, 5e-5, 0.1, 0.6),
)  # fmt: skip


def made_up_review(
    n_events: int = 8,
    n_thrusters: int = 8,
    draws: int = 400,
    *,
    event_ids: Sequence[str] | None = None,
    baseline: bool = True,
    delta_v: bool = True,
    missing_cells: bool = False,
    seed: int = 20100329,
) -> Review:
    """A review with 4 ensembles of ``draws`` draws each.

    ``missing_cells`` puts NaN into the tables where a real run may have them.
    """
    rng = np.random.default_rng(seed)
    events = list(event_ids) if event_ids else [f"{_date(i)}-bias" for i in range(n_events)]
    pairs = n_thrusters // 2
    thrusters = [f"z{i + 1}" for i in range(pairs)]
    thrusters += [f"y{i + 1}" for i in range(n_thrusters - pairs)]
    on_time = np.round(rng.gamma(0.9, 8.0, (len(events), n_thrusters)) + 0.13, 2)
    pulses = np.maximum(1.0, np.round(on_time / rng.uniform(0.12, 0.18, on_time.shape)))
    posterior = _thrust_datasets(rng, events, thrusters, (4, draws), on_time, posterior=True)
    prior = _thrust_datasets(rng, events, thrusters, (1, 4000), on_time, posterior=False)
    fit = Fit(
        {
            "posterior": posterior,
            "prior": prior,
            "observed_data": xr.Dataset(
                {
                    "on_time_s": (("event", "thruster"), on_time),
                    "pulses": (("event", "thruster"), pulses),
                },
                coords={"event": events, "thruster": thrusters},
            ),
            "constant_data": xr.Dataset(
                {"thrust_predicted_n": ("event", np.linspace(0.77, 0.75, len(events)).round(2))},
                coords={"event": events},
            ),
        },
        {"target_ess": 2000, "seed": seed},
    )
    summary = _summary(rng, fit)
    nuisances = _nuisances(fit)
    review = Review(
        name="made_up",
        model=cast(Any, SimpleNamespace(telemetry=(), effects=())),
        priors=cast(Any, None),
        fit=fit,
        z=np.zeros((0, 0)),
        convergence=pd.DataFrame(
            {
                "name": nuisances["name"],
                "tau_steps": rng.uniform(20, 45, len(nuisances)),
                "rhat": 1.0 + rng.uniform(0, 0.003, len(nuisances)),
                "ess": rng.uniform(2100, 9000, len(nuisances)),
            }
        ),
        facts={
            "Stop rule": "met at step 5200: steps after burn-in > 50 τ, R-hat < 1.01, ESS ≥ 2000",
            "Sampler": "4 independent ensembles of 88 walkers, acceptance 41 %, seed 20100329",
            "Log evidence": "-123.456 ± 0.012 (importance draws, Pareto k̂ 0.31)",
            "Pulse shape": "first_order",
            "Data rows": "made up",
            "Identity": "9f" * 32,
            "Command": "cassini-bayes run runs/made_up.toml",
        },
    )
    # what a run works out of its model is made up here
    vars(review).update(
        warnings=(
            "cm_y_m: the data pull it -3.1 standard deviations from its prior "
            "(-0.06 ± 0.006 → -0.0786 ± 0.0036 m).",
        ),
        summary=summary,
        nuisances=nuisances,
        budget=_budget(rng, summary, events, thrusters),
        baseline=_baseline(rng, events, thrusters, on_time) if baseline else _no_baseline(),
        predictive=_predictive(rng, events, thrusters, on_time),
        balance=_balance(rng, events),
        worth=_worth(events, thrusters),
        delta_v=_delta_v(rng, events) if delta_v else _no_delta_v(),
        variants=_variants(rng, summary) if delta_v else pd.DataFrame(),
        inertia_methods=pd.DataFrame(),
        torque_methods=pd.DataFrame(),
        series=(),
    )
    return _with_missing_cells(review) if missing_cells else review


@functools.cache
def full_review() -> Review:
    """The review of eight events and eight thrusters; shared by tests, never changed."""
    return made_up_review()


@functools.cache
def full_figures() -> dict[str, Figure]:
    """Its figures: some seconds to make, so made once."""
    return figures_of(sections_of(full_review()))


def blank(drawings: Mapping[str, Callable[[], object]], _: int = 1) -> dict[str, Picture]:
    """A file for every figure, without the second that each takes to draw."""
    return {name: Picture({"png": name.encode()}) for name in drawings}


def without_corners(section: Section) -> Section:
    """A section without the corner plots of nuisances, those chosen for the joint one included."""
    slow = ("corner_nuisances", "corner_joint")
    kept = (b for b in section.blocks if not getattr(b, "name", "").startswith(slow))
    return replace(section, blocks=tuple(kept))


def page_of(review: Review, figures: dict[str, Figure]) -> str:
    """Its report, with these figures."""
    pictures = {name: encoded(name, figure) for name, figure in figures.items()}
    return render_report(review, sections_of(review), pictures)


def _date(i: int) -> str:
    return DATES[i] if i < len(DATES) else f"2011-{1 + (i // 28) % 12:02d}-{1 + i % 28:02d}"


def _thrust_datasets(
    rng: np.random.Generator,
    events: list[str],
    thrusters: list[str],
    shape: tuple[int, int],
    on_time: Array,
    *,
    posterior: bool,
) -> xr.Dataset:
    """Thrusts and nuisances; thrust level and tail-off are anticorrelated in the posterior."""
    n = shape[0] * shape[1]
    standard = rng.standard_normal((n, len(NUISANCES)))
    shift = np.array([row[6] for row in NUISANCES]) * posterior
    width = 1.0 - np.array([row[7] for row in NUISANCES]) * posterior
    z = shift + width * standard
    values = {
        name: np.abs(mean + sd * z[:, j])
        if name.startswith(("hold", "tau", "delta"))
        else mean + sd * z[:, j]
        for j, (name, _, _, _, mean, sd, _, _) in enumerate(NUISANCES)
    }
    k, e = len(thrusters), len(events)
    if posterior:
        common = 0.741 + 0.006 * rng.standard_normal(n) - 0.012 * standard[:, 0]
        individual = 0.008 * np.sin(np.arange(k)) + 0.006 * rng.standard_normal((n, k))
        event = np.linspace(0.006, -0.004, e) + 0.004 * rng.standard_normal((n, e))
        weak = 0.004 + 0.010 / (1.0 + on_time / 4.0)
        jitter = weak * rng.standard_normal((n, e, k))
    else:
        common = 0.76 + 0.03 * rng.standard_normal(n)
        individual, event = 0.01 * rng.standard_normal((n, k)), 0.008 * rng.standard_normal((n, e))
        jitter = 0.005 * rng.standard_normal((n, e, k))
    level = common[:, None] + individual
    thrust = level[:, None, :] + event[:, :, None] + jitter
    torque_sd = 1e-6 * (0.9 if posterior else 1.0)
    torque = torque_sd * rng.standard_normal((n, e, 3)) + np.array([-0.5e-6, -2.1e-6, 1.8e-6])
    data: dict[str, tuple[tuple[str, ...], Array, str]] = {
        "thrust_n": (("event", "thruster"), thrust, "N"),
        "thrust_level_n": (("thruster",), level, "N"),
        "thrust_common_n": ((), common, "N"),
        "impulse_per_on_time_n": (
            ("event", "thruster"),
            thrust * (1.0 + values["tau_fall_s"][:, None, None] / 0.4),
            "N",
        ),
        "external_torque_n_m": (("event", "axis"), torque, "N m"),
        "rwa_inertia_kg_m2": (
            ("wheel",),
            np.stack([values[f"rwa{i}_inertia_kg_m2"] for i in (1, 2, 4)], axis=-1),
            "kg m2",
        ),
    }
    for name, unit, *_ in NUISANCES:
        if "_inertia_" not in name:
            data[name] = ((), values[name], unit)
    return xr.Dataset(
        {
            name: (
                ("chain", "draw", *dims),
                array.reshape(*shape, *array.shape[1:]),
                {"units": unit, "long_name": name},
            )
            for name, (dims, array, unit) in data.items()
        },
        coords={
            "event": events,
            "thruster": thrusters,
            "axis": ["x", "y", "z"],
            "wheel": ["rwa1", "rwa2", "rwa4"],
        },
    )


def _flat(dataset: xr.Dataset, name: str) -> Array:
    values = dataset[name].values
    return np.asarray(values.reshape(-1, *values.shape[2:]))


def _summary(rng: np.random.Generator, fit: Fit) -> pd.DataFrame:
    rows = []
    for quantity, variable in fit.posterior.data_vars.items():
        values, before = _flat(fit.posterior, str(quantity)), _flat(fit.prior, str(quantity))
        low, high = hdi(values)
        for place in np.ndindex(values.shape[1:]):
            dims = variable.dims[2:]
            labels = {
                d: str(variable.coords[d].values[i]) for d, i in zip(dims, place, strict=True)
            }
            item = (slice(None), *place)
            rows.append(
                {
                    "name": f"{quantity}[{','.join(labels.values())}]" if labels else quantity,
                    "quantity": quantity,
                    "event": labels.get("event", ""),
                    "item": next((v for d, v in labels.items() if d != "event"), ""),
                    "unit": variable.attrs["units"],
                    "mean": values[item].mean(),
                    "sd": values[item].std(ddof=1),
                    "median": np.median(values[item]),
                    "hdi_90_low": float(low[place]),
                    "hdi_90_high": float(high[place]),
                    "prior_mean": before[item].mean(),
                    "prior_sd": before[item].std(ddof=1),
                    "ess_bulk": rng.uniform(2300, 9000),
                    "ess_tail": rng.uniform(2100, 8000),
                    "rhat": 1.0 + abs(rng.normal(0, 0.001)),
                    "mcse_mean": values[item].std(ddof=1) / 60.0,
                }
            )
    return pd.DataFrame(rows)


def _nuisances(fit: Fit) -> pd.DataFrame:
    rows = []
    for name, unit, block, meaning, mean, sd, shift, contraction in NUISANCES:
        if "rwa" in name and "inertia" in name:
            values = _flat(fit.posterior, "rwa_inertia_kg_m2")[:, ("1", "2", "4").index(name[3])]
        else:
            values = _flat(fit.posterior, name)
        low, high = hdi(values)
        told = contraction > 0.05
        rows.append(
            {
                "name": name,
                "block": block,
                "unit": unit,
                "meaning": meaning,
                "source": "made up, of a realistic size",
                "prior_mean": mean,
                "prior_sd": sd,
                "mean": values.mean(),
                "sd": values.std(ddof=1),
                "hdi_90_low": float(low),
                "hdi_90_high": float(high),
                "contraction": contraction,
                "surprise": shift / np.sqrt(1 - (1 - contraction) ** 2) if told else np.nan,
                "verdict": "conflict"
                if abs(shift) > 3
                else "informed"
                if told
                else "prior returned",
            }
        )
    return pd.DataFrame(rows)


def _budget(
    rng: np.random.Generator, summary: pd.DataFrame, events: list[str], thrusters: list[str]
) -> pd.DataFrame:
    blocks = [
        "tail-off",
        "centre of mass",
        "geometry",
        "wheel inertia",
        "wheel alignment",
        "inertia",
        "noise",
    ]
    n = len(events) * len(thrusters)
    rows = summary[summary["quantity"] == "thrust_n"]
    full = rows["sd"].to_numpy()
    shares = rng.dirichlet([4.0, 2.0, 0.6, 0.8, 0.5, 0.05, 0.4, 5.0, 0.05], n)
    shares[:, 5] *= -1.0  # a block anticorrelated with another
    noise = np.sqrt(shares[:, 7]) * full
    budget = pd.DataFrame(
        {
            "event": np.repeat(events, len(thrusters)),
            "thruster": np.tile(thrusters, len(events)),
            "full_sd_n": full,
            "noise_only_sd_n": noise,
        }
    )
    consider = np.abs(shares[:, :7]) ** 0.5 * full[:, None] * 1.6
    budget["consider_sd_n"] = np.sqrt(noise**2 + (consider**2).sum(1))
    for j, block in enumerate(blocks):
        budget[f"{block}|consider_n"] = consider[:, j]
        budget[f"{block}|share"] = shares[:, j]
    budget["noise-only|share"] = shares[:, 7]
    budget["nonlinear|share"] = 1.0 - shares[:, :8].sum(1)
    return budget


def _baseline(
    rng: np.random.Generator, events: list[str], thrusters: list[str], on_time: Array
) -> pd.DataFrame:
    rows = []
    for e, event in enumerate(events):
        mean = 0.73 + 0.03 * rng.standard_normal()
        for k, thruster in enumerate(thrusters):
            scatter = 1.2 / (1.0 + on_time[e, k])
            rows.append(
                ("pseudo-inverse, per event", event, thruster,
                 0.74 + scatter * rng.standard_normal(),
                 0.035, 0.07, on_time[e, k], on_time[e, k] >= 5.0)
            )  # fmt: skip
            rows.append(
                ("mean of all thrusters, per event", event, thruster, mean, 0.03, 0.06,
                 on_time[e, k], True)
            )  # fmt: skip
    for k, thruster in enumerate(thrusters):
        total = on_time[:, k].sum()
        rows.append(
            ("pseudo-inverse, pooled", "", thruster,
             0.735 + 0.02 * rng.standard_normal(), 0.03, 0.06,
             total, total >= 5.0)
        )  # fmt: skip
    table = pd.DataFrame(rows, columns=[c for c in _no_baseline().columns if c != "note"])
    table["note"] = np.where(table["valid"], "", "on-time below 5 s")
    return table


def _no_baseline() -> pd.DataFrame:
    return pd.DataFrame(
        columns=[
            "method", "event", "thruster", "estimate_n", "bar_rss_n", "bar_worst_n", "on_time_s",
            "valid", "note",
        ]
    )  # fmt: skip


def _predictive(
    rng: np.random.Generator, events: list[str], thrusters: list[str], on_time: Array
) -> pd.DataFrame:
    sd = np.where(rng.random(on_time.shape) < 0.45, rng.uniform(0.1, 0.5, on_time.shape), 0.0)
    mean = on_time + 0.8 * sd * rng.standard_normal(on_time.shape)
    return pd.DataFrame(
        {
            "event": np.repeat(events, len(thrusters)),
            "thruster": np.tile(thrusters, len(events)),
            "measured_s": on_time.ravel(),
            "mean_s": mean.ravel(),
            "sd_s": sd.ravel(),
            "hdi_90_low_s": (mean - 1.645 * sd).ravel(),
            "hdi_90_high_s": (mean + 1.645 * sd).ravel(),
            "tail_probability": np.where(sd > 0, rng.uniform(0.02, 0.5, sd.shape), 0.0).ravel(),
        }
    )


def _balance(rng: np.random.Generator, events: list[str]) -> pd.DataFrame:
    noise = np.tile([0.36, 0.30, 0.20], len(events))
    residual = 0.7 * noise * rng.standard_normal(len(noise))
    return pd.DataFrame(
        {
            "event": np.repeat(events, 3),
            "axis": np.tile(["x", "y", "z"], len(events)),
            "residual_n_m_s": residual,
            "sd_n_m_s": 0.5 * noise,
            "noise_sd_n_m_s": noise,
            "standardised": residual / noise,
        }
    )


def _worth(events: list[str], thrusters: list[str]) -> pd.DataFrame:
    quantities = [*(f"thrust[all events,{name}]" for name in thrusters), "tau_fall_s"]
    return pd.DataFrame(
        {
            "quantity": np.tile(quantities, len(events)),
            "block": "thrust",
            "unit": "N",
            "event": np.repeat(events, len(quantities)),
            "narrowing": 0.02,
        }
    )


def _delta_v(rng: np.random.Generator, events: list[str]) -> pd.DataFrame:
    printed = rng.uniform(1.5, 18.0, len(events)).round(2)
    return pd.DataFrame(
        {
            "event": events,
            "printed_mm_s": printed,
            "computed_mean_mm_s": printed + 0.06 * rng.standard_normal(len(events)),
            "computed_sd_mm_s": rng.uniform(0.02, 0.06, len(events)),
            "noise_sd_mm_s": np.geomspace(0.1, 0.2, len(events)),
        }
    )


def _no_delta_v() -> pd.DataFrame:
    return _delta_v(np.random.default_rng(1), [])


def _variants(rng: np.random.Generator, summary: pd.DataFrame) -> pd.DataFrame:
    rows = summary[summary["quantity"] == "thrust_n"]
    tables = []
    for variant, shift in (
        ("ΔV left out", 0.0),
        ("ΔV as declared (computed)", 0.0),
        ("ΔV as if measured", -0.018),
    ):
        move = shift + 0.0004 * rng.standard_normal(len(rows))
        tables.append(
            pd.DataFrame(
                {
                    "variant": variant,
                    "event": rows["event"].to_numpy(),
                    "thruster": rows["item"].to_numpy(),
                    "mean_n": rows["mean"].to_numpy() + move,
                    "sd_n": rows["sd"].to_numpy() * (0.8 if shift else 1.0),
                    "hdi_90_low_n": rows["hdi_90_low"].to_numpy() + move,
                    "hdi_90_high_n": rows["hdi_90_high"].to_numpy() + move,
                }
            )
        )
    return pd.concat(tables, ignore_index=True)


def _with_missing_cells(review: Review) -> Review:
    """NaN where a thruster gave no estimate, an event no printed thrust."""
    review.baseline.loc[review.baseline.index[::5], "estimate_n"] = np.nan
    review.baseline.loc[review.baseline.index[1::5], "bar_rss_n"] = np.nan
    review.summary.loc[review.summary.index[::7], ["rhat", "ess_bulk", "ess_tail"]] = np.nan
    review.predictive.loc[
        review.predictive.index[::6], ["mean_s", "hdi_90_low_s", "hdi_90_high_s"]
    ] = np.nan
    review.balance.loc[review.balance.index[0], "residual_n_m_s"] = np.nan
    review.budget.loc[review.budget.index[0], "full_sd_n"] = np.nan
    review.fit.groups["constant_data"]["thrust_predicted_n"].values[0] = np.nan
    return review
