"""What the episode file costs, as ratios measured in one run.

    python experiments/speed/bench_record.py [FOLDER] [--episodes 500] [--json FILE]

FOLDER holds real logs, which are written again (as often as it takes) in the variants that are
compared; without it the episodes are synthetic: smooth joint paths with full mantissas. The
variants of one measurement take turns, and the median turn counts. Times are CPU times, which a
busy machine does not change much; waiting for the disk (fsync) is not in them.
"""

from __future__ import annotations

import argparse
import gc
import json
import statistics
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from coordlog.episode import CONTACT, FIELD_KEYS, Episode, Header, Result
from coordlog.record import dataset
from coordlog.record.reader import read_attachments, read_episode
from coordlog.record.writer import BLOCK, EpisodeWriter, write_episode
from coordlog.spec import REACH, SCHEMA_VERSION, STEP, Layout

COLUMNS = [item.name for item in STEP.fields[1:] if item.size != "n_c"]
ROUNDS = 5
SLOW = 20  # episodes for the slow reader: it is timed per step

Row = dict[str, float | str]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", nargs="?", type=Path)
    parser.add_argument("--episodes", type=int, default=500)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    episodes, attachments = logs(options.folder, options.episodes)
    with tempfile.TemporaryDirectory() as folder:
        rows = [
            *decoding(Path(folder), episodes, attachments),
            *sizes(Path(folder), episodes, attachments),
            *writing(episodes, attachments),
        ]
    for row in rows:
        print(f"{row['what']:58} {row['value']:9.3f} {row['unit']:9} {row['target']}")
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1))


def logs(folder: Path | None, count: int) -> tuple[list[Episode], dict[str, bytes]]:
    """So many episodes, and the attachments of one of them."""
    if folder is None:
        return [synthetic(np.random.default_rng(seed)) for seed in range(count)], {
            "model.mjb.zst": np.random.default_rng(0).bytes(14_000)
        }
    opened = dataset.open(folder)
    some = [read_episode(path) for path in opened.paths[:count]]
    return [some[index % len(some)] for index in range(count)], read_attachments(opened.paths[0])


def synthetic(rng: np.random.Generator, length: int = 116) -> Episode:
    layout = Layout(n_q=34, n_v=33, n_x=34, n_u=13, k=2)
    speed = np.cumsum(rng.normal(size=(length + 1, layout.n_v)), axis=0) * 0.02
    angle = rng.uniform(-1, 1, layout.n_q) + np.pad(
        np.cumsum(speed, axis=0) * 0.04, ((0, 0), (0, 1))
    )
    distance = np.abs(np.cumsum(rng.normal(size=(length, layout.k)), axis=0)) * 0.02
    flags = {
        name: np.zeros(length, bool)
        for name in ("collision", "instability", "terminated", "truncated")
    }
    header = Header(
        episode={
            "schema_version": SCHEMA_VERSION,
            "start_time": 1_700_000_000_000_000_000,
            "control_period": 0.04,
            **dict.fromkeys(("id", "run", "robot", "scene", "split", "start"), ""),
            **{"seed": 0, "index": 0, "goals": [[0, 0, 0]] * 2, "obstacles": []},
        },
        env={
            "task": {
                "name": "reach",
                "fields": [{key: getattr(item, key) for key in FIELD_KEYS} for item in REACH],
            },
            **dict.fromkeys(("coordlog_version", "mujoco_version", "architecture"), ""),
            **{"reward": {}, "config": {}, "robot": {"name": "synthetic"}},
            **{"actuators": [], "geoms": [], "action_joints": [], "state": []},
            "layout": vars(layout),
            "arms": {"left": [0], "right": [1]},
            "joints": [
                {"name": f"joint_{index}", "qpos": 7 + index, "qvel": 6 + index}
                for index in range(27)
            ],
        },
        policy={"kind": "synthetic", "name": "", "checkpoint_sha256": "", "noise": {}},
    )
    return Episode(
        header=header,
        result=Result(length, (), False, False, False, False, "synthetic", ""),
        time=np.arange(length + 1) * 0.04,
        qpos=angle,
        qvel=speed,
        state=np.tanh(angle[:, np.arange(34)]).astype(np.float32),
        action=rng.uniform(-1, 1, (length, layout.n_u)).astype(np.float32),
        reward=-distance,
        distance=distance,
        boundary=distance < 0.1,
        goal=distance < 0.03,
        contacts=np.empty(0, CONTACT),
        **flags,
    )


