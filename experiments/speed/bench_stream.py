"""Learning from more logs than memory holds: peak memory with a window, and what the window costs.

    python experiments/speed/bench_stream.py [--episodes 100000] [--memory 200MB] [--rounds 20]
    [--longest] [--keep FOLDER] [--json FILE]

The logs are a pack whose members are copies of an episode of the tests, 256 of them with headers of
their own, and its catalogue. Memory is that of `coordlog train --memory`, of all of its processes
together, pages they share counted twice. Speed is of two trainers in one process that take turns, one
with all columns in memory: updates per second on the clock, and per second of the processor of this
process alone; the readers' own is said apart. The pack takes some 60 kB an episode on disk.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from coordlog.api.streams import listed, stream_of
from coordlog.api.train_plan import TrainPlan
from coordlog.catalog.index import Catalog
from coordlog.catalog.rows import episode_row, table_of
from coordlog.monitor import Monitor
from coordlog.record.pack_writer import PackWriter
from coordlog.record.reader import read_attachments, read_episode
from coordlog.record.recording import Recording
from coordlog.record.writer import write_episode
from coordlog.train.bind import learning_task
from coordlog.train.columns import Columns
from coordlog.train.loop import Trainer
from coordlog.train.settings import load_settings
from coordlog.train.stream import Logged, read

ROOT = Path(__file__).parents[2]
SOURCE = ROOT / "tests" / "data" / "v1" / "table"
KINDS, TURN = 256, 25

Row = tuple[str, float, str]


def main() -> None:
    """Measure as the options say."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--episodes", type=int, default=100_000)
    parser.add_argument("--memory", default="200MB")
    parser.add_argument("--rounds", type=int, default=20, help=f"turns of {TURN} updates each")
    parser.add_argument("--updates", type=int, default=500, help="of the run whose memory is seen")
    parser.add_argument("--longest", action="store_true", help="episodes of 107 steps, not of 20")
    parser.add_argument("--keep", type=Path, help="where the pack is made, or was made before")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    torch.set_num_threads(1)
    found: list[Row] = []
    with tempfile.TemporaryDirectory(prefix="coordlog-bench-") as name:
        kept = (options.keep or Path(name)).absolute()
        pack = kept / "PACK"
        made = copies(kept / "kinds", longest=options.longest)
        if not pack.exists():
            packed(made, pack, options.episodes)
        for rows in (
            speed(made, pack, Path(name), options),
            memory(pack, Path(name), options),
        ):
            for row in rows:
                found.append(row)
                print(f"{row[0]:72} {row[1]:10.4g} {row[2]}", flush=True)
    if options.json:
        options.json.write_text(json.dumps(found, indent=1))


def copies(folder: Path, *, longest: bool) -> list[Path]:
    """An episode of the tests, with headers of their own."""
    choose = max if longest else min
    source = choose(SOURCE.glob("*.mcap"), key=lambda path: path.stat().st_size)
    episode, attached = read_episode(source), read_attachments(source)
    paths = [folder / f"{at:03}.mcap" for at in range(KINDS)]
    for at, path in enumerate(paths):
        if not path.exists():
            path.parent.mkdir(parents=True, exist_ok=True)
            about = {**episode.header.episode, "id": f"{at:016x}"}
            header = replace(episode.header, episode=about)
            write_episode(
                path, replace(episode, header=header), attachments=attached, display=False
            )
    return paths


def packed(made: list[Path], pack: Path, episodes: int) -> None:
    """A pack of so many members, and its catalogue, which would say the same if it were made."""
    texts = [path.read_bytes() for path in made]
    names = []
    with PackWriter(pack) as writer:
        for at in range(episodes):
            address = writer.append(f"{at:07}.mcap", texts[at % KINDS], mtime=1_700_000_000)
            names.append(address.relative_to(pack).as_posix())
    kinds = [episode_row(Recording(path)) for path in made]
    stamp = {"mtime": 1_700_000_000 * 10**9}
    rows = (
        {"path": name, "size": len(texts[at % KINDS]), **stamp, **kinds[at % KINDS]}
        for at, name in enumerate(names)
    )
    Catalog(pack)._write(table_of(rows).sort_by("path"))


