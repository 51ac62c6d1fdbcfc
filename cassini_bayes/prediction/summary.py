"""A prediction as numbers for a reader or a program: JSON-ready dictionaries and CSV text."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any, Final

import numpy as np

from cassini_bayes.computing.arrays import Array
from cassini_bayes.files.tables import rows_csv
from cassini_bayes.prediction.predict import Prediction
from cassini_bayes.spacecraft.attitude import direction_cosines

INTERVAL: Final = "90 % central"
_QUANTILES: Final = (0.05, 0.5, 0.95)


@dataclass(frozen=True)
class Line:
    """One predicted scalar: moments, median and central 90 % interval in its unit."""

    quantity: str
    unit: str
    mean: float
    sd: float
    median: float
    low_90: float
    high_90: float


def lines(prediction: Prediction) -> tuple[Line, ...]:
    """Every predicted scalar: on-time and pulses per thruster or pair, ΔV, hydrazine, duration."""
    result: list[Line] = []
    names = prediction.unit_names()
    for kind, unit, draws in (
        ("on_time", "s", prediction.unit_on_time_s()),
        ("pulses", "count", prediction.unit_pulses()),
    ):
        result += [_line(f"{kind}_{name}", unit, draws[:, i]) for i, name in enumerate(names)]
    vectors = (
        ("delta_v_computed", prediction.delta_v_computed_m_s),
        ("delta_v_delivered", prediction.delta_v_delivered_m_s),
    )
    for kind, vector in vectors:
        if vector is None:
            continue
        result += _vector(f"{kind}_body", vector)
        if prediction.request.quaternion is not None:
            attitude = np.asarray(prediction.request.quaternion, dtype=np.float64)
            turned = vector @ direction_cosines(attitude[None])[0]  # Cᵀ v of every draw
            result += _vector(f"{kind}_inertial", turned)
    if prediction.hydrazine_g is not None:
        result.append(_line("hydrazine", "g", prediction.hydrazine_g))
    result.append(_line("duration", "s", prediction.duration_s))
    return tuple(result)


def _vector(name: str, draws_m_s: Array) -> list[Line]:
    return [_line(f"{name}_{axis}", "mm/s", 1e3 * draws_m_s[:, i]) for i, axis in enumerate("xyz")]


def _line(quantity: str, unit: str, draws: Array) -> Line:
    low, median, high = (float(value) for value in np.quantile(draws, _QUANTILES))
    return Line(quantity, unit, float(draws.mean()), float(draws.std()), median, low, high)


def as_dictionary(prediction: Prediction) -> dict[str, Any]:
    """A JSON-ready dictionary of one prediction."""
    request = prediction.request
    return {
        "id": request.id,
        "epoch": prediction.epoch.isoformat(),
        "wheels": list(request.wheels),
        "from_rpm": request.start_rpm.tolist(),
        "to_rpm": request.end_rpm.tolist(),
        "interval": INTERVAL,
        "draws": len(prediction.duration_s),
        "predicted": {
            line.quantity: {key: value for key, value in vars(line).items() if key != "quantity"}
            for line in lines(prediction)
        },
    }


def as_csv(predictions: Sequence[Prediction]) -> str:
    """CSV text, one row per bias and scalar; the interval is the central 90 % one."""
    rows: list[Sequence[object]] = [("bias", *(field.name for field in fields(Line)))]
    for prediction in predictions:
        for line in lines(prediction):
            quantity, unit, *values = vars(line).values()
            rows.append([prediction.request.id, quantity, unit, *(f"{v:.6g}" for v in values)])
    return rows_csv(rows)


def as_text(prediction: Prediction) -> str:
    """A table for a terminal: median and central 90 % interval of every scalar."""
    request = prediction.request
    changes = ", ".join(
        f"wheel {n}: {a:g} -> {b:g}"
        for n, a, b in zip(request.wheels, request.start_rpm, request.end_rpm, strict=True)
    )
    rows = [
        f"{line.quantity:<28} {line.median:>9.2f}  [{line.low_90:.2f}, {line.high_90:.2f}]"
        f" {line.unit}"
        for line in lines(prediction)
    ]
    head = f"{request.id} at {prediction.epoch.date()}: {changes} rev/min"
    return "\n".join([head, f"{'quantity':<28} {'median':>9}  central 90 % interval", *rows])
