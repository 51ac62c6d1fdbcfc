"""The figures of a diagnosis: which there are, and what they show in words."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType
from typing import Any, Final

from cassini_bayes.computing.processes import in_processes
from cassini_bayes.diagnosis.balance_case import BalanceDetail
from cassini_bayes.diagnosis.case import Discrepancies
from cassini_bayes.diagnosis.discrepancy import Curve
from cassini_bayes.report.page import Drawing
from cassini_bayes.report.plots import Figure, encode, settle
from cassini_bayes.report.plots.criticism import (
    cause_figure,
    correlation_figure,
    discrepancy_figure,
    innovation_figure,
    whiteness_figure,
)
from cassini_bayes.report.plots.overlays import (
    overlay_figure,
    percent,
    spectrum_figure,
    trade_figure,
)

CAPTIONS: Final[Mapping[str, str]] = MappingProxyType(
    {
        "causes": "Causes, most probable first: posterior probability and evidence.",
        "overlay": "Rates and wheel speeds, measured and modelled. A modelled rate is what the "
        "balance of momentum gives with the measured wheel speeds, a modelled wheel speed what it "
        "gives with the measured rates. Shaded: what the cause adds. Below each: measured less "
        "modelled, running means over 61 rows. Fit as MATLAB's compare has it: "
        "100 (1 − RMS(measured − modelled)/SD(measured)) per cent. It is small, or below zero, "
        "where a channel moves less than the noise of the others makes of it: compare before with "
        "after.",
        "trade": "The size of the cause against the free quantity that it trades with most, priors "
        "in grey; curves hold 50 % and 90 % of a normal of the draws' covariance.",
        "spectrum": "Spectrum of what the baseline leaves. White noise has power one everywhere; "
        "above the dashed line its largest value comes with a chance of one in a hundred.",
        "innovations": "Measured less predicted momentum after fitting, in body axes.",
        "discrepancy": "Discrepancy: torque that the baseline lacks, integrated from the first "
        "row, about body axes, as unknown infers it. Where the band holds zero nothing need be "
        "missing. What thrusts can take up in a bias widens the band.",
        "correlation": "What the innovations go with. Each value is standard normal if the model "
        "is true; a driver that the model can take up itself has no test.",
        "whiteness": "Whiteness: autocorrelation of the innovations, less what fitting makes of "
        "white noise.",
    }
)


@dataclass(frozen=True)
class Drawn:
    """A figure drawn, for its files and the page."""

    name: str
    alt: str
    caption: str
    png: bytes
    svg: bytes

    @property
    def kind(self) -> str:
        """What it is one of several of."""
        return self.name.partition("_")[0]


def _drawing(name: str, alt: str, draw: Callable[[], Figure | None]) -> Drawing:
    """A figure whose caption is that of its kind."""
    return Drawing(name, alt, CAPTIONS[name.partition("_")[0]], draw)


def cause_picture(record: Mapping[str, Any]) -> Drawing:
    """Probability and evidence of the causes of a record."""
    best = record["causes"][0]
    alt = f"Bars of the causes; the most probable is {best['name']} at {best['probability']:.3f}."
    return _drawing("causes", alt, partial(cause_figure, record["causes"]))


def pictures_of(shown: Discrepancies | Sequence[Curve]) -> list[Drawing]:
    """Pictures of what a case shows, or of curves; none where nothing was shown."""
    if not isinstance(shown, Discrepancies):
        alt = "Unexplained momentum against time about X, Y and Z of every event, with 90 % bands."
        return [_drawing("discrepancy", alt, partial(discrepancy_figure, tuple(shown)))]
    return [] if shown.detail is None else _balance_pictures(shown.detail)


def drawn(pictures: Sequence[Drawing], processes: int = 1) -> list[Drawn]:
    """Pictures that show something made, laid out and drawn, shared out among processes."""
    results = in_processes(_drawn, pictures, processes)
    return [image for image in results if image is not None]


def _drawn(picture: Drawing) -> Drawn | None:
    figure = picture.draw()
    if figure is None:
        return None
    settle(figure, solutions=1)
    png, svg = encode(figure, "png"), encode(figure, "svg")
    return Drawn(picture.name, picture.alt, picture.caption, png, svg)


def _balance_pictures(detail: BalanceDetail) -> list[Drawing]:
    has_cause = bool(detail.extended_rows)
    after = detail.after if has_cause else None
    trade = detail.trade
    both = "the baseline and the extended model" if has_cause else "the baseline"
    pictures = [
        _drawing(
            f"overlay_{i}",
            f"{overlay.event}: "
            + "; ".join(_fit_words(c.name, *c.fit) for c in overlay.channels)
            + ".",
            partial(overlay_figure, overlay),
        )
        for i, overlay in enumerate(detail.overlays, start=1)
    ]
    if trade is not None:
        alt = (
            f"{trade.size} of {trade.cause} against {trade.quantity}, correlation "
            f"{trade.correlation:+.2f}, with their priors."
        )
        pictures.append(_drawing("trade", alt, partial(trade_figure, trade)))
    pictures += [
        _drawing(
            "spectrum",
            "; ".join(
                f"{s.event} {s.axis.upper()}: largest power {s.power[s.peak]:.3g} at "
                f"{s.frequency_hz[s.peak]:.3g} Hz"
                for s in detail.spectra
            )
            + ".",
            partial(spectrum_figure, detail.spectra),
        ),
        _drawing(
            "innovations",
            f"Innovations of every event about X, Y and Z with running means of {both}.",
            partial(innovation_figure, detail.rows, detail.extended_rows),
        ),
        *(
            _drawing(
                f"correlation_{i}",
                f"{event.event}: correlation of the innovations of {both} with every driver, in σ.",
                partial(correlation_figure, event.event, detail.before, after),
            )
            for i, event in enumerate(detail.rows, start=1)
        ),
        _drawing(
            "whiteness",
            f"Autocorrelation against lag, per event and axis, of {both}, with 95 % bands.",
            partial(whiteness_figure, detail.before, after),
        ),
    ]
    return pictures


def _fit_words(name: str, before: float, after: float | None) -> str:
    if after is None:
        return f"{name} fits to {percent(before, 1)} %"
    return f"{name} fits to {percent(before, 1)} %, with the cause to {percent(after, 1)} %"
