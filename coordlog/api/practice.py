"""The live steps of a training run: an environment that records, here or in another process."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from coordlog.record.beside import keep
from coordlog.record.recorder import Recorder
from coordlog.sim.making import make_env
from coordlog.tasks.scene import Scene
from coordlog.train.bind import FARTHEST
from coordlog.train.collectors import Collector
from coordlog.train.live import Simulations

if TYPE_CHECKING:
    from coordlog.episode import Json
    from coordlog.sim.env import BatchEnv


def record_training(env: BatchEnv, folder: Path, *, run: str) -> Recorder:
    """The live environment, recorded into the run folder."""
    policy = {
        "kind": "digrad",
        "name": "learner",
        "checkpoint_sha256": "",
        "noise": {"kind": "gaussian", "schedule": "noise in run.json"},
    }
    keep(folder, env.looks.meshes)
    return Recorder(env, folder / "episodes" / "train", policy=policy, display=False, run=run)


class Practice(NamedTuple):
    """What live steps are taken in and recorded as; made again in the process of a collector."""

    scene: Scene
    tables: dict[str, Any]
    start: str
    lanes: tuple[int, ...]
    """Simulations of each collector"""
    like: Json
    folder: Path
    name: str
    """What the recordings carry"""
    seed: int
    k: int
    """Number of arms"""

    def env(self, envs: int) -> BatchEnv:
        """The environment, with what makes training easier (section [train])."""
        threads = max(1, (os.cpu_count() or 2) - 1)
        return make_env(
            self.scene, self.tables, start=self.start, envs=envs, threads=threads, like=self.like
        )

    def simulations(self, env: Recorder, *, first: int = 0, stride: int = 1) -> Simulations:
        """The recorded environment as a source of transitions."""
        farthest = FARTHEST * self.scene.robot.reach
        return Simulations(
            env, seed=self.seed, k=self.k, farthest=farthest, first=first, stride=stride
        )


def collector(practice: Practice, at: int) -> Collector:
    """One of several collectors, in its own process or here."""
    env = practice.env(practice.lanes[at])
    recorder = record_training(env, practice.folder, run=practice.name)
    simulations = practice.simulations(recorder, first=at, stride=len(practice.lanes))
    return Collector(simulations, recorder)
