"""A network on disk: bit for bit, whole or not at all, and nothing hostile gets in."""

from __future__ import annotations

import os
import pickle
import zipfile
from pathlib import Path

import numpy as np
import pytest

from phyfilter_ctl.learned import Network, _files


@pytest.fixture(scope="module")
def network() -> Network:
    z = np.random.default_rng(0).standard_normal((60, 3))
    return Network((4, 5), max_iterations=20, l2=0.01, seed=7, tolerance=1e-3).fit(z, np.sin(z[:, :2])).model


@pytest.fixture
def path(network: Network, tmp_path: Path) -> Path:
    network.save(tmp_path / "model.npz")
    return tmp_path / "model.npz"


def contents(path: Path) -> dict[str, np.ndarray]:
    with np.load(path, allow_pickle=False) as archive:
        return dict(archive)


def rewrite(path: Path, **changes: np.ndarray | None) -> None:
    arrays = contents(path) | changes
    with open(path, "wb") as file:
        np.savez(file, allow_pickle=True, **{name: a for name, a in arrays.items() if a is not None})


def test_round_trip_bit_for_bit(network: Network, path: Path) -> None:
    loaded = Network.load(path)
    z = np.random.default_rng(1).standard_normal((40, 3))
    assert loaded.parameters.tobytes() == network.parameters.tobytes()
    assert loaded.predict(z).tobytes() == network.predict(z).tobytes()
    for name in ("hidden", "solver", "l2", "max_iterations", "tolerance", "seed"):
        assert getattr(loaded, name) == getattr(network, name)
        assert type(getattr(loaded, name)) is type(getattr(network, name))
    loaded.save(path.with_name("again"))  # no suffix is added
    assert path.with_name("again").read_bytes() == path.read_bytes()
    assert sorted(os.listdir(path.parent)) == ["again", "model.npz"]


def test_a_failed_save_leaves_the_old_file(
    network: Network, path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = path.read_bytes()

    def full_disk(*_: object) -> None:
        raise OSError("No space left on device")

    monkeypatch.setattr(os, "fsync", full_disk)
    with pytest.raises(OSError, match="No space left"):
        network.with_parameters(2.0 * network.parameters).save(path)
    assert path.read_bytes() == before
    assert os.listdir(path.parent) == ["model.npz"]


def test_a_network_without_weights_is_not_saved(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="no weights yet"):
        Network().save(tmp_path / "model.npz")
    assert os.listdir(tmp_path) == []


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        Network.load(tmp_path / "none.npz")


def test_every_truncation_is_refused(path: Path) -> None:
    whole = path.read_bytes()
    for size in [*range(0, 200, 20), *range(200, len(whole), 97), len(whole) - 1]:
        path.write_bytes(whole[:size])
        with pytest.raises(ValueError, match=r"model\.npz"):
            Network.load(path)


def test_flipped_bytes_are_refused_or_harmless(network: Network, path: Path) -> None:
    whole = bytearray(path.read_bytes())
    rng = np.random.default_rng(0)
    refused = 0
    for position in rng.choice(len(whole), 300, replace=False):
        spoiled = whole.copy()
        spoiled[position] ^= int(rng.integers(1, 256))
        path.write_bytes(spoiled)
        try:
            loaded = Network.load(path)
        except ValueError:
            refused += 1
        else:  # time stamps and the like carry nothing
            assert np.array_equal(loaded.parameters, network.parameters)
    assert refused > 150


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"version": np.array(2)}, "expected version 1, got 2; it was written by another version"),
        ({"version": np.array([1, 1])}, r"expected version 1, got \[1, 1\]"),
        ({"version": None}, "the entry 'version' is missing"),
        ({"format": np.array("something")}, "expected format 'phyfilter-learned-model', got 'something'"),
        ({"kind": np.array("koopman")}, "expected kind 'network', got 'koopman'"),
        ({"biases_1": None}, "expected the entries"),
        ({"extra": np.zeros(1)}, "expected the entries"),
        ({"weights_0": np.zeros((3, 9))}, "layer 0: weights of shape"),
        ({"weights_0": np.full((3, 4), np.nan)}, r"weights\[0\]: expected finite numbers"),
        ({"weights_0": np.zeros((3, 4), np.float32)}, "weights_0: expected float64, got float32"),
        ({"z_scale": np.zeros(3)}, "z_scale: expected numbers > 0"),
        ({"z_mean": np.zeros((3, 1))}, "do not fit together"),
        ({"solver": np.array("sgd")}, "solver: expected one of"),
        ({"seed": np.array(0.5)}, "seed: expected a whole number"),
        ({"l2": np.zeros(2)}, "damaged"),
    ],
)
def test_altered_entries_are_refused(path: Path, changes: dict[str, np.ndarray | None], words: str) -> None:
    rewrite(path, **changes)
    with pytest.raises(ValueError, match=words):
        Network.load(path)


