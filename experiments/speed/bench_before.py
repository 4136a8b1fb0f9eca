"""Processor time of what both trees can do, this tree against another one, in one run.

    git worktree add ../before 3a60418 --detach
    python -m experiments.speed.bench_before LOGS --before ../before --now V2LOGS

One process for each tree, warm, one thread; they take turns, `--rounds` times, so that whatever else
the machine does hits both, and the least disturbed turn of each counts. LOGS are episodes that the
other tree wrote, V2LOGS the same ones as this tree records them, under names that start alike. A
line for each log smoothed, then one for each other thing, and the sizes of the files.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from pathlib import Path
from statistics import median

HERE = Path(__file__).parents[2]
WORKER = """
import json, sys, tempfile, time
from pathlib import Path
import numpy as np
try:
    from coordlog.smooth.batch import Job, smooth_file
    from coordlog.policies.noise import Random
    from coordlog.sim.rollout import rollout
    from coordlog.tasks.scene import find
except ImportError:
    from coordlog.commands.smoothing import Job, smooth_file
    from coordlog.sim.policies import Random
    from coordlog.rollout import rollout
    from coordlog.sim.scene import find
from coordlog.record.dataset import open as open_logs
from coordlog.record.reader import read_attachments, read_episode
from coordlog.record.recorder import Recorder
from coordlog.record.writer import write_episode
from coordlog.sim.env import BatchEnv

OUT = Path(tempfile.mkdtemp())
SETTINGS = {"method": "local", "cutoff": "max", "max_deviation": None, "clearance": 0.005}
POLICY = {"kind": "random", "name": "random", "checkpoint_sha256": "", "noise": {}}
kept = {}

def smooth(source):
    target = OUT / Path(source).name
    target.unlink(missing_ok=True)
    return smooth_file(Job(Path(source), target, SETTINGS, True, False))["cpu"]

def columns(source):
    for i in range(20):
        path = OUT / "many" / f"{i}.mcap"
        path.parent.mkdir(exist_ok=True)
        if not path.exists():
            path.write_bytes(Path(source).read_bytes())
    return timed(lambda: open_logs(OUT / "many").to_table())

def stepping(kind):
    env = kept.setdefault("env", BatchEnv(find("table"), n=16, threads=1))
    policy = Random(env.n, len(env.task.servos), sigma=0.4)
    def play(env):
        for step, _ in enumerate(rollout(env, policy, range(10**6), seed=0)):
            if step == 60:
                return
    if kind == "off":
        return timed(lambda: play(env))
    def recorded():
        with tempfile.TemporaryDirectory() as folder:
            with Recorder(env, Path(folder), policy=POLICY, display=kind == "display") as recorder:
                play(recorder)
    return timed(recorded)

def update(tasks):
    if "update" not in kept:
        import torch
        torch.set_num_threads(1)
        from coordlog.train.digrad import Batch, Learner
        from coordlog.train.gradients import gradient_mask
        from coordlog.train.settings import PRESETS
        arms = {"left": list(range(9)), "right": [0, 1, 2, 3, 4, 9, 10, 11, 12]}
        preset, mask, bounds = PRESETS["default"], gradient_mask(arms, 13), (-60.0, 30.0)
        try:
            learner = Learner(39, mask, preset, bounds=bounds)
        except TypeError:
            learner = Learner(39, mask, network=preset.network, config=preset.learner,
                              bounds=bounds, seed=0)
        def numbers(width):
            return torch.rand(256, width) * 2 - 1
        ones = torch.ones(256, 1)
        batch = Batch(numbers(39), numbers(13), numbers(2), numbers(39), 0.98 * ones, ones, numbers(13))
        kept["update"] = lambda: [learner.update(batch, behaviour_weight=1.0) for _ in range(20)]
    return timed(kept["update"])

def batch(rows):
    if "batch" not in kept:
        try:
            from experiments.speed.bench_train import epoch, mapped
            from coordlog.train.transitions import Transitions
            store_of = Transitions.of_logs
        except ImportError:
            from bench.bench_train import epoch, mapped
            from coordlog.train.logs import LogReplay as store_of
        store = store_of(mapped(OUT, 150_000), lambda distance, *flags: -distance)
        rows = np.random.default_rng(0).permutation(150_000)[: 200 * 256]
        kept["batch"] = lambda: epoch(store, rows)
    return timed(kept["batch"])

