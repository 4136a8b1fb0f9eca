"""LeRobot v3.0 data sets, written with pyarrow alone.

T rows an episode: the state each action met, the action, and what it led to (`next.…`). The final
state has no row: it stands in the episode's own columns `coordlog/final.…`, beside its origin
(`coordlog/sha256`, `coordlog/scene`, …). Numbers keep the type and every bit they have in the log.

A block of episodes is one file of rows, one of episodes and one video per camera, which the layout
allows; LeRobot's own tools merge and split them.

Source: lerobot 0.6.1, datasets/.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from coordlog.episode import Array, Json
from coordlog.exchange import cameras, statistics, video
from coordlog.exchange.blocks import Block, Options
from coordlog.exchange.columns import Column, columns
from coordlog.exchange.source import Loaded, fps_of, task_text
from coordlog.record.arrow import arrow_array

VERSION = "v3.0"
FILES_PER_CHUNK = 1000
DATA_PATH = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
VIDEO_PATH = "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"
_EPISODES_PATH = "meta/episodes/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
INDEXES = ("timestamp", "frame_index", "episode_index", "index", "task_index")


def features_of(loaded: Loaded) -> dict[str, Array]:
    """The columns of an episode under LeRobot's names, T rows each, without the indexes."""
    known = columns(loaded.episode)
    length = len(loaded.episode)
    found: dict[str, Array] = {}
    for item in sorted(known.values(), key=lambda item: item.name != "state"):
        found[name_of(item)] = item.values[:length]
    if "reward" in known:
        found["next.reward"] = known["reward"].values.sum(axis=1)
    found["next.done"] = known["terminated"].values | known["truncated"].values
    found["next.success"] = _success(known)
    if "observation.state" not in found:  # a task without a policy state: the joints are its state
        found = {"observation.state": known["qpos"].values[:length]} | found
    return found


def name_of(item: Column) -> str:
    """LeRobot's name of a column: `observation.…` before the action, `next.…` after it."""
    if item.name == "action":
        return "action"
    if item.name == "reward":
        return "next.rewards"
    return f"observation.{item.name}" if item.before else f"next.{item.name}"


def indexes(loaded: Loaded, *, episode: int, frame: int, task: int) -> dict[str, Array]:
    """The columns that every LeRobot set has."""
    length = len(loaded.episode)
    at = np.arange(length)
    fps = fps_of(loaded.episode.header)
    return {
        "timestamp": (at / fps).astype(np.float32),
        "frame_index": at,
        "episode_index": np.full(length, episode),
        "index": frame + at,
        "task_index": np.full(length, task),
    }


def declared(loaded: Loaded, options: Options) -> dict[str, Json]:
    """The entry `features` of info.json."""
    labels = {name_of(item): item.labels for item in columns(loaded.episode).values()}
    found: dict[str, Json] = {}
    for name, values in features_of(loaded).items():
        width = list(values.shape[1:]) or [1]
        names = list(labels.get(name, ())) or None
        if name == "observation.state" and names is None:
            names = list(labels["observation.qpos"])
        found[name] = {"dtype": str(values.dtype), "shape": width, "names": names}
    fps = fps_of(loaded.episode.header)
    for camera in options.cameras:
        found[camera_key(camera)] = video.feature(options.width, options.height, fps)
    for name in INDEXES:
        kind = "float32" if name == "timestamp" else "int64"
        found[name] = {"dtype": kind, "shape": [1], "names": None}
    return found


def camera_key(camera: str) -> str:
    """Feature of a camera's video."""
    return f"observation.images.{cameras.label(camera)}"


def table_of(values: Mapping[str, Array]) -> pa.Table:
    """Columns as an Arrow table: one number a row, or lists of one length."""
    arrays, fields = [], []
    for name, column in values.items():
        kind = pa.from_numpy_dtype(column.dtype)
        if column.ndim > 1:
            kind = pa.list_(kind, column.shape[1])
        arrays.append(arrow_array(np.ascontiguousarray(column), kind))
        fields.append(pa.field(name, kind))
    return pa.table(arrays, schema=pa.schema(fields))


def write_block(block: Block) -> Json:
    """Rows, episodes and videos of one block; statistics and what info.json needs come back."""
    place = {
        "chunk_index": block.number // FILES_PER_CHUNK,
        "file_index": block.number % FILES_PER_CHUNK,
    }
    data = made(block.folder / DATA_PATH.format(**place))
    frame, kept, rows = block.first_frame, [], []
    journal: Json = {"tasks": {}, "frames": 0, "robot": "", "features": {}, "fps": 0}
    writer: pq.ParquetWriter | None = None
    with video.Videos(_videos(block, place), block.options) as videos:
        for number, loaded in enumerate(block.loaded(), block.first_episode):
            header = loaded.episode.header
            text = task_text(header)
            task = block.tasks.index(text)
            own = features_of(loaded)
            index = indexes(loaded, episode=number, frame=frame, task=task)
            table = table_of(own | index)
            if writer is None:
                writer = pq.ParquetWriter(data, table.schema, compression="snappy")
                journal["features"] = declared(loaded, block.options)
                journal["robot"] = str(header.episode.get("robot", ""))
                journal["fps"] = fps_of(header)
            writer.write_table(table, row_group_size=max(len(table), 1))
            stats = statistics.of_columns(own | index)
            shown = videos.add(loaded)
            stats |= {camera_key(camera): film.stats for camera, film in shown.items()}
            kept.append(stats)
            rows.append(_episode_row(loaded, number, frame, text, place, stats, shown))
            journal["tasks"][str(task)] = text
            frame += len(loaded.episode)
    if writer is not None:
        writer.close()
    episodes = made(block.folder / _EPISODES_PATH.format(**place))
    pq.write_table(_rows_table(rows), episodes, compression="snappy")
    journal["frames"], journal["episodes"] = frame - block.first_frame, len(rows)
    journal["stats"] = {
        name: statistics.pooled([stats[name] for stats in kept]) for name in kept[0]
    }
    return journal


