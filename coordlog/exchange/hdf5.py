"""HDF5 files of an export: groups written block by block, then gathered in one file.

Without time stamps in the file, so that the same episodes give the same bytes.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from coordlog.episode import Array, Json


@contextmanager
def created(path: Path) -> Iterator[Any]:
    """A new HDF5 file, replacing what an interrupted export left."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with h5py.File(path, "w", libver=("earliest", "v110"), track_order=True) as file:
        yield file


def part(folder: Path, number: int) -> Path:
    """File of one block."""
    return folder / "parts" / f"{number:05d}.hdf5"


def put(group: Any, columns: Mapping[str, Array]) -> None:
    """Datasets in a group; a `/` in a name makes groups within."""
    for name, values in columns.items():
        group.create_dataset(name, data=np.ascontiguousarray(values), track_times=False)


def describe(group: Any, values: Json) -> None:
    """Attributes of a group: text, numbers, truth values."""
    for name, value in values.items():
        group.attrs[name] = value


def gather(folder: Path, journals: Sequence[Json], whole: Any) -> None:
    """Copy every group of every block into one file, in order, and drop the parts."""
    for journal in journals:
        with h5py.File(part(folder, journal["number"]), "r") as file:
            for name in journal["groups"]:
                file.copy(name, whole, name)
    for journal in journals:
        part(folder, journal["number"]).unlink()
    (folder / "parts").rmdir()
