"""Every reader with a good file to start from: those of the doors, and those that need more."""

from __future__ import annotations

import copy
import io
import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

import h5py
import numpy as np
import scipy.io
import xarray as xr
from event_folder_cases import BIAS, CASSINI, bias_rows
from simulation_cases import BIAS as BIAS_EVENT
from simulation_cases import EPOCH, PARAMETERS
from test_doors import DOORS, PRIORS, Door, good_csv

from cassini_bayes.events.plausibility import check_telemetry, check_totals
from cassini_bayes.events.telemetry import read_chunks, read_event
from cassini_bayes.events.telemetry.matches import matches, sample_of
from cassini_bayes.events.totals import read_totals
from cassini_bayes.files import netcdf
from cassini_bayes.files.checkpoint import CheckpointStore
from cassini_bayes.files.storage import digest
from cassini_bayes.model.nominal import nominal_values
from cassini_bayes.pipeline.fits import read_fit
from cassini_bayes.prediction.sources import read_sources
from cassini_bayes.priors.reader import read_priors
from cassini_bayes.results.record import GROUPS, Fit, save_fit
from cassini_bayes.results.record import read_fit as read_stored_fit
from cassini_bayes.simulation import scenario_of
from cassini_bayes.studies.scenario import simulate_file, write_simulation

OWN_CSV: Final = PRIORS.parents[1] / "docs" / "examples" / "own_csv"
NOMINAL: Final = nominal_values(read_priors(PRIORS))


def _parquet_event(path: Path) -> object:
    (path.parent / "event.toml").write_text(_described())
    event = read_event(path.parent, CASSINI)
    return [chunk.rows for chunk in read_chunks(event, CASSINI)]


def _checked_telemetry(path: Path) -> object:
    (path.parent / "event.toml").write_text(_described())
    event = read_event(path.parent, CASSINI)
    return check_telemetry(event, read_chunks(event, CASSINI), CASSINI, NOMINAL)


def _mapped_event(path: Path) -> object:
    """Telemetry in the columns of others, by a channel map."""
    shutil.copy(OWN_CSV / "channels.toml", path.parent)
    described = {**BIAS, "epoch": "2010-05-01T06:00:00Z", "telemetry": f'"{path.name}"'}
    text = "".join(f"{key} = {value}\n" for key, value in described.items())
    (path.parent / "event.toml").write_text(text)
    event = read_event(path.parent, CASSINI)
    return [chunk.rows for chunk in read_chunks(event, CASSINI)]


def _proposed(path: Path) -> object:
    """What ``init --from`` proposes for the columns of a file."""
    return matches(sample_of(path), CASSINI, (1, 2, 4), "B")


def _checked_totals(path: Path) -> object:
    return check_totals(read_totals(path, CASSINI), CASSINI, NOMINAL, str(path))


def _checkpoint(path: Path) -> object:
    return CheckpointStore(path.parent, "own").load(path.stem)


def _sources(path: Path) -> object:
    """The record of a run with the priors and events that it names."""
    folder = path.parent
    (folder / "fit.nc").write_bytes(b"")
    for name, source in _RUN.items():
        shutil.copy(source, folder / name)
    records = {"resolved.toml": _resolved(), "provenance.json": _provenance()}
    for name, content in records.items():
        if name != path.name:
            (folder / name).write_bytes(content)
    return read_sources(folder / "fit.nc").events


def _stored(path: Path) -> object:
    """A stored run with its record, as far as its draws go."""
    folder = path.parent
    _fit(folder)
    for name, source in _RUN.items():
        shutil.copy(source, folder / name)
    (folder / "provenance.json").write_bytes(_provenance())
    return read_fit(folder).figures


def _resolved() -> bytes:
    return (
        b'priors = "p.toml"\nevents = ["e.csv"]\nsource = "flight"\naccept = ["bad-cell"]\n'
        b'[model]\npulse_shape = "first_order"\ndelta_v = "ignore"\neffects = []\n'
    )


def _provenance() -> bytes:
    return json.dumps({"sha256": {name: digest(path) for name, path in _RUN.items()}}).encode()


_RUN: Final = {"p.toml": PRIORS, "e.csv": Path(str(DOORS["totals"].good))}


def _simulated(folder: Path) -> bytes:
    """A short honest bias, as a file: most changes of a number leave it readable."""
    document = copy.deepcopy(dict(_BIAS))
    write_simulation(simulate_file(scenario_of(document), 5), folder)
    return (folder / "bias" / "telemetry.csv").read_bytes()


