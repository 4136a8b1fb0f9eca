"""A model of stable-baselines3 acts here as it does in its own environment."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from stable_baselines3 import TD3, HerReplayBuffer

from coordlog.sim.env import BatchEnv
from coordlog.sim.gym import GymEnv
from coordlog.sim.scene import find
from results.actors import actor


def test_a_foreign_model_is_loaded_without_its_environment_and_acts_alike(tmp_path: Path) -> None:
    single = GymEnv("planar")
    model = TD3("MultiInputPolicy", single, replay_buffer_class=HerReplayBuffer, buffer_size=100, policy_kwargs={"net_arch": [8]}, seed=0)
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
