"""stable-baselines3's TD3 + HER on `coordlog.GymEnv`, as its users would call it: one reward, the
sum of the arms'.

The network, batch, discount, learning rate, exploration, updates per step and share of goals in
hindsight are those of our settings; what makes TD3 (delayed actor, target noise, targets of one
step, goals from anywhere later in an episode, endings as they were) stays as that library has it.
Held-out problems are judged by `coordlog.sim.scoring.evaluate`, like everyone's, and the rows are
those of a run folder, so that `coordlog plot` draws them beside ours.
"""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from gymnasium import spaces
from stable_baselines3 import TD3, HerReplayBuffer
from stable_baselines3.common.buffers import DictReplayBuffer
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.noise import ActionNoise, VectorizedActionNoise
from stable_baselines3.common.vec_env import DummyVecEnv

from coordlog.episode import Array
from coordlog.sim.env import BatchEnv
from coordlog.sim.gym import GymEnv
from coordlog.sim.scoring import evaluate, figures
from coordlog.tasks.scene import find
from coordlog.train.config import NoiseConfig
from coordlog.train.settings import Settings

NAME = "TD3 + HER of stable-baselines3"
EVALUATION_ENVS = 32


class SumOfArms(GymEnv):
    """Rewards are summed over arms instead of averaged, and scaled as our learner's are."""

    factor = 1.0

    def step(self, action):
        observation, reward, terminated, truncated, info = super().step(action)
        return observation, reward * self.factor, terminated, truncated, info

    def compute_reward(self, achieved_goal, desired_goal, info):
        return super().compute_reward(achieved_goal, desired_goal, info) * self.factor


class Decaying(ActionNoise):
    """Normal noise whose deviation decays over the run like ours; called once a step."""

    def __init__(self, config: NoiseConfig, n_u: int, *, steps: float, seed: int) -> None:
        super().__init__()
        self._config, self._n_u, self._steps, self._taken = config, n_u, steps, 0
        self._rng = np.random.default_rng([seed, 1])

    def __call__(self) -> Array:
        self._taken += 1
        return self._rng.normal(
            0.0, self._config.at(min(1.0, self._taken / self._steps)), self._n_u
        ).astype(np.float32)


class AsPolicy:
    """A model as a policy of `rollout`: from the policy state to the observation that the model
    knows.
    """

    def __init__(self, model: TD3, env: BatchEnv, seen: Array, space: spaces.Dict) -> None:
        self._model, self._view, self._seen, self._space = model, env.task.view, seen, space

    def begin(self, ids: Array, state: Array, rngs: list[np.random.Generator]) -> None:
        pass

    def observation(self, state: Array) -> dict[str, Array]:
        box = self._space["observation"]
        return {
            "observation": np.clip(state[:, self._seen], box.low, box.high),
            "achieved_goal": self._view.physical(state, "palms"),
            "desired_goal": self._view.physical(state, "goals"),
        }

    def act(self, ids: Array, state: Array) -> Array:
        return self._model.predict(self.observation(state), deterministic=True)[0]


class Rows(BaseCallback):
    """A row of training and one of evaluation every so many steps and at the end, between the
    updates of one block and the next block.

    While a block runs, the actor still lacks the updates that the block's steps earn, and a few
    updates turn a young actor from one corner of its actions to another: what is judged last has to
    be what is saved.
    """

    def __init__(
        self, folder: Path, policy: AsPolicy, env: BatchEnv, *, every: int, episodes: int
    ) -> None:
        super().__init__()
        self._folder, self._policy, self._env, self._every, self._episodes = (
            folder,
            policy,
            env,
            every,
            episodes,
        )
        self._ended, self._fresh, self._due, self._began = (
            0,
            list[bool](),
            every,
            time.perf_counter(),
        )

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
        self._write(
            "evaluation",
            figures(
                evaluate(
                    self._env, self._policy, episodes=self._episodes, k=self._env.layout.k, seed=0
                )
            ),
        )

    def _write(self, kind: str, values: dict[str, float]) -> None:
        row = {
            "kind": kind,
            "update": int(self.model._n_updates),
            "step": self.num_timesteps,
            **values,
        }
        with (self._folder / "metrics.jsonl").open("a") as file:
            file.write(json.dumps(row) + "\n")


def learn(
    scene: str,
    settings: Settings,
    folder: Path,
    *,
    steps: int,
    envs: int,
    every: int,
    episodes: int,
) -> None:
    """One run of the peer into an empty folder.

    A row whenever `every` steps are over, the last at the end.
    """
    seed, loop = settings.loop.seed, settings.loop
    judge = BatchEnv(find(scene), n=min(EVALUATION_ENVS, episodes), threads=0)
    SumOfArms.factor = judge.layout.k * settings.learner.reward_scale
    single = SumOfArms(scene)
    made = DummyVecEnv([lambda: SumOfArms(scene)] * envs)
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
    policy = AsPolicy(model, judge, single._seen, single.observation_space)
    require_same_sight(policy, judge, single)
    folder.mkdir(parents=True)
    said = {"scene": scene, "mode": NAME, "seed": seed, "settings": settings.asdict(), "envs": envs}
    (folder / "run.json").write_text(json.dumps(said))
    model.learn(steps, callback=Rows(folder, policy, judge, every=every, episodes=episodes))
    model.save(folder / "model.zip")
    (folder / "finished").touch()


def require_same_sight(policy: AsPolicy, env: BatchEnv, single: GymEnv) -> None:
    """Make sure that the model sees in an evaluation what it saw while learning."""
    env.reset(np.array([0]), [env.problem(seed=5, split="train", index=3)])
    seen, _ = single.reset(seed=5, options={"index": 3})
    for name, values in policy.observation(env.state[:1]).items():
        np.testing.assert_allclose(values[0], seen[name], atol=1e-5, err_msg=name)


def curve(folder: Path) -> Sequence[dict[str, float]]:
    """The evaluations of a run folder."""
    rows = [json.loads(line) for line in (folder / "metrics.jsonl").read_text().splitlines()]
    return [row for row in rows if row["kind"] == "evaluation"]