class Bomb:
    """Sets a flag when it is unpickled."""

    ran = False

    def __reduce__(self) -> tuple[object, tuple[object, ...]]:
        return setattr, (Bomb, "ran", True)


def test_pickles_are_not_run(path: Path) -> None:
    bomb = np.empty((), dtype=object)
    bomb[()] = Bomb()
    rewrite(path, weights_0=bomb)
    with pytest.raises(ValueError, match="dtype object, which is not numbers or text"):
        Network.load(path)
    path.write_bytes(pickle.dumps(Bomb()))
    with pytest.raises(ValueError, match="damaged or not a learned model"):
        Network.load(path)
    assert not Bomb.ran
    with pytest.raises(TypeError, match="dtype object"):
        _files.write(path, "network", {"a": bomb})


def archive(path: Path, name: str, data: bytes, compression: int = zipfile.ZIP_STORED) -> None:
    with zipfile.ZipFile(path, "w", compression) as file:
        file.writestr(name, data)


def header(text: str) -> bytes:
    padded = text.ljust(117) + "\n"
    return b"\x93NUMPY\x01\x00" + len(padded).to_bytes(2, "little") + padded.encode("latin1")


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (
            header("{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000,), }"),
            "declares the shape",
        ),
        (
            header("{'descr': '<f8', 'fortran_order': False, 'shape': (-1,), }"),
            "declares the shape|not an array",
        ),
        (header("{'descr': '|O', 'fortran_order': False, 'shape': (1,), }"), "dtype object"),
        (header("{'descr': '<f8', 'fortran_order': False, 'shape': ((("), "not an array|damaged"),
        (header("__import__('os').system('true')"), "not an array"),
        (b"\x93NUMPY\x02\x00" + bytes(20), "array format"),
        (b"hello", "not an array"),
        (b"", "not an array"),
    ],
)
def test_hostile_arrays_are_refused(tmp_path: Path, data: bytes, words: str) -> None:
    archive(tmp_path / "m.npz", "weights_0.npy", data)
    with pytest.raises(ValueError, match=words):
        Network.load(tmp_path / "m.npz")


def test_hostile_archives_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "m.npz"
    archive(path, "weights_0.npy", bytes(10_000_000), zipfile.ZIP_DEFLATED)
    with pytest.raises(ValueError, match="compressed or encrypted"):
        Network.load(path)
    with zipfile.ZipFile(path, "w") as file:
        file.writestr("a.npy", b"1")
        with pytest.warns(UserWarning, match="Duplicate name"):
            file.writestr("a.npy", b"2")
    with pytest.raises(ValueError, match="an entry occurs twice"):
        Network.load(path)
    archive(path, "a.npy", b"12345678")
    spoiled = bytearray(path.read_bytes())
    place = spoiled.index(b"PK\x01\x02")
    spoiled[place + 20 : place + 28] = (2**31).to_bytes(4, "little") * 2
    path.write_bytes(spoiled)
    with pytest.raises(ValueError, match="declare more bytes"):
        Network.load(path)
