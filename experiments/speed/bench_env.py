"""What a step of the environment and its recording cost, as ratios measured in one run.

    python experiments/speed/bench_env.py [--rounds 60] [--episodes 96] [--short 5000] [--json FILE]

Environment against bare MuJoCo: the bare batch gets the environment's state before every turn and,
where the robot moves, the same servo targets at every substep, so both do the same physics to the
last bit; they take turns, and the median of the pairs counts.
Recording: whole runs of the same episodes, with and without, in turns; processor time, because on a
busy machine the wall clock mostly measures the others.
"""

from __future__ import annotations

import argparse
import gc
import json
import os
import statistics
import tempfile
import time
from collections.abc import Callable
from functools import partial
from itertools import count
from pathlib import Path

import numpy as np
from mujoco.batch import Batch

from coordlog.policies.noise import Random
from coordlog.record.recorder import Recorder
from coordlog.sim.env import BatchEnv
from coordlog.sim.rollout import rollout
from coordlog.tasks.config import EnvConfig
from coordlog.tasks.scene import find

N = 64
POLICY = {"kind": "random", "name": "random", "checkpoint_sha256": "", "noise": {}}

Row = dict[str, float | str]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--rounds",
        type=int,
        default=60,
        help="pairs of control steps per scene and number of threads",
    )
    parser.add_argument("--episodes", type=int, default=96, help="episodes per recorded run")
    parser.add_argument(
        "--short", type=int, default=5000, help="short episodes recorded to look at the memory"
    )
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    rows = [
        stepping(name, threads, options.rounds, sigma=sigma)
        for threads in sorted({1, os.cpu_count() or 1})
        for name, sigma in (("table", 0.0), ("free", 0.4), ("table", 0.4), ("spheres", 0.4))
    ]
    rows += [*recording(options.episodes), *memory(options.short)]
    for row in rows:
        print(f"{row['what']:64} {row['value']:9.3f} {row['unit']:9} {row['target']}")
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1))


def stepping(name: str, threads: int, rounds: int, *, sigma: float) -> Row:
    """Control steps of the environment per bare stepping of as many substeps, 64 simulations.

    Random actions, or none at sigma 0.
    """
    env = BatchEnv(find(name), n=N, threads=threads)
    bare, substeps, ids = Batch(env.task.model, N, threads), env.task.substeps, np.arange(N)
    problems = (env.problem(seed=0, split="train", index=index) for index in count())
    policy, share = (
        Random(N, len(env.task.servos), sigma=sigma),
        (np.arange(substeps) + 1.0)[:, None] / substeps,
    )

    def start(some: np.ndarray) -> None:
        env.reset(some, [next(problems) for _ in some])
        policy.begin(some, env.state[some], [np.random.default_rng(int(slot)) for slot in some])
        if env.task.n_spheres:
            bare.expand("geom_size")[some[:, None], env.task.sphere_geoms, 0] = (
                env.simulation.radii[some]
            )
            bare.set_const(some)

    start(ids)
    speeds = []
    for _ in range(rounds):
        action, before = policy.act(ids, env.state), env.physics.ctrl[:, None].copy()
        bare.state[:] = env.physics.rows
        began = time.perf_counter()
        outcome = env.step(action, ids)
        ours = time.perf_counter() - began
        control = before + (env.physics.ctrl[:, None] - before) * share
        theirs = (
            partial(bare.rollout, substeps, control=control, record=())
            if sigma
            else partial(bare.step, nstep=substeps)
        )
        speeds.append(timed(theirs, time.perf_counter) / ours)
        assert np.array_equal(bare.state, env.physics.rows), "the bare batch did other physics"
        over = np.flatnonzero(outcome.terminated | outcome.truncated | outcome.diverged)
        if len(over):
            start(over)
    label = f"{name} {'moving' if sigma else 'at rest'}, {threads} thread{'s' * (threads > 1)}"
    return {
        "what": f"env step / bare batch, speed ({label})",
        "value": statistics.median(speeds),
        "unit": "×",
        "target": "≥ 0.90",
    }


def timed(job: Callable[[], object], clock: Callable[[], float]) -> float:
    """Seconds that a job takes on a clock."""
    began = clock()
    job()
    return clock() - began


def recording(episodes: int, rounds: int = 5) -> list[Row]:
    """Whole runs of the same random episodes of `table`: not recorded, recorded, recorded with
    display topics.
    """
    env = BatchEnv(find("table"), n=N)
    times: dict[str, list[float]] = {"off": [], "on": [], "display": []}
    for _ in range(rounds):
        for kind, taken in times.items():
            gc.collect()
            with tempfile.TemporaryDirectory() as folder:
                taken.append(
                    timed(partial(play, env, kind, Path(folder), episodes), time.process_time)
                )
    off = times["off"]
    return [
        {
            "what": f"recording {label} / not recording, time, {N} simulations",
            "value": statistics.median(a / b for a, b in zip(times[kind], off, strict=True)),
            "unit": "×",
            "target": target,
        }
        for kind, label, target in (
            ("on", "(display off)", "≤ 1.05"),
            ("display", "(display on)", "≤ 1.05"),
        )
    ]


def play(env: BatchEnv, kind: str, folder: Path, episodes: int) -> None:
    """Run random episodes; unless `kind` is "off" each becomes a file."""
    policy = Random(
        env.n, len(env.task.servos), sigma=0.4
    )  # most episodes last to the end, many touch the table
    if kind == "off":
        for _ in rollout(env, policy, range(episodes), seed=0):
            pass
        return
    with Recorder(env, folder, policy=POLICY, display=kind == "display") as recorder:
        for _ in rollout(recorder, policy, range(episodes), seed=0):
            pass


def memory(episodes: int) -> list[Row]:
    """Growth of the resident memory while many short episodes are recorded, from a tenth of them to
    all.
    """
    env = BatchEnv(find("planar"), EnvConfig(max_steps=3), n=N)
    policy, sizes = Random(N, len(env.task.servos)), []
    with (
        tempfile.TemporaryDirectory() as folder,
        Recorder(env, Path(folder), policy=POLICY) as recorder,
    ):
        ended = 0
        for _, outcome in rollout(recorder, policy, range(episodes), seed=0):
            ended += int((outcome.terminated | outcome.truncated).sum())
            sizes.append((ended, resident()))
    early = next(size for count, size in sizes if count >= episodes / 10)
    late = max(size for _, size in sizes[len(sizes) // 2 :])
    return [
        {
            "what": f"memory from {episodes // 10} to {episodes} recorded episodes",
            "value": late - early,
            "unit": "MB",
            "target": "flat",
        }
    ]


def resident() -> float:
    """Resident memory of this process [MB]; Linux only."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


if __name__ == "__main__":
    main()
