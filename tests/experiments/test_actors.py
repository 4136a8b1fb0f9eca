"""A model of stable-baselines3 acts here as it does in its own environment."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from stable_baselines3 import TD3, HerReplayBuffer

from coordlog.sim.env import BatchEnv
from coordlog.sim.gym import GymEnv
from coordlog.sim.scoring import evaluate, figures
from coordlog.tasks.scene import find
from coordlog.train.metrics import read_metrics
from coordlog.train.settings import load_settings, surroundings
from experiments.actors import actor
from experiments.evaluate import environment
from experiments.scalar_peer import learn


def test_a_foreign_model_is_loaded_without_its_environment_and_acts_alike(tmp_path: Path) -> None:
    single = GymEnv("planar")
    model = TD3(
        "MultiInputPolicy",
        single,
        replay_buffer_class=HerReplayBuffer,
        buffer_size=100,
        policy_kwargs={"net_arch": [8]},
        seed=0,
    )
    model.save(tmp_path / "model.zip")
    env = BatchEnv(find("planar"), n=1, threads=1)
    policy, said = actor(str(tmp_path / "model.zip"), env)
    observation, _ = single.reset(seed=5, options={"index": 3})
    env.reset(np.array([0]), [env.problem(seed=5, split="train", index=3)])
    ours = policy.act(np.array([0]), env.state[:1])
    theirs, _ = model.predict(observation, deterministic=True)
    assert ours[0] == pytest.approx(theirs, abs=1e-5)
    assert np.abs(theirs).max() > 1e-3
    assert said["kind"] == "stable-baselines3 TD3"
    assert len(said["sha256"]) == 64


def test_the_last_evaluation_of_a_peers_run_is_that_of_the_model_it_saves(
    tmp_path: Path,
) -> None:
    """Not of the model before the last updates, which may do something else altogether."""
    small = ["network.hidden=[8]", "replay.batch=16", "replay.warmup=16", "loop.updates_per_step=1"]
    learn(
        "planar",
        load_settings(assignments=small),
        tmp_path / "run",
        steps=336,
        envs=2,
        every=168,
        episodes=2,
        preset="live",
    )
    rows = [row for row in read_metrics(tmp_path / "run" / "metrics.jsonl") if "clean" in row]
    model = str(tmp_path / "run" / "model.zip")
    env = environment("planar", model, radius=0.03, torso="free", envs=2)
    assert env.task.config.control_period == surroundings("live")["config"]["control_period"]
    policy, _ = actor(model, env)
    again = figures(evaluate(env, policy, episodes=2, k=env.layout.k, seed=0))
    assert {name: rows[-1][name] for name in again} == again
    assert again["score"] != rows[0]["score"]
    assert [(row["step"], row["update"]) for row in rows] == [(176, 80), (336, 240)]
