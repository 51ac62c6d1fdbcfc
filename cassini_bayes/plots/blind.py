"""Figures of the blind campaign: power against size, reliability, p-values, confusion."""

from __future__ import annotations

from itertools import pairwise

import matplotlib
import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from cassini_bayes.plots.style import INK, POSTERIOR, STYLE

EDGES = (0.0, 1.0, 2.0, 3.0, 5.0, 7.5, 10.0, 20.0, 50.0, np.inf)

TICKS = (0, 1, 2, 3, 5, 10, 30, 100)


def blind_figure(trials: pd.DataFrame, reliability: pd.DataFrame) -> Figure:
    """Power against size in σ, reliability of stated probabilities, p-values on null events."""
    with matplotlib.rc_context(dict(STYLE)):
        figure = Figure(figsize=(10.0, 3.4), layout="constrained")
        power, stated, null = figure.subplots(1, 3)
        single = trials[(trials["sigma"] != "") & ~trials["sigma"].str.contains(r"\+|nan")]
        sigma = single["sigma"].astype(float).to_numpy()
        named = single["named"].to_numpy(dtype=bool)
        places, shares, counts = [], [], []
        for low, high in pairwise(EDGES):
            inside = (sigma >= low) & (sigma < high)
            if inside.any():
                places.append(float(np.median(sigma[inside])))
                shares.append(float(named[inside].mean()))
                counts.append(int(inside.sum()))
        power.plot(places, shares, "o-", color=POSTERIOR)
        for x, y, n in zip(places, shares, counts, strict=True):
            power.annotate(str(n), (x, y), textcoords="offset points", xytext=(4, 5), fontsize=7)
        power.set_xscale("symlog", linthresh=1.0)
        power.set_xticks(TICKS, [f"{tick:g}" for tick in TICKS])
        power.set_xlim(0.0, max(12.0, 1.3 * max(places, default=0.0)))
        power.set_xlabel("size (σ of the data)")
        power.set_ylabel("named first, group counts (fraction)")
        power.set_ylim(-0.03, 1.08)
        power.set_title("power (number of trials)", loc="left")
        stated.plot([0, 1], [0, 1], lw=0.8, color=INK)
        if len(reliability):
            value = reliability["right"].to_numpy()
            error = np.abs(
                np.stack([value - reliability["low_95"], reliability["high_95"] - value])
            )
            stated.errorbar(
                reliability["mean_stated"], value, yerr=error, fmt="o", color=POSTERIOR, capsize=3
            )
        stated.set_xlabel("stated probability of the first cause (1)")
        stated.set_ylabel("how often it was right (fraction)")
        stated.set_title("reliability, 95 % binomial bars", loc="left")
        values = np.sort(trials.loc[trials["hidden"] == "none", "p_value"].to_numpy(dtype=float))
        if len(values):
            null.step(values, np.arange(1, len(values) + 1) / len(values), color=POSTERIOR)
        null.plot([0, 1], [0, 1], lw=0.8, color=INK)
        null.set_xlabel("p-value of the baseline (1)")
        null.set_ylabel("share of null trials below (fraction)")
        null.set_title(f"p-values, {len(values)} null trials", loc="left")
    return figure


def confusion_figure(matrix: pd.DataFrame) -> Figure:
    """Hidden kind against the kind named first; numbers are trials."""
    with matplotlib.rc_context(dict(STYLE)):
        figure = Figure(
            figsize=(2.6 + 0.42 * matrix.shape[1], 2.2 + 0.3 * matrix.shape[0]),
            layout="constrained",
        )
        axes = figure.subplots()
        share = matrix.to_numpy() / matrix.to_numpy().sum(1, keepdims=True)
        axes.imshow(share, cmap="Blues", vmin=0.0, vmax=1.0, aspect="auto")
        for i in range(matrix.shape[0]):
            for j in range(matrix.shape[1]):
                count = int(matrix.iloc[i, j])
                if count:
                    colour = "white" if share[i, j] > 0.6 else INK
                    axes.text(j, i, str(count), ha="center", va="center", fontsize=8, color=colour)
        axes.set_xticks(range(matrix.shape[1]), list(matrix.columns), rotation=60, ha="right")
        axes.set_yticks(range(matrix.shape[0]), list(matrix.index))
        axes.set_xlabel("named first (kind)")
        axes.set_ylabel("hidden (kind)")
    return figure