_BIAS: Final = {
    "spacecraft": {"name": "cassini", "branch": "B", "wheels": [1, 2, 4]},
    "truth": {**PARAMETERS, "thrust_common_n": 0.75, "fsw_impulse_offset_s": 0.01},
    "event": [{**BIAS_EVENT, "to_rpm": (-1000.0, 1200.0, 400.0), "epoch": EPOCH, "settle_s": 5.0}],
    "telemetry": {"rate_noise_rad_s": 2e-6, "wheel_noise_rpm": 0.2, "attitude_noise_rad": 2e-5},
}


def _described() -> str:
    return "".join(f"{key} = {value}\n" for key, value in BIAS.items())


MORE: Final = {
    "parquet": Door("telemetry.parquet", None, _parquet_event),
    "checked telemetry": Door("telemetry.csv", None, _checked_telemetry),
    "checked totals": Door("my.csv", DOORS["totals"].good, _checked_totals),
    "checkpoint": Door("block.npz", None, _checkpoint),
    "fit without seal": Door("my.nc", None, read_stored_fit),
    "mapped telemetry": Door("may.csv", None, _mapped_event),
    "foreign columns": Door("my.csv", DOORS["totals"].good, _proposed),
    "resolved": Door("resolved.toml", None, _sources),
    "stored run": Door("resolved.toml", None, _stored),
    "provenance": Door("provenance.json", None, _sources),
}
"""Beside the doors of the command line: what they lead to, and files of the package's own."""
READERS: Final = {**DOORS, **MORE}


@dataclass(frozen=True)
class Good:
    """A good file of a reader."""

    reader: str
    door: Door
    content: bytes


def good_files() -> dict[str, Good]:
    """A good file of every reader."""
    with TemporaryDirectory() as folder:
        return {
            name: Good(name, door, _content(name, door, Path(folder) / str(place)))
            for place, (name, door) in enumerate(READERS.items())
        }


def _content(name: str, door: Door, folder: Path) -> bytes:
    folder.mkdir()
    make: dict[str, Callable[[Path], bytes]] = {
        "event": lambda _: _described().encode(),
        "resolved": lambda _: _resolved(),
        "stored run": lambda _: _resolved(),
        "provenance": lambda _: _provenance(),
        "checked telemetry": _simulated,
        "fit": _fit,
        "fit without seal": lambda own: _fit(own).partition(netcdf._SEAL)[0],
        "mapped telemetry": lambda _: b"\n".join(_recording()),
        "parquet": _parquet,
        "HDF5": _hdf5,
        "MATLAB": _matlab,
        "checkpoint": _block,
    }
    if name in make:
        return make[name](folder)
    if door.suffix == ".csv":
        return good_csv(door, folder)
    assert door.good is not None, f"reader {name!r} has no good file: name one in readers.py"
    root = str(PRIORS.parent)
    return door.good.read_text().replace("../../priors", root).encode()


def _fit(folder: Path) -> bytes:
    draws = xr.Dataset({"x": (("chain", "draw"), np.zeros((2, 4)))})
    save_fit(Fit(dict.fromkeys(GROUPS, draws), {"seed": 1}), folder / "fit.nc")
    return (folder / "fit.nc").read_bytes()


def _parquet(folder: Path) -> bytes:
    import pyarrow as arrow
    import pyarrow.parquet as parquet

    rows = bias_rows()
    table = arrow.table({name: [float(row[name]) for row in rows] for name in rows[0]})
    stream = io.BytesIO()
    parquet.write_table(table, stream)
    return stream.getvalue()


def _hdf5(folder: Path) -> bytes:
    path = folder / "my.h5"
    with h5py.File(path, "w") as file:
        file.create_dataset("group/x", data=np.arange(500.0), compression="gzip")
    return path.read_bytes()


def _recording() -> list[bytes]:
    """The first rows of the example's recording."""
    return (OWN_CSV / "may.csv").read_bytes().splitlines()[:100]


def _matlab(folder: Path) -> bytes:
    path = folder / "my.mat"
    scipy.io.savemat(path, {"group": {"x": np.arange(500.0)}}, do_compression=True)
    return path.read_bytes()


def _block(folder: Path) -> bytes:
    CheckpointStore(folder, "own").save("block", {"x": np.arange(12.0)})
    return (folder / "block.npz").read_bytes()
