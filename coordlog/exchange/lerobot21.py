"""LeRobot v2.1 data sets: one Parquet file and one video per episode, metadata as JSON lines.

Columns and rules are those of v3.0. An episode's origin and final state stand in its line of
episodes.jsonl, under `coordlog`.

Source: lerobot 0.6.1, scripts/convert_dataset_v21_to_v30.py.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq

from coordlog.episode import Json
from coordlog.exchange import statistics, video
from coordlog.exchange.blocks import Block, Options
from coordlog.exchange.lerobot import (
    camera_key,
    declared,
    features_of,
    final_state,
    indexes,
    info_of,
    made,
    merged_tasks,
    table_of,
    write_json,
)
from coordlog.exchange.source import Loaded, fps_of, task_text

VERSION = "v2.1"
EPISODES_PER_CHUNK = 1000
DATA_PATH = "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet"
VIDEO_PATH = "videos/chunk-{episode_chunk:03d}/{video_key}/episode_{episode_index:06d}.mp4"
_LINES = ("episodes", "episodes_stats")


def write_block(block: Block) -> Json:
    """Files of each episode, and the block's lines of the two metadata files."""
    frame = block.first_frame
    lines: dict[str, list[str]] = {name: [] for name in _LINES}
    journal: Json = {"tasks": {}, "number": block.number}
    for number, loaded in enumerate(block.loaded(), block.first_episode):
        header = loaded.episode.header
        text = task_text(header)
        task = block.tasks.index(text)
        journal["tasks"][str(task)] = text
        own = features_of(loaded)
        index = indexes(loaded, episode=number, frame=frame, task=task)
        place = {"episode_chunk": number // EPISODES_PER_CHUNK, "episode_index": number}
        table = table_of(own | index)
        data = made(block.folder / DATA_PATH.format(**place))
        pq.write_table(table, data, compression="snappy")
        stats = dict(statistics.of_columns(own | index).items()) | _filmed(block, loaded, place)
        line = {"episode_index": number, "tasks": [text], "length": len(loaded.episode)}
        last = {
            key: value.tolist() if isinstance(value, np.ndarray) else value
            for key, value in final_state(loaded)
        }
        lines["episodes"].append(json.dumps(line | {"coordlog": loaded.provenance | last}))
        lines["episodes_stats"].append(json.dumps({"episode_index": number, "stats": stats}))
        if number == block.first_episode:
            journal["features"] = declared(loaded, block.options)
            journal["robot"] = str(header.episode.get("robot", ""))
            journal["fps"] = fps_of(header)
        frame += len(loaded.episode)
    journal["frames"] = frame - block.first_frame
    journal["episodes"] = len(block.paths)
    for name, texts in lines.items():
        part = made(_part(block.folder, name, block.number))
        part.write_text("".join(f"{text}\n" for text in texts), "utf-8")
    return journal


def assemble(folder: Path, journals: Sequence[Json], options: Options) -> None:
    """Join the lines of all blocks; write info.json and tasks.jsonl."""
    for name in _LINES:
        with (folder / "meta" / f"{name}.jsonl").open("wb") as whole:
            for journal in journals:
                whole.write(_part(folder, name, journal["number"]).read_bytes())
    for journal in journals:
        for name in _LINES:
            _part(folder, name, journal["number"]).unlink()
    lines = [
        json.dumps({"task_index": i, "task": text}, ensure_ascii=False)
        for i, text in enumerate(merged_tasks(journals))
    ]
    (folder / "meta" / "tasks.jsonl").write_text("".join(f"{line}\n" for line in lines), "utf-8")
    info = info_of(journals)
    own = {
        "codebase_version": VERSION,
        "total_videos": info["total_episodes"] * len(options.cameras),
        "total_chunks": -(-info["total_episodes"] // EPISODES_PER_CHUNK),
        "chunks_size": EPISODES_PER_CHUNK,
        "data_path": DATA_PATH,
        "video_path": VIDEO_PATH if options.cameras else None,
    }
    write_json(folder / "meta" / "info.json", own | info)


def _filmed(block: Block, loaded: Loaded, place: Json) -> dict[str, statistics.Stats]:
    paths = {
        camera: made(block.folder / VIDEO_PATH.format(video_key=camera_key(camera), **place))
        for camera in block.options.cameras
    }
    with video.Videos(paths, block.options) as videos:
        shown = videos.add(loaded)
    return {camera_key(camera): film.stats for camera, film in shown.items()}


def _part(folder: Path, name: str, number: int) -> Path:
    return folder / "meta" / "parts" / f"{name}-{number:05d}.jsonl"
