"""Processor time of `coordlog smooth` for one file, this tree against another one.

    git worktree add ../before 3a60418 --detach
    OMP_NUM_THREADS=1 python experiments/speed/bench_smooth_files.py LOGS --before ../before

One worker process for each tree, both warm; every log is smoothed by one and then by the other,
`--rounds` times, so that whatever else the machine does hits both. LOGS must be files that both
trees read; or `--now FOLDER` has the same episodes as this tree records them, under names that
start alike. A line for each log and the median of the ratios.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from statistics import median

HERE = Path(__file__).parents[2]
WORKER = """
import json, sys, time
from pathlib import Path
try:
    from coordlog.smooth.batch import Job, smooth_file
except ImportError:
    from coordlog.commands.smoothing import Job, smooth_file
settings = {"method": "local", "cutoff": "max", "max_deviation": None, "clearance": 0.005}
for line in sys.stdin:
    source, target = json.loads(line)
    Path(target).unlink(missing_ok=True)
    row = smooth_file(Job(Path(source), Path(target), settings, True, False))
    print(json.dumps([row["cpu"], row["status"]]), flush=True)
"""


class Worker:
    """A warm process that smooths with the code of one tree."""

    def __init__(self, tree: Path, out: Path) -> None:
        self._out = out
        out.mkdir(parents=True)
        self._process = subprocess.Popen(
            [sys.executable, "-c", WORKER],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            cwd=out,
            env=os.environ | {"PYTHONPATH": str(tree.resolve()), "OMP_NUM_THREADS": "1"},
        )

    def smooth(self, source: Path) -> tuple[float, str]:
        """Seconds of processor time, and the status."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        line = json.dumps([str(source.resolve()), str((self._out / source.name).resolve())])
        self._process.stdin.write(line + "\n")
        self._process.stdin.flush()
        cpu, status = json.loads(self._process.stdout.readline())
        return cpu, status

    def close(self) -> None:
        """End the process."""
        assert self._process.stdin is not None
        self._process.stdin.close()
        self._process.wait()


def main() -> None:
    """Compare on every log."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("logs", type=Path, help="folder of episodes that both trees read")
    parser.add_argument("--before", type=Path, required=True, help="checkout to compare with")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--now", type=Path, help="the same episodes for this tree")
    arguments = parser.parse_args()
    sources = [(path, path) for path in sorted(arguments.logs.rglob("*.mcap"))]
    if arguments.now is not None:
        here = {key(path): path for path in arguments.now.rglob("*.mcap")}
        sources = [(path, here[key(path)]) for path, _ in sources if key(path) in here]
    with tempfile.TemporaryDirectory() as folder:
        before, after = Worker(arguments.before, Path(folder, "b")), Worker(HERE, Path(folder, "a"))
        for was, now in sources[:2]:  # the first calls import and warm up
            before.smooth(was)
            after.smooth(now)
        ratios = [compare(pair, before, after, arguments.rounds) for pair in sources]
        before.close()
        after.close()
    print(
        f"median of the ratios {median(ratios):.3f}, n = {len(ratios)}, from "
        f"{min(ratios):.3f} to {max(ratios):.3f}"
    )


def key(path: Path) -> str:
    """Scene, split, seed and index of a recorded file, without the run's own digits."""
    return path.stem.rpartition("-")[0]


def compare(sources: tuple[Path, Path], before: Worker, after: Worker, rounds: int) -> float:
    """Print and return the ratio for one log, each side at its least disturbed."""
    source = sources[0]
    pairs = [(before.smooth(source), after.smooth(sources[1])) for _ in range(rounds)]
    was, now = (min(each[side][0] for each in pairs) for side in (0, 1))
    print(
        f"{source.name:44s} {1e3 * was:6.0f} ms {pairs[0][0][1]:14s} {1e3 * now:6.0f} ms "
        f"{pairs[0][1][1]:14s} {now / was:6.3f}",
        flush=True,
    )
    return now / was


if __name__ == "__main__":
    main()
