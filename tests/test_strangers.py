"""Tests for strangers.py: files of other programs are known for what they are."""

from __future__ import annotations

import gzip
import io
import sqlite3
import zipfile
from pathlib import Path

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet
import pytest
import zstandard
from safetensors.numpy import save

from coordlog.errors import FormatError
from coordlog.record.reader import read_episode, read_header
from coordlog.strangers import recognise


def _zip(*names: str) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for name in names:
            archive.writestr(name, b"x" * 100)
    return stream.getvalue()


def _npz() -> bytes:
    stream = io.BytesIO()
    np.savez(stream, q=np.zeros((3, 2)))
    return stream.getvalue()


def _parquet() -> bytes:
    stream = io.BytesIO()
    pa.parquet.write_table(pa.table({"q": [1.0, 2.0]}), stream)
    return stream.getvalue()


LFS = b"version https://git-lfs.github.com/spec/v1\noid sha256:" + b"0" * 64 + b"\nsize 22000\n"
STRANGERS = {
    "bag": (b"#ROSBAG V2.0\nE\0\0\0", "ROS 1 bag.*coordlog import"),
    "parquet": (_parquet(), "Parquet.*coordlog import"),
    "gzip": (gzip.compress(b"x"), "gunzip"),
    "zstd": (zstandard.compress(b"x"), "zstd -d"),
    "sb3": (_zip("data", "policy.pth", "_stable_baselines3_version"), "stable-baselines3"),
    "npz": (_npz(), r"NumPy archive.*coordlog\.smooth"),
    "torch": (_zip("archive/data.pkl", "archive/version"), "pickle"),
    "zip": (_zip("a.mcap"), "unzip"),
    "lfs": (LFS, "git lfs pull"),
    "html": (b"\n<!DOCTYPE html><html><body>Not found</body></html>", "web page"),
    "csv": (b"time,q0,q1\n0.0,1.0,2.0\n0.1,1.1,2.1\n", "CSV table.*coordlog import"),
    "safetensors": (save({"a": np.zeros(3, np.float32)}), "safetensors"),
    "zeros": (bytes(5000), "zeros.*did not finish"),
    "json": (b'{"a": 1}\n', "JSON"),
    "xml": (b'<?xml version="1.0"?><robot name="r"/>', "XML"),
    "text": (b"hello\nthere\n", "a text"),
    "npy": (b"\x93NUMPY\x01\x00v\x00", "NumPy array"),
    "tar": (b"a.mcap".ljust(257, b"\0") + b"ustar\x0000", "tar archive"),
    "mp4": (b"\0\0\0\x18ftypmp42", "video"),
}


@pytest.mark.parametrize("kind", STRANGERS)
def test_a_stranger_is_recognised_and_told_what_takes_it(kind: str, tmp_path: Path) -> None:
    content, said = STRANGERS[kind]
    path = tmp_path / "a.mcap"
    path.write_bytes(content)
    for read in (read_episode, read_header):
        with pytest.raises(FormatError, match=rf"a\.mcap: not an MCAP file.*{said}"):
            read(path)


def test_files_that_libraries_write_are_recognised(tmp_path: Path) -> None:
    with sqlite3.connect(tmp_path / "a.db3") as database:
        database.execute("create table topics (id integer)")
    database.close()
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["q"] = np.zeros(3)
    assert "rosbag2" in recognise((tmp_path / "a.db3").read_bytes())
    assert "HDF5" in recognise((tmp_path / "a.h5").read_bytes())


def test_no_bytes_are_an_error(rng: np.random.Generator) -> None:
    for size in (0, 1, 7, 9, 200, 5000):
        for _ in range(50):
            assert isinstance(recognise(rng.bytes(size)), str)