def decoding(folder: Path, episodes: list[Episode], attachments: dict[str, bytes]) -> list[Row]:
    """Logs to Arrow columns, against a general reader and against arrays on disk."""
    plain, shown, arrays = folder / "plain", folder / "shown", folder / "arrays"
    for path in (plain, shown, arrays):
        path.mkdir()
    for index, episode in enumerate(episodes):
        write_episode(plain / f"{index:05}.mcap", episode, attachments=attachments, display=False)
        write_episode(shown / f"{index:05}.mcap", episode, attachments=attachments, display=True)
        columns = {name: getattr(episode, name)[: len(episode)] for name in COLUMNS}
        np.savez(arrays / f"{index:05}.npz", **columns)
        for name, column in columns.items():
            np.save(arrays / f"{index:05}.{name}.npy", column)
    count, steps = len(episodes), sum(map(len, episodes))
    slow = sum(map(len, episodes[:SLOW]))
    seconds = turns(
        {
            "ours": lambda: dataset.open(plain).to_table(),
            "ours, display topics on": lambda: dataset.open(shown).to_table(),
            "npz": lambda: [load_npz(arrays / f"{index:05}.npz") for index in range(count)],
            "npy": lambda: [load_npy(arrays, f"{index:05}") for index in range(count)],
            "mcap-ros2": lambda: [
                with_ros2(plain / f"{index:05}.mcap") for index in range(min(SLOW, count))
            ],
            "mcap-ros2, display topics on": lambda: [
                with_ros2(shown / f"{index:05}.mcap") for index in range(min(SLOW, count))
            ],
        }
    )
    per_step = {
        name: value / (slow if name.startswith("mcap") else steps) * 1e6
        for name, value in seconds.items()
    }
    ours, display = per_step["ours"], per_step["ours, display topics on"]
    return [
        *(
            {
                "what": f"decode {count} episodes: {name}",
                "value": value,
                "unit": "µs/step",
                "target": "",
            }
            for name, value in per_step.items()
        ),
        ratio("mcap-ros2 / ours", per_step["mcap-ros2"] / ours, "≥ 10"),
        ratio(
            "mcap-ros2 / ours, display topics on",
            per_step["mcap-ros2, display topics on"] / display,
            "≥ 10",
        ),
        ratio("ours / np.load of one .npz per episode", ours / per_step["npz"], "≤ 1.0"),
        ratio("ours / np.load of one .npy per array", ours / per_step["npy"], "≤ 1.0"),
        ratio("ours, display topics on / one .npz per episode", display / per_step["npz"], ""),
        ratio("ours, display topics on / one .npy per array", display / per_step["npy"], ""),
    ]


def sizes(folder: Path, episodes: list[Episode], attachments: dict[str, bytes]) -> list[Row]:
    """Bytes per step against Arrow IPC with zstd, one file per episode as well."""
    distinct = list({id(episode): episode for episode in episodes}.values())
    steps, arrow = sum(map(len, distinct)), 0
    for index, episode in enumerate(distinct):
        path = folder / "one.mcap"
        write_episode(path, episode, attachments={}, display=False)
        table = dataset.open(path).to_table().drop_columns(["episode"])
        path.unlink()
        arrow_file = folder / f"{index}.arrow"
        with pa.ipc.new_file(
            arrow_file, table.schema, options=pa.ipc.IpcWriteOptions(compression="zstd")
        ) as writer:
            writer.write_table(table)
        arrow += arrow_file.stat().st_size
        arrow_file.unlink()
    plain = total(folder, distinct, {}, display=False)
    shown, attached = (
        total(folder, distinct, {}, display=True),
        total(folder, distinct, attachments, display=False),
    )
    rows: list[Row] = [
        {"what": f"size: {name}", "value": value / steps, "unit": "B/step", "target": ""}
        for name, value in {
            "Arrow IPC, zstd": arrow,
            "ours, without display topics and attachments": plain,
            "display topics": shown - plain,
            "attachments": attached - plain,
        }.items()
    ]
    return [
        *rows,
        ratio("ours / Arrow IPC, zstd", plain / arrow, "≤ 1.3"),
        ratio("ours with display topics / Arrow IPC, zstd", shown / arrow, ""),
    ]