def speed(made: list[Path], pack: Path, folder: Path, options: argparse.Namespace) -> Iterator[Row]:
    """Two trainers that take turns."""
    logs = listed([pack], monitor=Monitor())
    env = logs.env(0)
    settings = load_settings(assignments=["loop.evaluate_every=0"])
    group = tuple(
        Logged(str(path), hashlib.sha256(path.read_bytes()).hexdigest(), 1) for path in made
    )
    some = read(group).columns
    times = len(logs) // KINDS
    every = Columns(
        {
            name: np.tile(column, (times, *[1] * (column.ndim - 1)))
            for name, column in some.steps.items()
        },
        np.tile(some.final, (times, 1)),
        np.tile(some.length, times),
    )
    stream = stream_of(logs, memory=TrainPlan(memory=options.memory).window, jobs=0, seed=0)
    trainers = {
        "memory": Trainer(learning_task(env), settings, folder=folder / "a", logs=every),
        "window": Trainer(learning_task(env), settings, folder=folder / "b", logs=stream),
    }
    began, readers = time.perf_counter(), sum(os.times()[2:4])
    for trainer in trainers.values():
        trainer._update(TURN)
    yield "first fill of the window", time.perf_counter() - began, "s"
    clock, cpu = dict.fromkeys(trainers, 0.0), dict.fromkeys(trainers, 0.0)
    for turn in range(options.rounds):
        for name in (*trainers,) if turn % 2 else reversed((*trainers,)):
            at, of = time.perf_counter(), time.process_time()
            trainers[name]._update(TURN)
            clock[name] += time.perf_counter() - at
            cpu[name] += time.process_time() - of
    stream.close()
    window = stream.window
    yield "transitions in memory", len(every.steps["state"]), ""
    yield "transitions in the window", len(window), ""
    yield "transitions that passed through it meanwhile", window.total - window.slots, ""
    updates = options.rounds * TURN
    yield "updates a second, in memory", updates / clock["memory"], "1/s"
    yield "updates a second, window", updates / clock["window"], "1/s"
    yield "window against memory, on the clock", clock["memory"] / clock["window"], "×"
    yield "window against memory, processor of this process", cpu["memory"] / cpu["window"], "×"
    spent = sum(os.times()[2:4]) - readers
    yield "processor of the readers, the first fill included", spent, "s"
    yield "load of the machine meanwhile", os.getloadavg()[0], ""


def memory(pack: Path, folder: Path, options: argparse.Namespace) -> Iterator[Row]:
    """The command, watched."""
    command = [sys.executable, "-m", "coordlog.cli", "train", "--from", str(pack)]
    command += ["--memory", options.memory, "--updates", str(options.updates), "--eval-every", "0"]
    process = subprocess.Popen([*command, "--out", str(folder / "run")])
    peak = largest = 0.0
    while process.poll() is None:
        each = [resident(pid) for pid in family(process.pid)]
        peak, largest = max(peak, sum(each)), max(largest, *each)
        time.sleep(0.2)
    assert process.returncode == 0, process.returncode
    said = json.loads((folder / "run" / "run.json").read_text())
    yield "episodes", said["window"]["episodes"], ""
    yield "transitions", said["window"]["of"], ""
    yield "transitions in the window", said["window"]["transitions"], ""
    yield "peak memory of the largest process", largest / 1e9, "GB"
    yield "peak memory of all processes", peak / 1e9, "GB"


def family(pid: int) -> list[int]:
    """A process and all that it has begun."""
    found = [pid]
    for each in found:
        for path in Path(f"/proc/{each}/task").glob("*/children"):
            try:
                found += map(int, path.read_text().split())
            except OSError:
                continue
    return found


def resident(pid: int) -> float:
    """Resident memory [bytes]; 0 of one that has ended."""
    try:
        pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    except (OSError, ValueError):
        return 0.0
    return float(pages * os.sysconf("SC_PAGE_SIZE"))


if __name__ == "__main__":
    main()
