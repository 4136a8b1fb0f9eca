"""What the episode file costs, as ratios measured in one run.

    python -m experiments.speed.bench_record [--episodes 100] [--logs FOLDER] [--json FILE]

Logs (a folder of one scene, or some expert episodes at the table recorded first) are written again
as often as it takes, with the topics for viewing and without, and read by ours, by mcap with
mcap-ros2-support, and as arrays on disk. Files come from the page cache.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Iterator
from itertools import cycle, islice
from pathlib import Path

import numpy as np
import pyarrow as pa
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from coordlog import api
from coordlog.episode import Array, Episode
from coordlog.record.reader import read_attachments
from coordlog.record.writer import write_episode
from coordlog.spec import STEP
from experiments.speed.clock import Row, medians, show, turns

COLUMNS = [item.name for item in STEP.fields[1:]]
SLOW = 10  # episodes for the slow reader: it is timed per step


def main() -> None:
    """Measure reading, sizes and writing."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", 1)[0])
    parser.add_argument("--logs", type=Path)
    parser.add_argument("--episodes", type=int, default=100)
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        logs = given.logs or Path(name, "logs")
        if given.logs is None:
            api.record("table", episodes=10, noise=0.15, out=logs)
        show(rows(logs, Path(name), given.episodes), given.json)


def rows(logs: Path, folder: Path, count: int) -> Iterator[Row]:
    """Everything about so many episodes."""
    opened = api.open(logs)
    some, attached = list(opened), read_attachments(opened.paths[0])
    many = list(islice(cycle(some), count))
    sizes = {}
    for name, shown in (("plain", False), ("shown", True)):
        (folder / name).mkdir()
        for index, episode in enumerate(many):
            write(folder / name / f"{index:05}.mcap", episode, attached, display=shown)
        files = [folder / name / f"{index:05}.mcap" for index in range(len(some))]
        sizes[name] = sum(file.stat().st_size for file in files) / sum(map(len, some))
    yield from reading(folder, many)
    yield Row("size without topics for viewing", sizes["plain"], "B/step")
    yield Row("size with them", sizes["shown"], "B/step")
    written = {
        name: lambda shown=shown: write(folder / "w.mcap", some[0], attached, display=shown)
        for name, shown in (("without topics for viewing", False), ("with them", True))
    }
    for name, seconds in medians(turns(written, repeat=5)).items():
        yield Row(f"writing {name}", seconds / len(some[0]) * 1e6, "µs/step")


def reading(folder: Path, many: list[Episode]) -> Iterator[Row]:
    """Logs to Arrow columns, against a general reader and against arrays on disk."""
    for index, episode in enumerate(many):
        columns = {name: getattr(episode, name)[: len(episode)] for name in COLUMNS}
        np.savez(folder / f"{index:05}.npz", **columns)
        for name, column in columns.items():
            np.save(folder / f"{index:05}.{name}.npy", column)
    few = range(min(SLOW, len(many)))
    seconds = medians(
        turns(
            {
                "ours": lambda: api.open(folder / "plain").to_table(),
                "ours, topics for viewing on": lambda: api.open(folder / "shown").to_table(),
                "npz": lambda: [load_npz(folder / f"{i:05}.npz") for i in range(len(many))],
                "npy": lambda: [load_npy(folder, f"{i:05}") for i in range(len(many))],
                "mcap-ros2": lambda: [with_ros2(folder / "plain" / f"{i:05}.mcap") for i in few],
            }
        )
    )
    steps, slow = sum(map(len, many)), sum(len(many[index]) for index in few)
    ours = seconds["ours"] / steps
    for name, taken in seconds.items():
        yield Row(
            f"reading: {name}", taken / (slow if name == "mcap-ros2" else steps) * 1e6, "µs/step"
        )
    yield Row("mcap-ros2 / ours", seconds["mcap-ros2"] / slow / ours, target="≥ 20")
    for kind in ("npz", "npy"):
        yield Row(f"ours / np.load of .{kind}", seconds["ours"] / seconds[kind], target="≤ 0.6")


def write(path: Path, episode: Episode, attached: dict[str, bytes], *, display: bool) -> None:
    """Write an episode again, over what was there."""
    path.unlink(missing_ok=True)
    write_episode(path, episode, attachments=attached, display=display)


def with_ros2(path: Path) -> pa.Table:
    """The same table with mcap and mcap-ros2-support, as their documentation shows it."""
    columns: dict[str, list[object]] = {name: [] for name in COLUMNS}
    with open(path, "rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        for decoded in reader.iter_decoded_messages(topics=[STEP.topic]):
            for name, column in columns.items():
                column.append(getattr(decoded.decoded_message, name))
    return pa.table(columns)


def load_npz(path: Path) -> dict[str, Array]:
    """All arrays of an episode in one file."""
    with np.load(path) as arrays:
        return {name: arrays[name] for name in COLUMNS}


def load_npy(folder: Path, stem: str) -> dict[str, Array]:
    """All arrays of an episode, a file each."""
    return {name: np.load(folder / f"{stem}.{name}.npy") for name in COLUMNS}


if __name__ == "__main__":
    main()
