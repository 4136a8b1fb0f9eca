"""The planar arm with three end effectors learns from nothing to reach all of its goals at once."""

from __future__ import annotations

from pathlib import Path

import torch

from coordlog.sim.env import BatchEnv
from coordlog.sim.scoring import evaluate, figures
from coordlog.tasks.config import EnvConfig, RewardConfig
from coordlog.tasks.scene import find
from coordlog.train.bind import FARTHEST, learning_task
from coordlog.train.live import Simulations
from coordlog.train.loop import Trainer
from coordlog.train.settings import load_settings

SETTINGS = (
    "network.hidden=[96, 96]",
    "learner.gamma=0.95",
    "behaviour.effort=0.0",
    "replay.batch=128",
    "replay.warmup=2000",
    "loop.updates=0",
    "loop.steps=5200",
    "loop.updates_per_step=0.25",
    "loop.evaluate_every=0",
)


def test_the_planar_arm_is_learnt_live(tmp_path: Path) -> None:
    def simulations() -> BatchEnv:
        return BatchEnv(find("planar"), EnvConfig(), RewardConfig(), n=32, threads=1, start="stand")

    env, threads = simulations(), torch.get_num_threads()
    k, reach = env.layout.k, env.scene.robot.reach
    source = Simulations(env, seed=0, k=k, farthest=FARTHEST * reach)
    trainer = Trainer(
        learning_task(env.describe()),
        load_settings(assignments=SETTINGS),
        folder=tmp_path,
        source=source,
    )
    try:
        assert trainer.run().ending == "finished"
    finally:
        torch.set_num_threads(threads)
    found = figures(evaluate(simulations(), trainer.policy(), episodes=96, k=k, seed=0))
    assert k == 3
    assert found["success"] >= 0.6, "all three at once; 9,000 steps bring 79 %, 24,000 95 %"
