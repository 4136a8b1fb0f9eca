"""stable-baselines3's TD3 + HER on `coordlog.GymEnv`, as its users would call it: one reward, the
sum of the arms'.

    python -m experiments.scalar_peer free runs/peers-free/td3-s0 --steps 40000 --seed 0
    python -m experiments.scalar_peer table runs/peers-table/td3-s0 --preset live --seed 0

The network, batch, discount, learning rate, exploration, updates per step and share of goals in
hindsight are those of a preset of ours, and so are the period of decisions and the rewards; what
makes TD3 (delayed actor, target noise, targets of one step, goals from anywhere later in an
episode, endings as they were, starts in the pose asked for) stays as that library has it.
Held-out problems are judged by `coordlog.sim.scoring.evaluate`, like everyone's, and the rows are
those of a run folder, so that `coordlog plot` draws them beside ours.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

import numpy as np
import torch
from stable_baselines3 import TD3, HerReplayBuffer
from stable_baselines3.common.buffers import DictReplayBuffer
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.noise import ActionNoise, VectorizedActionNoise
from stable_baselines3.common.vec_env import DummyVecEnv

from coordlog.episode import Array
from coordlog.sim.env import BatchEnv
from coordlog.sim.gym import GymEnv
from coordlog.sim.making import make_env
from coordlog.sim.scoring import evaluate, figures
from coordlog.train.config import NoiseConfig
from coordlog.train.settings import PRESETS, Settings, load_settings, surroundings
from experiments.actors import RUN, Foreign

NAME = "TD3 + HER of stable-baselines3"
EVALUATION_ENVS = 32
STEPS = 60_000
"""Live steps where neither the preset nor a person says how many."""


class SumOfArms(GymEnv):
    """Rewards are summed over arms instead of averaged, and scaled as our learner's are."""

    factor = 1.0

    def step(self, action: Array) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """A step with that reward."""
        observation, reward, terminated, truncated, info = super().step(action)
        return observation, reward * self.factor, terminated, truncated, info

    def compute_reward(self, achieved_goal: Array, desired_goal: Array, info: Any) -> Any:
        """That reward of goals in hindsight."""
        return super().compute_reward(achieved_goal, desired_goal, info) * self.factor


class Decaying(ActionNoise):
    """Normal noise whose deviation decays over the run like ours; called once a step."""

    def __init__(self, config: NoiseConfig, n_u: int, *, steps: float, seed: int) -> None:
        super().__init__()
        self._config, self._n_u, self._steps, self._taken = config, n_u, steps, 0
        self._rng = np.random.default_rng([seed, 1])

    def __call__(self) -> Array:
        """The noise of a step."""
        self._taken += 1
        return self._rng.normal(
            0.0, self._config.at(min(1.0, self._taken / self._steps)), self._n_u
        ).astype(np.float32)


class Rows(BaseCallback):
    """A row of training and one of evaluation every so many steps and at the end, between the
    updates of one block and the next block.

    While a block runs, the actor still lacks the updates that the block's steps earn, and a few
    updates turn a young actor from one corner of its actions to another: what is judged last has to
    be what is saved.
    """

    def __init__(
        self, folder: Path, policy: Foreign, env: BatchEnv, *, every: int, episodes: int
    ) -> None:
        super().__init__()
        self._folder, self._policy, self._env = folder, policy, env
        self._every, self._episodes = every, episodes
        self._ended, self._fresh, self._due = 0, list[bool](), every
        self._began = time.perf_counter()

    def _on_step(self) -> bool:
        self._fresh += [
            bool(info["is_success"])
            for info, done in zip(self.locals["infos"], self.locals["dones"], strict=True)
            if done
        ]
        return True

    def _on_rollout_start(self) -> None:
        if self.num_timesteps >= self._due:
            self._due += self._every
            self._judge()

    def _on_training_end(self) -> None:
        self._judge()

    def _judge(self) -> None:
        self._ended += len(self._fresh)
        success = float(np.mean(self._fresh)) if self._fresh else 0.0
        seconds = time.perf_counter() - self._began
        told = {
            "episodes": len(self._fresh),
            "episodes_total": self._ended,
            "success": success,
            "seconds": seconds,
        }
        self._fresh = []
        self._write("training", told)
        k = self._env.layout.k
        judged = evaluate(self._env, self._policy, episodes=self._episodes, k=k, seed=0)
        self._write("evaluation", figures(judged))

    def _write(self, kind: str, values: dict[str, float]) -> None:
        row = {"kind": kind, "update": int(self.model._n_updates), "step": self.num_timesteps}
        with (self._folder / "metrics.jsonl").open("a") as file:
            file.write(json.dumps(row | values) + "\n")


