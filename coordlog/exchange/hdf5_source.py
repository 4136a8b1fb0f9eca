"""robomimic and Minari data sets in HDF5, in: the samples of one data set per episode.

HDF5 can point out of the file, at other files and at objects by reference: such a file is refused.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from coordlog.errors import ConfigError, FormatError
from coordlog.exchange.motion import NS, Motion

ROBOMIMIC_KEYS = ("obs/robot0_joint_pos", "obs/joint_positions", "obs/qpos")
MINARI_KEYS = ("infos/qpos", "observations")


def motions(
    path: Path, *, state: str = "", rate: float = 0.0, names: tuple[str, ...] = ()
) -> Iterator[Motion]:
    """Every episode of a robomimic or Minari file.

    Args:
        path: The HDF5 file, or a Minari data set's folder.
        state: Data set of each episode with the joint positions, such as `obs/joint_pos`.
        rate: Samples a second; 0 for what the file says, if it does.
        names: Of the joints, in the order of the columns; () for numbered ones.

    Raises:
        FormatError: if the file is damaged, of another layout, or points outside itself.
        ConfigError: if rate or data set must be named and are not.
    """
    file_path = _minari_file(path) if path.is_dir() else path
    try:
        with h5py.File(file_path, "r") as file:
            require_contained(file, file_path)
            robomimic = "data" in file
            group = file["data"] if robomimic else file
            prefix = "demo_" if robomimic else "episode_"
            episodes = sorted(
                (name for name in group if name.removeprefix(prefix).isdecimal()),
                key=lambda name: int(name.removeprefix(prefix)),
            )
            if not episodes:
                raise FormatError(
                    f"{file_path}: expected robomimic's data/demo_i or Minari's episode_i, got "
                    f"{', '.join(list(file)[:8]) or 'nothing'}"
                )
            hertz = rate or _rate(group)
            if not hertz:
                raise ConfigError(
                    f"{file_path}: the file does not say how many samples a second; name it with "
                    "--rate"
                )
            kind = "robomimic" if robomimic else "minari"
            keys = ROBOMIMIC_KEYS if robomimic else MINARI_KEYS
            for name in episodes:
                yield _motion(path, kind, name, group[name], state, keys, hertz, names)
    except (OSError, ValueError, KeyError, RuntimeError, MemoryError) as error:
        raise FormatError(f"{file_path}: not an HDF5 file that can be read: {error}") from error


def _minari_file(path: Path) -> Path:
    """The HDF5 file of a Minari set, which may also be in Arrow or Parquet."""
    file = path / "data" / "metadata.json"
    try:
        about = json.loads(file.read_text("utf-8-sig"))
    except (OSError, ValueError, RecursionError) as error:
        raise FormatError(f"{file}: expected JSON, got: {error}") from error
    kind = about.get("data_format", "hdf5") if isinstance(about, dict) else "hdf5"
    if kind != "hdf5":
        raise FormatError(
            f"{path}: expected a Minari set in hdf5, got {kind}; "
            'make it again with data_format="hdf5"'
        )
    return path / "data" / "main_data.hdf5"


def require_contained(group: Any, path: Path, seen: frozenset[int] = frozenset()) -> None:
    """Refuse a file that points outside itself, at objects by reference, or around in a circle.

    Raises:
        FormatError: naming the first such place.
    """
    for name in group:
        where = f"{group.name.rstrip('/')}/{name}"
        link = group.get(name, getlink=True)
        if isinstance(link, h5py.ExternalLink | h5py.SoftLink):
            raise FormatError(
                f"{path}: {where}: a link to another place; copy its data into the file first"
            )
        item = group[name]
        if isinstance(item, h5py.Group):
            address = h5py.h5o.get_info(item.id).addr
            if address in seen:
                raise FormatError(f"{path}: {where}: a group within itself")
            require_contained(item, path, seen | {address})
        elif isinstance(item, h5py.Dataset):
            if item.is_virtual or item.external:
                raise FormatError(f"{path}: {where}: its data lies in other files; copy it first")
            if _refers(item.dtype):
                raise FormatError(f"{path}: {where}: object references are not followed")


def _refers(kind: np.dtype[Any]) -> bool:
    """Whether entries of this type are, or have within them, references to objects."""
    if kind.names:
        return any(_refers(kind[name]) for name in kind.names)
    inner = h5py.check_vlen_dtype(kind)
    if isinstance(inner, np.dtype):
        return _refers(inner)
    return h5py.check_ref_dtype(kind) is not None


def _motion(
    path: Path,
    kind: str,
    name: str,
    episode: Any,
    state: str,
    keys: tuple[str, ...],
    rate: float,
    names: tuple[str, ...],
) -> Motion:
    if not isinstance(episode, h5py.Group):
        raise FormatError(f"{path}: {name}: expected a group of data sets, got {episode.dtype}")
    key = state or next((each for each in keys if isinstance(episode.get(each), h5py.Dataset)), "")
    item = episode.get(key) if key else None
    if not isinstance(item, h5py.Dataset) or item.ndim != 2 or item.dtype.kind != "f":
        had = ", ".join(_matrices(episode))
        raise ConfigError(
            f"{path}: {name}: expected joint positions in '{key or keys[0]}'; choose one with "
            f"--state: {had or 'there is none'}"
        )
    position = np.asarray(item[()], np.float64)
    notes: tuple[str, ...] = (f"stamps are the row number over {rate:g} Hz",)
    if key.startswith("obs/") and (after := episode.get("next_" + key)) is not None and len(after):
        position = np.concatenate([position, np.asarray(after[-1:], np.float64)])
        notes += ("the last state is the last row of next_obs",)
    width = position.shape[1]
    if names and len(names) != width:
        raise ConfigError(f"--names: expected {width} names for {key}, got {len(names)}")
    last = key.rsplit("/", 1)[-1]
    return Motion(
        path,
        kind,
        name,
        names or tuple(f"{last}_{i}" for i in range(width)),
        np.rint(np.arange(len(position)) / rate * NS).astype(np.int64),
        position,
        clock="row number over rate",
        where={"episode": name, "state": key},
        notes=notes,
    )


def _matrices(episode: Any) -> list[str]:
    found: list[str] = []

    def visit(name: str, item: Any) -> None:
        if isinstance(item, h5py.Dataset) and item.ndim == 2 and item.dtype.kind == "f":
            found.append(name)

    episode.visititems(visit)
    return found


def _rate(group: Any) -> float:
    """Control frequency that robosuite writes into robomimic's env_args."""
    try:
        args = json.loads(group.attrs["env_args"])
        rate = float(args["env_kwargs"]["control_freq"])
        return rate if 0 < rate < math.inf else 0.0
    except (KeyError, TypeError, ValueError):
        return 0.0
