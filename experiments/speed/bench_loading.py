"""What many logs cost to learn from: loading them cold and warm, and the memory of training from 10
000 episodes and 1.5 M steps.

    python experiments/speed/bench_loading.py [--logs FOLDER] [--episodes 2000] [--large 10000]
    [--steps 1500000] [--json FILE]

Logs are multiplied: each copy is written by our writer with an id of its own, so that all files and
all digests differ. Training is the command, in a process of its own, over the whole path: files,
cache, columns, replay, updates. Its memory is the peak resident set of the largest process, mapped
pages included; copies lie in a temporary folder, and the large set needs about 1 GB there.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import chain, cycle, islice
from pathlib import Path

from coordlog.parallel import batches, mapped
from coordlog.record.cache import load
from coordlog.record.dataset import find_files
from coordlog.record.reader import read_attachments, read_episode, read_summary
from coordlog.record.writer import write_episode

WARM = 5
UPDATES = 300
Row = dict[str, float | str]
Job = tuple[Path, int]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--logs", type=Path, help="folder of logs of one scene; 128 are recorded if there is none"
    )
    parser.add_argument("--episodes", type=int, default=2000)
    parser.add_argument("--large", type=int, default=10_000)
    parser.add_argument("--steps", type=int, default=1_500_000)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    found: list[Row] = []
    with tempfile.TemporaryDirectory(prefix="coordlog-bench-") as name:
        folder = Path(name)
        logs = options.logs or recorded(folder / "logs")
        for row in chain(
            loading(logs, folder, options.episodes),
            training(logs, folder, options.large, options.steps),
        ):
            print(
                f"{row['what']:72} {row['value']:12.3f} {row['unit']:5} {row['target']}", flush=True
            )
            found.append(row)
    if options.json:
        options.json.write_text(json.dumps(found, indent=1))


def row(what: str, value: float, unit: str, target: str = "") -> Row:
    return {"what": what, "value": value, "unit": unit, "target": target}


def coordlog(*args: str | Path, cache: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "coordlog.cli", *map(str, args)]
    return subprocess.run(
        command,
        check=True,
        capture_output=True,
        text=True,
        env={**os.environ, "XDG_CACHE_HOME": str(cache)},
    )


def recorded(folder: Path) -> Path:
    coordlog(
        "record",
        "--scene",
        "free",
        "--episodes",
        "128",
        "--noise",
        "0.3",
        "--out",
        folder,
        cache=folder,
    )
    return folder


# copies


def multiplied(logs: Path, folder: Path, *, episodes: int, steps: int) -> int:
    """Copies of logs until there are so many episodes and steps; returns the steps."""
    sources = find_files(logs).paths
    lengths = [read_summary(path).result.length for path in sources]
    count, total = 0, 0
    for length in cycle(lengths):
        if count >= episodes and total >= steps:
            break
        count, total = count + 1, total + length
    folder.mkdir()
    jobs = list(islice(enumerate(cycle(sources)), count))
    for _ in mapped(partial(copy, folder), batches([(path, i) for i, path in jobs], 250), jobs=0):
        pass
    return total


def copy(folder: Path, jobs: Sequence[Job]) -> None:
    for path, number in jobs:
        episode = read_episode(path)
        header = replace(episode.header, episode={**episode.header.episode, "id": f"{number:016x}"})
        target = folder / f"{number:06d}.mcap"
        write_episode(
            target,
            replace(episode, header=header),
            attachments=read_attachments(path),
            display=False,
        )


# loading


def loading(logs: Path, folder: Path, episodes: int) -> Iterator[Row]:
    steps = multiplied(logs, folder / "some", episodes=episodes, steps=0)
    paths = find_files(folder / "some").paths
    size = sum(path.stat().st_size for path in paths)

    def timed() -> float:
        began = time.perf_counter()
        logs = load(paths, folder / "columns", run=partial(mapped, jobs=0))
        seconds = time.perf_counter() - began
        if (len(logs), logs.steps.num_rows) != (len(paths), steps):
            raise SystemExit(
                f"expected {len(paths)} episodes of {steps} steps, loaded {len(logs)} of {logs.steps.num_rows}"
            )
        return seconds

    cold, warm = timed(), statistics.median(timed() for _ in range(WARM))
    said = f"{len(paths):,} episodes, {steps:,} steps, {size / 1e6:,.0f} MB"
    yield row(f"cold, every file decoded: {said}", cold, "s")
    yield row("warm, from the cache: files are only hashed", warm, "s")
    yield row("cold against warm", cold / warm, "x")
    yield row("cold, for one step", cold / steps * 1e6, "us")


# training


def training(logs: Path, folder: Path, episodes: int, steps: int) -> Iterator[Row]:
    total = multiplied(logs, folder / "many", episodes=episodes, steps=steps)
    count = len(find_files(folder / "many").paths)
    for name in ("cold", "warm"):
        args = (
            "train",
            "--from",
            folder / "many",
            "--updates",
            str(UPDATES),
            "--eval-every",
            "0",
            "--out",
            folder / name,
        )
        began = time.perf_counter()
        peak = measured(args, folder)
        seconds = time.perf_counter() - began
        said = f"{count:,} episodes, {total:,} steps, {name}"
        yield row(f"peak resident memory of training from {said}", peak, "GB", "< 4")
        yield row(f"{UPDATES} updates from {said}, whole command", seconds, "s")


def measured(args: Sequence[str | Path], folder: Path) -> float:
    """Run the command in a process that reports its own peak (VmHWM) and the greatest of its
    workers; the greater one [GB].
    """
    code = (
        "import atexit, resource, sys\n"
        "def tell():\n"
        "    status = open('/proc/self/status').read()\n"
        "    workers = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss\n"
        "    print('PEAK', status.split('VmHWM:')[1].split()[0], workers, file=sys.stderr)\n"
        "if __name__ == '__main__':\n"
        "    atexit.register(tell)\n"
        "    from coordlog.cli import main\n"
        "    main()\n"
    )
    script = folder / "measured.py"
    script.write_text(code)
    environment = {**os.environ, "XDG_CACHE_HOME": str(folder / "cache")}
    done = subprocess.run(
        [sys.executable, str(script), *map(str, args)],
        check=True,
        capture_output=True,
        text=True,
        env=environment,
    )
    found = re.search(r"PEAK (\d+) (\d+)", done.stderr)
    assert found is not None, done.stderr
    return max(int(kilobytes) for kilobytes in found.groups()) / 1024**2


if __name__ == "__main__":
    main()