def writing(episodes: list[Episode], attachments: dict[str, bytes]) -> list[Row]:
    """Encoding and writing: a block of steps, and what an episode costs besides."""
    rows: list[Row] = []
    for display in (False, True):
        steps: list[float] = []
        ends: list[float] = []
        with tempfile.TemporaryDirectory() as folder:
            for index, episode in enumerate(episodes[:200]):
                one, both = timed_write(
                    Path(folder) / f"{index}.mcap", episode, attachments, display=display
                )
                steps.append(one)
                ends.append(both)
        kind = "display topics on" if display else "display topics off"
        rows.append(
            {
                "what": f"write blocks of {BLOCK}, {kind}",
                "value": statistics.median(steps),
                "unit": "µs/step",
                "target": "",
            }
        )
        rows.append(
            {
                "what": f"open and finish an episode, {kind}",
                "value": statistics.median(ends),
                "unit": "µs",
                "target": "",
            }
        )
    return rows


def timed_write(
    path: Path, episode: Episode, attachments: dict[str, bytes], *, display: bool
) -> tuple[float, float]:
    """CPU µs per step for the blocks, and CPU µs for everything else."""
    blocks = []
    for first in range(0, len(episode), BLOCK):
        stop = min(first + BLOCK, len(episode))
        low, high = np.searchsorted(episode.contacts["step"], (first, stop))
        blocks.append(
            (
                first,
                {name: getattr(episode, name)[first:stop] for name in COLUMNS},
                episode.contacts[low:high],
            )
        )
    begun = time.process_time()
    with EpisodeWriter(path, episode.header, attachments=attachments, display=display) as writer:
        opened = time.process_time()
        for first, columns, contacts in blocks:
            writer.write_steps(first, columns, contacts=contacts)
        written = time.process_time()
        writer.finish(
            {name: episode.columns[name][-1] for name in episode.before},
            aborted=episode.result.aborted,
        )
    return (written - opened) / len(episode) * 1e6, (
        time.process_time() - written + opened - begun
    ) * 1e6


def total(
    folder: Path, episodes: list[Episode], attachments: dict[str, bytes], *, display: bool
) -> int:
    size = 0
    for episode in episodes:
        path = folder / "size.mcap"
        write_episode(path, replace(episode), attachments=attachments, display=display)
        size += path.stat().st_size
        path.unlink()
    return size


def with_ros2(path: Path) -> pa.Table:
    """The same table with mcap and mcap-ros2-support, as their documentation shows it."""
    columns: dict[str, list[object]] = {item.name: [] for item in STEP.fields}
    with open(path, "rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        for decoded in reader.iter_decoded_messages(topics=[STEP.topic]):
            for name, column in columns.items():
                column.append(getattr(decoded.decoded_message, name))
    return pa.table(columns)


def load_npz(path: Path) -> dict[str, np.ndarray]:
    with np.load(path) as arrays:
        return {name: arrays[name] for name in COLUMNS}


def load_npy(folder: Path, stem: str) -> dict[str, np.ndarray]:
    return {name: np.load(folder / f"{stem}.{name}.npy") for name in COLUMNS}


def turns(variants: dict[str, Callable[[], object]]) -> dict[str, float]:
    """Median CPU seconds of each variant, one after the other in every round.

    Files come from the page cache.
    """
    seconds: dict[str, list[float]] = {name: [] for name in variants}
    for _ in range(ROUNDS):
        for name, run in variants.items():
            gc.collect()
            begun = time.process_time()
            result = run()
            seconds[name].append(time.process_time() - begun)
            del result
    return {name: statistics.median(values) for name, values in seconds.items()}


def ratio(what: str, value: float, target: str) -> Row:
    return {
        "what": what,
        "value": value,
        "unit": "×",
        "target": f"(target {target})" if target else "",
    }


if __name__ == "__main__":
    main()