def learn(
    scene: str,
    settings: Settings,
    folder: Path,
    *,
    steps: int,
    envs: int,
    every: int,
    episodes: int,
    preset: str = "default",
) -> None:
    """One run of the peer into an empty folder, in the environment that the preset asks for.

    A row whenever `every` steps are over, the last at the end.
    """
    seed, loop = settings.loop.seed, settings.loop
    n, like = min(EVALUATION_ENVS, episodes), surroundings(preset)
    judge = make_env(scene, {}, start="stand", envs=n, threads=0, like=like)
    SumOfArms.factor = judge.layout.k * settings.learner.reward_scale
    single = _single(judge)
    made = DummyVecEnv([lambda: _single(judge)] * envs)
    noise = VectorizedActionNoise(
        Decaying(settings.noise, judge.layout.n_u, steps=steps / envs, seed=seed), envs
    )
    noise.noises = [
        Decaying(settings.noise, judge.layout.n_u, steps=steps / envs, seed=1000 * seed + i)
        for i in range(envs)
    ]
    share = settings.replay.hindsight
    goals = {
        "n_sampled_goal": max(1, round(share / (1 - share))),
        "goal_selection_strategy": "future",
        "copy_info_dict": True,
    }
    model = TD3(
        "MultiInputPolicy",
        made,
        policy_kwargs={"net_arch": list(settings.network.hidden)},
        learning_rate=settings.learner.critic_rate,
        batch_size=settings.replay.batch,
        buffer_size=min(settings.replay.capacity, steps + envs),
        learning_starts=max(settings.replay.warmup, envs * (judge.task.config.max_steps + 1)),
        gamma=settings.learner.gamma,
        tau=settings.learner.tau,
        train_freq=(loop.block, "step"),
        gradient_steps=max(1, round(loop.updates_per_step * loop.block * envs)),
        action_noise=noise,
        replay_buffer_class=HerReplayBuffer if share else DictReplayBuffer,
        replay_buffer_kwargs=goals if share else {},
        device="cpu",
        seed=seed,
    )
    policy = Foreign(model, judge)
    require_same_sight(policy, judge, single)
    folder.mkdir(parents=True)
    said = {"scene": scene, "mode": NAME, "seed": seed, "settings": settings.asdict(), "envs": envs}
    (folder / RUN).write_text(json.dumps(said | {"env": judge.describe()}))
    model.learn(steps, callback=Rows(folder, policy, judge, every=every, episodes=episodes))
    model.save(folder / "model.zip")
    (folder / "finished").touch()


def _single(judge: BatchEnv) -> SumOfArms:
    """One simulation of the environment that is judged in."""
    return SumOfArms(judge.scene, config=judge.task.config, reward=judge.task.reward)


def require_same_sight(policy: Foreign, env: BatchEnv, single: GymEnv) -> None:
    """Make sure that the model sees in an evaluation what it saw while learning."""
    env.reset(np.array([0]), [env.problem(seed=5, split="train", index=3)])
    seen, _ = single.reset(seed=5, options={"index": 3})
    for name, values in policy.observation(env.state[:1]).items():
        np.testing.assert_allclose(values[0], seen[name], atol=1e-5, err_msg=name)


def main(arguments: list[str] | None = None) -> None:
    """Train one, which takes hours; `coordlog plot` draws it beside ours."""
    parser = argparse.ArgumentParser(
        prog="python -m experiments.scalar_peer", description=(__doc__ or "").split("\n", 1)[0]
    )
    parser.add_argument("scene")
    parser.add_argument("out", type=Path, help="a run folder that is not there yet")
    parser.add_argument("--preset", default="default", choices=list(PRESETS))
    parser.add_argument("--steps", type=int, help=f"by default the preset's, or {STEPS:,}")
    for name, usual in (("seed", 0), ("every", 5_000), ("episodes", 100)):
        parser.add_argument(f"--{name}", type=int, default=usual)
    given = parser.parse_args(arguments)
    torch.set_num_threads(1)
    steps = given.steps or PRESETS[given.preset].loop.steps or STEPS
    said = (f"loop.seed={given.seed}", "loop.updates=0", f"loop.steps={steps}")
    settings = load_settings(preset=given.preset, assignments=said)
    budget = {"steps": steps, "every": given.every, "episodes": given.episodes}
    learn(given.scene, settings, given.out, envs=32, preset=given.preset, **budget)


if __name__ == "__main__":
    main()