def trajectory(what):
    scene, policy, part = what.split("|")
    try:
        from experiments import actors, case, evaluate, safe
    except ImportError:
        from results import actors, case, evaluate, safe
    if scene not in kept:
        env = evaluate.environment(scene, policy, radius=0.03, torso="free", envs=1, threads=1)
        kept[scene] = env, actors.actor(policy, env)[0]
    env, act = kept[scene]
    found = [safe.safe(env, case.case(env, i), [act], physics=False).cpu for i in range(4)]
    return sum(sum(cpu.values()) if part == "whole" else cpu[part] for cpu in found)

def timed(call):
    began = time.process_time()
    call()
    return time.process_time() - began

for line in sys.stdin:
    name, argument = json.loads(line)
    print(json.dumps(globals()[name](argument)), flush=True)
"""


class Worker:
    """A warm process that runs the code of one tree."""

    def __init__(self, tree: Path) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-c", WORKER],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            cwd=tree,  # whose modules come before all others
            env=os.environ | {"PYTHONPATH": str(tree.resolve()), "OMP_NUM_THREADS": "1"},
        )

    def seconds(self, name: str, argument: object) -> float:
        """Processor time of one of its functions."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(json.dumps([name, str(argument)]) + "\n")
        self._process.stdin.flush()
        return float(json.loads(self._process.stdout.readline()))

    def close(self) -> None:
        """End the process."""
        assert self._process.stdin is not None
        self._process.stdin.close()
        self._process.wait()


def main() -> None:
    """Compare everything."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", 1)[0])
    parser.add_argument("logs", type=Path)
    parser.add_argument("--before", type=Path, required=True, help="checkout to compare with")
    parser.add_argument("--now", type=Path, required=True)
    parser.add_argument("--rounds", type=int, default=5)
    given = parser.parse_args()
    here = {key(path): path for path in given.now.resolve().rglob("*.mcap")}
    logs = sorted(given.logs.resolve().rglob("*.mcap"))
    pairs = [(path, here[key(path)]) for path in logs if key(path) in here]
    workers = Worker(given.before), Worker(HERE)
    ratios = [compare(workers, "smooth", pair, given.rounds) for pair in pairs]
    print(f"smooth: median of {len(ratios)} ratios {median(ratios):.3f}")
    compare(workers, "columns", pairs[0], given.rounds)
    for kind in ("off", "plain", "display"):
        compare(workers, "stepping", (kind, kind), given.rounds)
    compare(workers, "update", ("", ""), given.rounds)
    compare(workers, "batch", ("", ""), given.rounds)
    for scene in ("free", "table"):  # the same policy of the other tree on both sides
        policy = given.before.resolve() / "coordlog" / "policies" / f"{scene}.safetensors"
        for part in ("smooth", "whole"):
            what = f"{scene}|{policy}|{part}"
            compare(workers, "trajectory", (what, what), given.rounds)
    sizes = [sum(pair[side].stat().st_size for pair in pairs) for side in (0, 1)]
    print(f"{'sizes':9} {sizes[0]:9} B {sizes[1]:9} B {sizes[1] / sizes[0]:6.3f}")
    for worker in workers:
        worker.close()


def key(path: Path) -> str:
    """Scene, split, seed and index of a recorded file, without the run's own digits."""
    return path.stem.rpartition("-")[0]


def compare(
    workers: tuple[Worker, Worker], name: str, pair: tuple[object, object], rounds: int
) -> float:
    """Print and return the ratio, each side at its least disturbed; the first turn warms up."""
    turns = [
        [worker.seconds(name, argument) for worker, argument in zip(workers, pair, strict=True)]
        for _ in range(rounds + 1)
    ]
    was, now = (min(turn[side] for turn in turns[1:]) for side in (0, 1))
    what = getattr(pair[1], "name", pair[1])
    print(f"{name:9} {1e3 * was:8.1f} ms {1e3 * now:8.1f} ms {now / was:6.3f} {what}", flush=True)
    return now / was


if __name__ == "__main__":
    main()
