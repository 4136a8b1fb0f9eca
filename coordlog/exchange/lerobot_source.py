"""LeRobot data sets in, v3.0 and v2.1: joint positions and actions of every episode.

Only files below the folder are read; nothing is ever fetched. Videos are named, not decoded. An
episode's samples are its rows; a row says no more after the last one, so that the last row's action
has no outcome and is kept in the lineage alone.

Source: lerobot 0.6.1, datasets/.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa

from coordlog.episode import Array, Json
from coordlog.errors import ConfigError, FormatError
from coordlog.exchange.motion import NS, Motion
from coordlog.exchange.parquet_source import matrix, numbers, read_columns

VERSIONS = ("v3.0", "v2.1", "v2.0")
STATE, ACTION = "observation.state", "action"
TOLERANCE = 1e-4
"""Largest difference between a row's time stamp and its number over fps [s], as LeRobot's own."""


class Rows(NamedTuple):
    """Where the rows of an episode are."""

    episode: int
    length: int
    file: Path
    task: str


def motions(path: Path, *, state: str = "", action: str = "") -> Iterator[Motion]:
    """Every episode of a data set.

    Args:
        path: Folder of the set.
        state: Feature with the joint positions; "" for `observation.state`.
        action: Feature with the commanded positions; "" for `action`, if it has the same joints.

    Raises:
        FormatError: if files are missing or damaged, or episodes have gaps.
        ConfigError: if there is no such feature.
    """
    info = read_info(path)
    key = state or STATE
    names = joint_names(path, info, key)
    wanted = action or ACTION
    acts = (
        wanted != key
        and wanted in info["features"]
        and _names(info["features"][wanted]) == _names(info["features"][key])
    )
    columns = [key, *([wanted] if acts else [])]
    notes = _videos(info)
    if wanted != key and wanted in info["features"] and not acts:
        notes += (f"{wanted} is of other joints than {key}, and was not taken",)
    opened: tuple[Path, pa.Table] | None = None
    for rows in episodes(path, info):
        if opened is None or opened[0] != rows.file:
            opened = rows.file, _table(rows.file, columns)
        yield _motion(path, info, rows, opened[1], columns, names, notes)


def read_info(path: Path) -> Json:
    """info.json of a set.

    Raises:
        FormatError: if it is missing or lacks what is needed.
    """
    file = path / "meta" / "info.json"
    try:
        info = json.loads(file.read_text("utf-8-sig"))
    except OSError as error:
        raise FormatError(f"{file}: cannot be read: {error.strerror}") from error
    except ValueError as error:
        raise FormatError(f"{file}: expected JSON, got: {error}") from error
    if not isinstance(info, dict):
        raise FormatError(f"{file}: expected a table, got {info!s:.40}")
    for name in ("codebase_version", "fps", "features", "total_episodes", "data_path"):
        if name not in info:
            raise FormatError(f"{file}: '{name}' missing: not a LeRobot data set of v2 or v3")
    if info["codebase_version"] not in VERSIONS:
        raise FormatError(
            f"{file}: expected version {', '.join(VERSIONS)}, got {info['codebase_version']}"
        )
    features = info["features"]
    if not isinstance(features, dict) or not all(
        isinstance(each, dict) for each in features.values()
    ):
        raise FormatError(f"{file}: features: expected a table of tables, got {features!s:.40}")
    fps = info["fps"]
    if isinstance(fps, bool) or not isinstance(fps, int | float) or not 0 < fps < math.inf:
        raise FormatError(f"{file}: fps: expected a positive number, got {fps!r}")
    size = info.get("chunks_size", 1000)
    if not isinstance(size, int) or size < 1:
        raise FormatError(f"{file}: chunks_size: expected a positive whole number, got {size!r}")
    if not isinstance(info["data_path"], str):
        raise FormatError(f"{file}: data_path: expected a pattern, got {info['data_path']!r}")
    return dict(info)


def joint_names(path: Path, info: Json, key: str) -> tuple[str, ...]:
    """Names of the joints in a feature; numbered if the set has none.

    Raises:
        ConfigError: if there is no such feature, or it is not a list of numbers.
    """
    feature = info["features"].get(key)
    vectors = [
        name
        for name, each in info["features"].items()
        if str(each.get("dtype", "")).startswith("float") and _width(each)
    ]
    if feature is None or key not in vectors:
        raise ConfigError(
            f"{path}: expected joint positions in '{key}', got no such feature; choose one with "
            f"--state: {', '.join(vectors)}"
        )
    names = _names(feature)
    return names or tuple(f"{key}_{i}" for i in range(_width(feature)))


def episodes(path: Path, info: Json) -> Iterator[Rows]:
    """Where each episode is, in order.

    Raises:
        FormatError: if an episode is missing, or they are not numbered without gaps.
    """
    found = _v3(path, info) if info["codebase_version"] == "v3.0" else _v2(path, info)
    count = 0
    for rows in found:
        if rows.episode != count:
            raise FormatError(
                f"{path}: expected episode {count}, got {rows.episode}: the set has a gap, and "
                "every later episode would be taken for another; mend it with LeRobot's own tools"
            )
        count += 1
        yield rows
    if count != info["total_episodes"]:
        raise FormatError(
            f"{path}: info.json says {info['total_episodes']!r} episodes, the set has {count}"
        )


def _v3(path: Path, info: Json) -> Iterator[Rows]:
    files = sorted((path / "meta" / "episodes").rglob("*.parquet"))
    if not files:
        raise FormatError(f"{path}: meta/episodes is missing: cannot tell where episodes begin")
    for file in files:
        names = ["episode_index", "length", "tasks", "data/chunk_index", "data/file_index"]
        for row in _table(file, names).to_pylist():
            data = _data_file(
                path,
                info,
                chunk_index=row["data/chunk_index"],
                file_index=row["data/file_index"],
            )
            task = (row["tasks"] or [""])[0]
            yield Rows(row["episode_index"], row["length"], data, task)


def _v2(path: Path, info: Json) -> Iterator[Rows]:
    file = path / "meta" / "episodes.jsonl"
    try:
        lines = file.read_text("utf-8").splitlines()
    except OSError as error:
        raise FormatError(f"{file}: cannot be read: {error.strerror}") from error
    for number, line in enumerate(lines, 1):
        try:
            row = json.loads(line)
            index, length = int(row["episode_index"]), int(row["length"])
        except (ValueError, KeyError, TypeError) as error:
            raise FormatError(f"{file}: line {number}: {error}") from error
        chunk = index // info.get("chunks_size", 1000)
        data = _data_file(path, info, episode_chunk=chunk, episode_index=index)
        yield Rows(index, length, data, (row.get("tasks") or [""])[0])


def _data_file(path: Path, info: Json, **place: int | None) -> Path:
    """The file of an episode's rows, below the set's folder."""
    try:
        file = path / str(info["data_path"]).format(**place)
    except (KeyError, ValueError, TypeError, IndexError) as error:
        raise FormatError(
            f"{path}: data_path: expected a pattern for {place}, got '{info['data_path']}'"
        ) from error
    if not file.resolve().is_relative_to(path.resolve()):
        raise FormatError(f"{path}: data_path: expected files within the set, got {file}")
    return file


def _motion(
    path: Path,
    info: Json,
    rows: Rows,
    table: pa.Table,
    columns: Sequence[str],
    names: tuple[str, ...],
    notes: tuple[str, ...],
) -> Motion:
    mine = np.flatnonzero(numbers(rows.file, table, "episode_index") == rows.episode)
    place = f"episode {rows.episode}"
    if len(mine) != rows.length:
        raise FormatError(
            f"{rows.file}: {place}: expected {rows.length!r} rows as meta says, got {len(mine)}"
        )
    frames = numbers(rows.file, table, "frame_index")[mine]
    if (frames != np.arange(len(mine))).any():
        at = int(np.flatnonzero(frames != np.arange(len(mine)))[0])
        raise FormatError(f"{rows.file}: {place}: expected frame {at}, got {frames[at]:g}")
    stamps, clock = stamps_of(numbers(rows.file, table, "timestamp")[mine], info["fps"])
    values = [matrix(rows.file, table, name, len(names))[mine] for name in columns]
    return Motion(
        path,
        "lerobot",
        place,
        names,
        stamps,
        values[0],
        action=values[1] if len(values) > 1 else None,
        task=rows.task,
        clock=clock,
        where={
            "version": info["codebase_version"],
            "episode": rows.episode,
            "state": columns[0],
            "action": columns[1] if len(columns) > 1 else "",
            "robot_type": info.get("robot_type", ""),
        },
        notes=notes,
    )


def stamps_of(given: Array, fps: float) -> tuple[Array, str]:
    """Frame numbers over fps where the float32 stamps say so, else the stamps themselves [ns]."""
    even = np.arange(len(given)) / fps
    if len(given) and np.abs(given - given[0] - even).max() < TOLERANCE:
        return np.rint(even * NS).astype(np.int64), "frame number over fps"
    return np.rint(given.astype(np.float64) * NS).astype(np.int64), "timestamp"


def _table(file: Path, columns: Sequence[str]) -> pa.Table:
    """Some columns of a Parquet file; of rows, the indexes too."""
    indexes = () if "tasks" in columns else ("timestamp", "frame_index", "episode_index")
    if not file.is_file():
        raise FormatError(
            f"{file}: missing, though the set's metadata names it; download the whole set first, "
            "nothing is fetched from here"
        )
    return read_columns(file, list(dict.fromkeys([*columns, *indexes])))


def _names(feature: Any) -> tuple[str, ...]:
    """LeRobot's `names` as a flat list, whichever of its shapes they have.

    A list; lists in a list; or a dict of lists (`{"motors": [...]}`) or of places.
    """
    names = feature.get("names")
    if isinstance(names, dict) and all(isinstance(each, int) for each in names.values()):
        names = sorted(names, key=names.__getitem__)
    found = tuple(map(str, _leaves(names)))
    return found if len(found) == _width(feature) and len(set(found)) == len(found) else ()


def _leaves(names: Any) -> list[Any]:
    if isinstance(names, dict):
        names = list(names.values())
    if isinstance(names, list):
        return [leaf for each in names for leaf in _leaves(each)]
    return [] if names is None else [names]


def _width(feature: Any) -> int:
    """Entries of a vector, also one of shape (n, 1) or (1, n); 0 if it is none."""
    shape = feature.get("shape")
    if not isinstance(shape, list | tuple) or not all(isinstance(n, int) for n in shape):
        return 0
    return math.prod(shape) if sum(n != 1 for n in shape) <= 1 and shape else 0


def _videos(info: Json) -> tuple[str, ...]:
    videos = [name for name, each in info["features"].items() if each.get("dtype") == "video"]
    return (f"videos stay in the source: {', '.join(videos)}",) if videos else ()
