"""The same answers from a cluster, also where a worker dies, and what it gains.

    python experiments/speed/bench_cluster.py [--files 200] [--smooth 4] [--json FILE]

A local Ray cluster of one and of two workers, started and stopped here; it asks for a secret that
only its processes know. A worker that smooths kills its own process half-way; the bytes must be those of a loop
without Ray. Efficiency is the time of one worker over twice the time of two, `check --level
content` on copies of the tests' episodes. By hand: a cluster takes some ten seconds to start.
"""

from __future__ import annotations

import argparse
import json
import os
import secrets
import shutil
import signal
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

from coordlog.parallel import batches, mapped
from coordlog.smooth.batch import Job, smooth_file
from coordlog.verify.levels import check_files

ROOT = Path(__file__).parents[2]
EPISODES = sorted((ROOT / "tests" / "data" / "v1").glob("*/*.mcap"))
SETTINGS = {"method": "local", "cutoff": "max", "max_deviation": None, "clearance": 0.005}


def main() -> None:
    """Measure both."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--files", type=int, default=200)
    parser.add_argument("--smooth", type=int, default=4)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="coordlog-bench-") as name:
        found = {"killed": killed(Path(name), options.smooth), **gain(Path(name), options.files)}
    for key, value in found.items():
        print(f"{key:40} {value}")
    if options.json:
        options.json.write_text(json.dumps(found, indent=2))


def killed(folder: Path, n: int) -> str:
    """Smooth with and without Ray; one worker dies once."""
    chosen = [path for path in EPISODES if path.parent.name in ("free", "table")][:n]
    alone = [Job(path, folder / "alone" / path.name, SETTINGS, True, False) for path in chosen]
    there = [Job(path, folder / "ray" / path.name, SETTINGS, True, False) for path in chosen]
    rows = list(mapped(smooth_file, alone, jobs=1))
    with cluster(2):
        again = list(mapped(partial(dying, marker=folder / "died"), there, jobs="ray"))
    assert (folder / "died").exists(), "no worker has died"
    assert [row["status"] for row in again] == [row["status"] for row in rows]
    for first, second in zip(alone, there, strict=True):
        assert first.target.read_bytes() == second.target.read_bytes(), first.target.name
    return f"{n} smoothed episodes, byte for byte as without Ray, a worker killed once"


def dying(job: Job, *, marker: Path) -> Any:
    """Smooth an episode; the first time that anybody gets here, die afterwards."""
    row = smooth_file(job)
    try:
        marker.touch(exist_ok=False)
    except FileExistsError:
        return row
    os.kill(os.getpid(), signal.SIGKILL)
    return row


def gain(folder: Path, n: int) -> dict[str, float]:
    """Time of `check` with one worker and with two."""
    (folder / "logs").mkdir()
    logs = [
        Path(shutil.copy(EPISODES[i % len(EPISODES)], folder / "logs" / f"{i:05}.mcap"))
        for i in range(n)
    ]
    times = {}
    for workers in (1, 2):
        with cluster(workers):
            work = batches(logs, 10)
            list(mapped(_checked, work[:workers], jobs="ray"))  # processes start, modules load
            began = time.perf_counter()
            answers = list(mapped(_checked, work, jobs="ray"))
            times[workers] = time.perf_counter() - began
        assert sum(answers) == n
    return {
        "one worker [s]": round(times[1], 2),
        "two workers [s]": round(times[2], 2),
        "efficiency": round(times[1] / (2 * times[2]), 3),
        "load of the machine meanwhile": round(os.getloadavg()[0], 1),
    }


def _checked(paths: Sequence[Path]) -> int:
    answer = check_files(list(paths), level="content")
    assert answer.findings == []
    return answer.files


@contextmanager
def cluster(workers: int) -> Iterator[None]:
    """A Ray cluster of this machine with some workers, which `mapped` then uses."""
    os.environ |= {"RAY_USAGE_STATS_ENABLED": "0", "RAY_AUTH_MODE": "token"}
    os.environ.setdefault("RAY_AUTH_TOKEN", secrets.token_hex(32))  # read when Ray is loaded
    import ray

    quiet: dict[str, Any] = {"logging_level": "ERROR", "log_to_driver": False}
    ray.init("local", num_cpus=workers, include_dashboard=False, **quiet)
    try:
        yield
    finally:
        ray.shutdown()


if __name__ == "__main__":
    main()
