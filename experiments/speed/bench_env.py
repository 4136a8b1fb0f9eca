"""What a step of the environment and its recording cost, as ratios measured in one run.

    python -m experiments.speed.bench_env [--rounds 60] [--episodes 96] [--json FILE]

Environment against bare MuJoCo: the bare batch gets the environment's state before every turn and,
where the robot moves, the same servo targets at every substep, so both do the same physics to the
last bit; they take turns on one thread, and the median of the pairs counts. Recording: whole runs
of the same episodes, with and without, in turns.
"""

from __future__ import annotations

import statistics
import tempfile
import time
from collections.abc import Iterator
from functools import partial
from itertools import count
from pathlib import Path

import numpy as np
from mujoco.batch import Batch

from coordlog.episode import Array
from coordlog.policies.noise import Random, RandomConfig
from coordlog.record.recorder import Recorder
from coordlog.sim.env import BatchEnv
from coordlog.sim.rollout import rollout
from coordlog.tasks.scene import find
from experiments.speed.clock import Row, options, show, turns

N = 64
POLICY = {"kind": "random", "name": "random", "checkpoint_sha256": "", "noise": {}}


def main() -> None:
    """Measure both."""
    given = options(__doc__, rounds=60, episodes=96)
    show(rows(given.rounds, given.episodes), given.json)


def rows(rounds: int, episodes: int) -> Iterator[Row]:
    """Stepping at rest and moving, then recording."""
    for name, sigma in (("table", 0.0), ("free", 0.4), ("table", 0.4), ("spheres", 0.4)):
        yield stepping(name, rounds, sigma=sigma)
    yield from recording(episodes)


def stepping(name: str, rounds: int, *, sigma: float) -> Row:
    """Control steps of the environment per bare stepping of as many substeps, 64 simulations.

    Random actions, or none at sigma 0.
    """
    env = BatchEnv(find(name), n=N, threads=1)
    bare, substeps, ids = Batch(env.task.model, N, 1), env.task.substeps, np.arange(N)
    problems = (env.problem(seed=0, split="train", index=index) for index in count())
    policy = Random(N, len(env.task.servos), RandomConfig(sigma=sigma))
    share = (np.arange(substeps) + 1.0)[:, None] / substeps

    def start(some: Array) -> None:
        env.reset(some, [next(problems) for _ in some])
        policy.begin(some, env.state[some], [np.random.default_rng(int(slot)) for slot in some])
        if env.task.n_spheres:
            radii = env.simulation.radii[some]
            bare.expand("geom_size")[some[:, None], env.task.sphere_geoms, 0] = radii
            bare.set_const(some)

    start(ids)
    speeds = []
    for _ in range(rounds):
        action, before = policy.act(ids, env.state), env.physics.ctrl[:, None].copy()
        bare.state[:] = env.physics.rows
        began = time.process_time()
        outcome = env.step(action, ids)
        ours = time.process_time() - began
        control = before + (env.physics.ctrl[:, None] - before) * share
        began = time.process_time()
        if sigma:
            bare.rollout(substeps, control=control, record=())
        else:
            bare.step(nstep=substeps)
        speeds.append((time.process_time() - began) / ours)
        assert np.array_equal(bare.state, env.physics.rows), "the bare batch did other physics"
        over = np.flatnonzero(outcome.terminated | outcome.truncated | outcome.diverged)
        if len(over):
            start(over)
    what = f"env step / bare batch, speed ({name} {'moving' if sigma else 'at rest'})"
    return Row(what, statistics.median(speeds), target="≥ 1.0")


def recording(episodes: int) -> list[Row]:
    """Whole runs of the same random episodes of `table`: not recorded, recorded, recorded with
    display topics.
    """
    env = BatchEnv(find("table"), n=N, threads=1)
    kinds = ("off", "display off", "display on")
    taken = turns({kind: partial(play, env, kind, episodes) for kind in kinds})
    return [
        Row(
            f"recording ({kind}) / not recording, time, {N} simulations",
            statistics.median(a / b for a, b in zip(taken[kind], taken["off"], strict=True)),
            target="≤ 1.03",
        )
        for kind in kinds[1:]
    ]


def play(env: BatchEnv, kind: str, episodes: int) -> None:
    """Run random episodes; unless `kind` is "off" each becomes a file. Most last to the end, many
    touch the table.
    """
    policy = Random(env.n, len(env.task.servos), RandomConfig(sigma=0.4))
    if kind == "off":
        for _ in rollout(env, policy, range(episodes), seed=0):
            pass
        return
    with tempfile.TemporaryDirectory() as name:
        shown = kind == "display on"
        with Recorder(env, Path(name), policy=POLICY, display=shown) as recorder:
            for _ in rollout(recorder, policy, range(episodes), seed=0):
                pass


if __name__ == "__main__":
    main()
