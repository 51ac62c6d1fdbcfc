"""NetCDF groups are read whole once their size is known, and refused when a part is missing."""

from __future__ import annotations

import gc
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest
import xarray as xr

from cassini_bayes.errors import InputError
from cassini_bayes.files import netcdf
from cassini_bayes.files.netcdf import read_groups, sealed

WHAT = "a fit.nc"


def stored(folder: Path, *, is_sealed: bool = False) -> Path:
    """A file with one group."""
    path = folder / "x.nc"
    data = xr.Dataset({"a": ("draw", np.arange(1000.0))}, attrs={"seed": 3})
    tree = xr.DataTree.from_dict({"/": xr.Dataset(attrs={"title": "x"}), "/posterior": data})
    tree.to_netcdf(path, engine="h5netcdf")
    if is_sealed:
        path.write_bytes(sealed(path.read_bytes()))
    return path


@pytest.mark.parametrize("kind", ["f8", "i4", "bool", "U9"])
def test_what_is_sealed_is_read_as_xarray_reads_it(tmp_path: Path, kind: str) -> None:
    """Values, kinds of numbers, coordinates and attributes; dimensions with and without names."""
    values = (np.arange(6) % 4).astype(kind)
    if kind == "f8":
        values[3] = np.nan
    data = xr.Dataset(
        {
            "a": (("draw", "event"), values.reshape(2, 3), {"units": "s", "long_name": "σ, or so"}),
            "b": ((), values[1], {"empty": "", "number": 2.5, "numbers": [1, 2]}),
        },
        coords={"event": ["one", "two", "three"], "branch": ("event", ["A", "B", "B"])},
        attrs={"seed": 3},
    )
    tree = xr.DataTree.from_dict({"/": xr.Dataset(attrs={"title": "x", "p": 0.5}), "/g": data})
    path = tmp_path / "x.nc"
    tree.to_netcdf(path, engine="h5netcdf")
    (plain, of_plain) = read_groups(path, {"g": ("a",)}, WHAT)
    path.write_bytes(sealed(path.read_bytes()))
    (found, of_found) = read_groups(path, {"g": ("a",)}, WHAT)
    xr.testing.assert_identical(found["g"], plain["g"])
    assert of_found == of_plain
    for name, variable in plain["g"].variables.items():
        own = found["g"].variables[name]
        assert (own.dtype, own.dims) == (variable.dtype, variable.dims)
        types = [{key: type(v) for key, v in each.attrs.items()} for each in (own, variable)]
        assert types[0] == types[1]


def test_groups_come_back(tmp_path: Path) -> None:
    """Values and attributes, of the group and of the root."""
    groups, attributes = read_groups(stored(tmp_path), {"posterior": ("a",)}, WHAT)
    np.testing.assert_array_equal(groups["posterior"]["a"], np.arange(1000.0))
    assert groups["posterior"].attrs["seed"] == 3
    assert attributes["title"] == "x"


@pytest.mark.parametrize("is_sealed", [False, True])
@pytest.mark.parametrize(
    ("needed", "said"),
    [({"prior": ()}, "prior"), ({"posterior": ("a", "b")}, "no b in group posterior")],
)
def test_a_missing_part_is_named(
    tmp_path: Path, needed: dict[str, tuple[str, ...]], said: str, is_sealed: bool
) -> None:
    """A group or a variable that is not there."""
    with pytest.raises(InputError, match=said):
        read_groups(stored(tmp_path, is_sealed=is_sealed), needed, WHAT)


def test_a_group_of_any_size_is_not_loaded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A variable that was never written takes no room in the file; what it declares is refused."""
    import h5netcdf

    path = tmp_path / "sparse.nc"
    with h5netcdf.File(path, "w") as file:
        group = file.create_group("posterior")
        group.dimensions = {"draw": 1 << 40}
        group.create_variable("a", ("draw",), "f8", chunks=(1 << 16,), compression="gzip")
    assert path.stat().st_size < 1 << 20
    with pytest.raises(InputError, match="declares"):
        read_groups(path, {"posterior": ()}, WHAT)
    # negative control: the limit decides
    monkeypatch.setattr(netcdf, "MOST_BYTES", 100)
    for is_sealed in (False, True):
        with pytest.raises(InputError, match="declares 8,000 bytes"):
            read_groups(stored(tmp_path, is_sealed=is_sealed), {"posterior": ()}, WHAT)


def test_a_sealed_file_is_read_and_any_changed_byte_is_found(tmp_path: Path) -> None:
    """NetCDF readers pass over the seal; a flipped bit anywhere before it is refused unread."""
    path = stored(tmp_path)
    content = path.read_bytes()
    path.write_bytes(sealed(content))
    groups, _ = read_groups(path, {"posterior": ("a",)}, WHAT)
    np.testing.assert_array_equal(groups["posterior"]["a"], np.arange(1000.0))
    for at in np.random.default_rng(4).integers(len(content), size=100):
        damaged = bytearray(sealed(content))
        damaged[at] ^= 1
        path.write_bytes(damaged)
        with pytest.raises(InputError, match="damaged after it was written"):
            read_groups(path, {"posterior": ("a",)}, WHAT)


def test_a_damaged_root_prints_nothing_but_its_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A root attribute that cannot be read: refused before xarray's engine has half a file.

    Negative control: the engine alone prints a traceback when that is thrown away.
    """
    path, complaints = stored(tmp_path), []
    monkeypatch.setattr(sys, "unraisablehook", lambda seen: complaints.append(str(seen.exc_value)))

    def damaged(*_: object) -> None:
        raise RuntimeError("wrong fractal heap")

    monkeypatch.setattr(h5py.AttributeManager, "get", damaged)
    with pytest.raises(InputError, match="wrong fractal heap"):
        read_groups(path, {"posterior": ("a",)}, WHAT)
    gc.collect()
    assert not complaints
    with pytest.raises(RuntimeError):
        xr.open_dataset(path, engine="h5netcdf")
    gc.collect()
    assert complaints


def test_any_damage_of_a_file_without_seal_is_one_line(tmp_path: Path) -> None:
    """Two bytes changed, forty times over: read or refused, nothing printed."""
    path = stored(tmp_path)
    good, rng = path.read_bytes(), np.random.default_rng(6)
    refused = 0
    for _ in range(40):
        damaged = bytearray(good)
        for at in rng.integers(len(good), size=2):
            damaged[at] ^= int(rng.integers(1, 256))
        path.write_bytes(damaged)
        try:
            read_groups(path, {"posterior": ("a",)}, WHAT)
        except InputError:
            refused += 1
    assert refused > 0