def assemble(folder: Path, journals: Sequence[Json], options: Options) -> None:
    """Write info.json, tasks.parquet and stats.json."""
    sizes = {"data_files_size_in_mb": 100, "video_files_size_in_mb": 200}
    own = {"codebase_version": VERSION, "chunks_size": FILES_PER_CHUNK, **sizes}
    paths = {"data_path": DATA_PATH, "video_path": VIDEO_PATH if options.cameras else None}
    write_json(folder / "meta" / "info.json", own | info_of(journals) | paths)
    pooled = {
        name: statistics.pooled([journal["stats"][name] for journal in journals])
        for name in journals[0]["stats"]
    }
    write_json(folder / "meta" / "stats.json", pooled)
    _write_tasks(folder / "meta" / "tasks.parquet", merged_tasks(journals))


def info_of(journals: Sequence[Json]) -> Json:
    """What info.json says in every version."""
    first, episodes = journals[0], sum(journal["episodes"] for journal in journals)
    return {
        "robot_type": first["robot"],
        "total_episodes": episodes,
        "total_frames": sum(journal["frames"] for journal in journals),
        "total_tasks": len(merged_tasks(journals)),
        "fps": first["fps"],
        "splits": {"train": f"0:{episodes}"},
        "features": first["features"],
    }


def merged_tasks(journals: Sequence[Json]) -> list[str]:
    """The tasks of all blocks, row i being task i."""
    known = {int(index): text for journal in journals for index, text in journal["tasks"].items()}
    return [known[index] for index in sorted(known)]


def write_json(path: Path, value: Any) -> None:
    """A JSON file of a set; the folder is made."""
    made(path).write_text(json.dumps(value, indent=4, ensure_ascii=False) + "\n", "utf-8")


def final_state(loaded: Loaded) -> Iterator[tuple[str, Array | float]]:
    """The state after the last action: `final.NAME` and its numbers."""
    for item in columns(loaded.episode).values():
        if item.before:
            last = item.values[-1]
            yield f"final.{item.name}", (last if item.values.ndim > 1 else float(last))


def _success(known: Mapping[str, Column]) -> Array:
    """Every end effector at its goal after the action, or never where the task has no goals."""
    if "goal" in known:
        return np.asarray(known["goal"].values.all(axis=1))
    return np.zeros(len(known["terminated"].values), bool)


def _episode_row(
    loaded: Loaded,
    number: int,
    frame: int,
    task: str,
    place: Json,
    stats: Json,
    shown: Mapping[str, video.Shown],
) -> Json:
    length = len(loaded.episode)
    row: Json = {"episode_index": number, "tasks": [task], "length": length}
    row |= {f"data/{key}": value for key, value in place.items()}
    row |= {"dataset_from_index": frame, "dataset_to_index": frame + length}
    for camera, film in shown.items():
        prefix = f"videos/{camera_key(camera)}"
        row |= {f"{prefix}/{key}": value for key, value in place.items()}
        row[f"{prefix}/from_timestamp"] = film.start
        row[f"{prefix}/to_timestamp"] = film.stop
    for name, each in stats.items():
        row |= {f"stats/{name}/{key}": value for key, value in each.items()}
    row |= {f"meta/episodes/{key}": value for key, value in place.items()}
    row |= {f"coordlog/{key}": value for key, value in loaded.provenance.items()}
    for key, last in final_state(loaded):
        row[f"coordlog/{key}"] = last.tolist() if isinstance(last, np.ndarray) else last
    return row


def _rows_table(rows: Sequence[Json]) -> pa.Table:
    return pa.table({name: pa.array([row[name] for row in rows]) for name in rows[0]})


def _videos(block: Block, place: Json) -> dict[str, Path]:
    return {
        camera: made(block.folder / VIDEO_PATH.format(video_key=camera_key(camera), **place))
        for camera in block.options.cameras
    }


def _write_tasks(path: Path, tasks: Sequence[str]) -> None:
    """Row i is task i; the text is the pandas index, or loaders take the row number for it."""
    pandas = {
        "index_columns": ["task"],
        "column_indexes": [],
        "columns": [
            _pandas_column("task_index", "int64"),
            _pandas_column("task", "unicode"),
        ],
        "pandas_version": "2.0.0",
    }
    table = pa.table({"task_index": pa.array(range(len(tasks)), pa.int64()), "task": list(tasks)})
    table = table.replace_schema_metadata({"pandas": json.dumps(pandas)})
    pq.write_table(table, made(path), compression="snappy")


def _pandas_column(name: str, kind: str) -> Json:
    number = kind == "int64"
    return {
        "name": name,
        "field_name": name,
        "pandas_type": kind,
        "numpy_type": kind if number else "object",
        "metadata": None,
    }


def made(path: Path) -> Path:
    """The path, whose folder is made."""
    path.parent.mkdir(parents=True, exist_ok=True)
    return path
