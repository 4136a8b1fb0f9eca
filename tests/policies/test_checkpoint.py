from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from coordlog.errors import FormatError, StorageError
from coordlog.policies.checkpoint import (
    generator_from_json,
    generator_to_json,
    load_arrays,
    save_arrays,
)


def test_arrays_and_words_come_back_bit_for_bit(tmp_path: Path, rng: np.random.Generator) -> None:
    arrays = {
        "wide": rng.normal(size=(3, 4)).astype(np.float32),
        "turned": rng.normal(size=(3, 4)).T,
        "flags": rng.random(5) < 0.5,
        "number": np.array(7),
        "nothing": np.zeros((0, 2), np.int32),
        "nan": np.array([np.nan, -0.0]),
    }
    path = tmp_path / "new" / "file.safetensors"
    save_arrays(path, arrays, kind="test", meta={"word": "é", "list": [1, 2.5, None]})
    found, meta = load_arrays(path, kind="test")
    assert meta == {"word": "é", "list": [1, 2.5, None]}
    assert set(found) == set(arrays)
    for name, array in arrays.items():
        assert (found[name].shape, found[name].dtype, found[name].tobytes()) == (
            array.shape,
            array.dtype,
            array.tobytes(),
        )
    assert [item.name for item in path.parent.iterdir()] == ["file.safetensors"]


def test_the_same_arrays_have_the_same_bytes(tmp_path: Path) -> None:
    """The library alone wrote its words in an order of chance."""
    arrays, path = {"ß": np.arange(3.0), "a": np.zeros(2, np.uint8)}, tmp_path / "x.safetensors"
    found = set()
    for _ in range(20):
        save_arrays(path, arrays, kind="policy", meta={"µ": 'a "b"\n', "x": [1, 2.5]})
        found.add(path.read_bytes())
    assert len(found) == 1
    assert load_arrays(path, kind="policy").meta["µ"] == 'a "b"\n'


def test_a_write_that_fails_leaves_the_old_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "file.safetensors"
    save_arrays(path, {"a": np.ones(3)}, kind="test", meta={})

    def full(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(StorageError, match=r"cannot be written: .*No space left"):
        save_arrays(path, {"a": np.zeros(3)}, kind="test", meta={})
    assert load_arrays(path, kind="test").arrays["a"].tolist() == [1, 1, 1]
    assert len(list(tmp_path.iterdir())) == 1


def test_a_foreign_or_damaged_file_is_named(tmp_path: Path) -> None:
    path = tmp_path / "file.safetensors"
    with pytest.raises(StorageError, match="cannot be read"):
        load_arrays(path, kind="test")
    save_arrays(path, {"a": np.ones(300)}, kind="test", meta={})
    with pytest.raises(FormatError, match="expected a policy file, got test"):
        load_arrays(path, kind="policy")
    path.write_bytes(path.read_bytes()[:100])
    with pytest.raises(FormatError, match="damaged"):
        load_arrays(path, kind="test")


def test_a_generator_continues_where_it_was_saved() -> None:
    rng = np.random.default_rng(3)
    rng.standard_normal(5, dtype=np.float32)
    other = generator_from_json(generator_to_json(rng))
    np.testing.assert_array_equal(rng.standard_normal(9), other.standard_normal(9))
    np.testing.assert_array_equal(rng.integers(100, size=9), other.integers(100, size=9))
