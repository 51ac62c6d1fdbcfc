"""Checkpoints come back exactly, belong to one run, and a damaged one costs itself only."""

from __future__ import annotations

import errno
import io
import json
import os
from pathlib import Path

import numpy as np
import pytest

from cassini_bayes.errors import InputError
from cassini_bayes.files.checkpoint import FORMAT, CheckpointStore

ARRAYS = {
    "z": np.random.default_rng(0).normal(size=(2, 5, 3)),
    "key": np.arange(4, dtype=np.uint32),
    "position": np.array(624),
}


def stored(folder: Path) -> CheckpointStore:
    """A store that holds two blocks."""
    store = CheckpointStore(folder / "checkpoint", "identity")
    store.save("block_0000", ARRAYS)
    store.save("block_0001", {"z": ARRAYS["z"] + 1})
    return store


def test_arrays_come_back_bit_for_bit(tmp_path: Path) -> None:
    """Names, types, shapes and every bit."""
    loaded = stored(tmp_path).load("block_0000")
    assert loaded is not None
    assert list(loaded) == list(ARRAYS)
    for name, array in ARRAYS.items():
        assert loaded[name].dtype == array.dtype
        assert loaded[name].shape == array.shape
        assert loaded[name].tobytes() == array.tobytes()


def test_what_was_never_saved_is_none(tmp_path: Path) -> None:
    """No folder, no file: nothing to go on from."""
    assert CheckpointStore(tmp_path / "none", "identity").load("block_0000") is None
    store = stored(tmp_path)
    assert store.load("block_0002") is None


@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.9, 0.999])
def test_a_truncated_block_is_missing_and_costs_itself_only(tmp_path: Path, share: float) -> None:
    """Cut anywhere, the block is None; its neighbour stays, and it can be written again."""
    store = stored(tmp_path)
    path = store.folder / "block_0000.npz"
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    assert store.load("block_0000") is None
    assert store.load("block_0001") is not None
    store.save("block_0000", ARRAYS)
    assert store.load("block_0000") is not None


def test_flipped_bits_are_found(tmp_path: Path) -> None:
    """A damaged array fails the archive's checksum, so it is never sampled on from."""
    store = stored(tmp_path)
    path = store.folder / "block_0000.npz"
    content = bytearray(path.read_bytes())
    place = content.index(ARRAYS["z"].tobytes()[:16])
    content[place + 3] ^= 0x10
    path.write_bytes(bytes(content))
    assert store.load("block_0000") is None


def plain_npy() -> bytes:
    """A good numpy file that is no archive."""
    stream = io.BytesIO()
    np.save(stream, np.arange(3.0))
    return stream.getvalue()


@pytest.mark.parametrize(
    "content", [b"", b"no archive at all", b"PK\x03\x04 and then rubbish", plain_npy()]
)
def test_something_else_under_the_name_is_missing(tmp_path: Path, content: bytes) -> None:
    """A file that is no checkpoint is none."""
    store = stored(tmp_path)
    (store.folder / "block_0000.npz").write_bytes(content)
    assert store.load("block_0000") is None


@pytest.mark.parametrize(
    "header",
    [{"format": FORMAT, "identity": "another"}, {"format": -1, "identity": "identity"}, {}],
)
def test_another_runs_checkpoint_is_refused(tmp_path: Path, header: dict[str, object]) -> None:
    """Other data, settings or format: an error that says how to go on, never silently continued."""
    store = stored(tmp_path)
    raw = np.frombuffer(json.dumps(header).encode(), dtype=np.uint8)
    np.savez(store.folder / "block_0000.npz", header=raw, **ARRAYS)
    with pytest.raises(InputError) as caught:
        store.load("block_0000")
    assert "block_0000.npz" in str(caught.value)
    assert "--force" in caught.value.fix


def test_a_pickle_is_never_opened(tmp_path: Path) -> None:
    """An archive with an object array, which numpy would unpickle, is refused unread."""
    store = stored(tmp_path)

    class Touch:
        def __reduce__(self) -> tuple[object, ...]:
            return Path.touch, (tmp_path / "executed",)

    raw = np.frombuffer(json.dumps({"format": FORMAT, "identity": "identity"}).encode(), np.uint8)
    np.savez(store.folder / "evil.npz", header=raw, z=np.array([Touch()], dtype=object))
    assert store.load("evil") is None
    assert not (tmp_path / "executed").exists()
    # negative control: the archive would have run it
    with np.load(store.folder / "evil.npz", allow_pickle=True) as file:
        file["z"]
    assert (tmp_path / "executed").exists()


def test_objects_cannot_be_saved(tmp_path: Path) -> None:
    """What would need pickle is refused when it is written, and leaves no file."""
    store = stored(tmp_path)
    with pytest.raises(ValueError, match="allow_pickle"):
        store.save("objects", {"z": np.array([{}], dtype=object)})
    assert not list(store.folder.glob("*objects*"))


def test_a_full_disk_keeps_the_old_block(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """ENOSPC in the middle of a block: one line, the old block stays, nothing half-written."""
    store = stored(tmp_path)
    before = (store.folder / "block_0000.npz").read_bytes()

    def half(stream: object, **_: object) -> None:
        stream.write(b"half of a block")  # type: ignore[attr-defined]
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(np, "savez", half)
    for name in ("block_0000", "block_0002"):
        with pytest.raises(InputError, match="No space left") as caught:
            store.save(name, ARRAYS)
        assert name in caught.value.where
    assert (store.folder / "block_0000.npz").read_bytes() == before
    assert sorted(path.name for path in store.folder.iterdir()) == [
        "block_0000.npz",
        "block_0001.npz",
    ]
