"""What simulating beside the updates is worth: steps/s of live training against the same loop run
in sequence, recording included.

    python experiments/speed/bench_overlap.py [--scene free] [--envs 32] [--steps 2048] [--rounds 3]
    [--json FILE]

Two ratios of updates to steps: the preset's, and the one at which both stages cost the same, where
overlapping can be worth most (2 x). The bound is what two stages without any friction would reach:
(simulation + updates) / the longer one, both timed in the sequential loop. Variants take turns and
the median of the rounds' own ratios counts. Two free cores are needed: the load average is printed
beside.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from coordlog.api.practice import record_training
from coordlog.episode import Array
from coordlog.sim.env import BatchEnv
from coordlog.tasks.scene import find
from coordlog.train.bind import FARTHEST, learning_task
from coordlog.train.columns import Block
from coordlog.train.live import Simulations
from coordlog.train.loop import Trainer
from coordlog.train.settings import Settings, load_settings


class Timed(Simulations):
    """Simulations that count the seconds they take."""

    seconds = 0.0

    def collect(self, steps: int, policy: Callable[[Array], Array]) -> Block:
        began = time.perf_counter()
        block = super().collect(steps, policy)
        self.seconds += time.perf_counter() - began
        return block


class Run(NamedTuple):
    seconds: float
    simulating: float
    updates: int
    steps: int
    result: bytes


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--scene", default="free")
    parser.add_argument("--envs", type=int, default=32)
    parser.add_argument("--steps", type=int, default=2048)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    default = load_settings().loop.updates_per_step
    rows, first = measure(options, default, "the preset's ratio")
    simulation, update = (
        first.simulating / first.steps,
        (first.seconds - first.simulating) / first.updates,
    )
    more, _ = measure(options, simulation / update, "stages of equal cost")
    if options.json:
        options.json.write_text(json.dumps([*rows, *more], indent=1))


def measure(
    options: argparse.Namespace, ratio: float, name: str
) -> tuple[list[dict[str, float | str]], Run]:
    """Rows for one ratio of updates to steps, and a sequential run at it."""
    runs: dict[str, list[Run]] = {"true": [], "false": []}
    load = os.getloadavg()[0]
    for _ in range(options.rounds):
        for overlap, found in runs.items():
            found.append(train(options, ratio, overlap))
    if len({run.result for found in runs.values() for run in found}) != 1:
        raise SystemExit("overlap and sequence do not give the same weights")
    sequence = runs["false"]
    middle = sorted(sequence, key=lambda run: run.seconds)[len(sequence) // 2]
    updating = middle.seconds - middle.simulating
    speed = statistics.median(
        one.seconds / other.seconds for one, other in zip(sequence, runs["true"], strict=True)
    )
    rows: list[dict[str, float | str]] = []

    def row(what: str, value: float, unit: str, target: str = "") -> None:
        rows.append({"what": what, "ratio": name, "value": value, "unit": unit, "target": target})
        print(f"{name + ': ' + what:72} {value:9.3f} {unit:8} {target}", flush=True)

    row("updates per step", ratio, "")
    row("a simulated and recorded step", middle.simulating / middle.steps * 1e6, "us")
    row("an update", updating / middle.updates * 1e3, "ms")
    row("in sequence", middle.steps / middle.seconds, "steps/s")
    row("overlapped", statistics.median(run.steps / run.seconds for run in runs["true"]), "steps/s")
    row("bound of the ratio below", middle.seconds / max(updating, middle.simulating), "x")
    row(
        "overlapped against in sequence, same weights",
        speed,
        "x",
        "≥ 1.4 where the bound allows it",
    )
    row("load average at the start", load, "")
    return rows, middle


def train(options: argparse.Namespace, ratio: float, overlap: str) -> Run:
    """A run of its own from the same seed."""
    settings = settings_of(options.steps, ratio, overlap)
    env = BatchEnv(find(options.scene), n=options.envs, threads=max(1, (os.cpu_count() or 2) - 1))
    with (
        tempfile.TemporaryDirectory() as folder,
        record_training(env, Path(folder), run="") as recorder,
    ):
        source = Timed(recorder, seed=0, k=env.layout.k, farthest=FARTHEST * env.scene.robot.reach)
        trainer = Trainer(
            learning_task(env.describe()), settings, folder=Path(folder), source=source
        )
        began = time.perf_counter()
        outcome = trainer.run()
        seconds = time.perf_counter() - began
        weights = trainer.learner.actor.arrays()
    return Run(
        seconds,
        source.seconds,
        outcome.updates,
        outcome.steps,
        b"".join(array.tobytes() for array in weights.values()),
    )


def settings_of(steps: int, ratio: float, overlap: str) -> Settings:
    whole = (
        "loop.updates=0",
        f"loop.steps={steps}",
        "loop.evaluate_every=0",
        "replay.warmup=256",
        "replay.capacity=100000",
    )
    return load_settings(
        assignments=(*whole, f"loop.updates_per_step={ratio!r}", f"loop.overlap={overlap}")
    )


if __name__ == "__main__":
    main()
