"""One episode at a time behind Gymnasium's interface, goal-conditioned, for people who bring their
own learner.

Observations are dicts of `observation`, `achieved_goal` and `desired_goal`, and rewards and endings
can be recomputed for other goals, so hindsight replay buffers work as they come. The physics, the
flags and the rewards are those of sim/simulation.py.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces

from coordlog.contracts import Outcome
from coordlog.episode import Array
from coordlog.errors import ConfigError, SpecError, unknown
from coordlog.sim.env import BatchEnv
from coordlog.sim.render import Painter, view_of
from coordlog.sim.sampler import SPLITS
from coordlog.spec import after
from coordlog.tasks.config import EnvConfig, RewardConfig
from coordlog.tasks.reach.reward import distances
from coordlog.tasks.registry import follow
from coordlog.tasks.scene import Scene, find

OPTIONS = ("index", "split")
GOAL_PARTS = ("goals", "difference")
"""Parts of the policy state that change with the goals."""
STATE_BOUND = 10.0
"""The policy state is scaled to about ±1; beyond this it is clipped."""
WORLD_BOUND = 10.0
"""Palms and goals are within this of the origin [m]."""
IMAGE = (480, 360)
"""Width and height of a rendered frame [pixels]."""
ONE = np.zeros(1, dtype=np.int64)

Observation = dict[str, Any]
Info = dict[str, Any]


class GymEnv(gymnasium.Env[Observation, Array]):
    """One scene as a goal-conditioned environment.

    observation: the policy state without what depends on the goals, so that goals can be swapped in
    hindsight, float32. achieved_goal, desired_goal: all palms and all goals, (3k,) float64 [m], arm
    after arm.
    reward: the mean of the arms' rewards, which are in `info["rewards"]`.
    truncated: after `config.max_steps` steps; there is no need of a TimeLimit wrapper.

    Infos have the same keys after `reset` and after `step`: the reward of each arm, the task's own
    fields, is_success, step, diverged, and which problem it is (seed, index, split).

    A reset with a seed starts that seed's first problem, every further reset its next; `options`
    may name another `index` or `split`.

    Example:
        >>> env = gymnasium.make("coordlog/table-v0")           # doctest: +SKIP
        >>> observation, info = env.reset(seed=0)               # doctest: +SKIP
        >>> info["distance"].shape                              # doctest: +SKIP
        (2,)
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 25}  # noqa: RUF012 - as gymnasium.Env declares it

    def __init__(
        self,
        scene: str | Scene = "free",
        *,
        config: EnvConfig | None = None,
        reward: RewardConfig | None = None,
        split: str = "train",
        render_mode: str | None = None,
    ) -> None:
        """Build the scene.

        Args:
            scene: Name of a scene that ships, or a scene of your own.
            config: Control, endings, balance and state.
            reward: Constants of the reward.
            split: Which stream of problems to draw from, unless a reset says otherwise.
            render_mode: "rgb_array", or None for no rendering.

        Raises:
            ConfigError: for an unknown scene, split or render mode.
        """
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise unknown("render mode", str(render_mode), self.metadata["render_modes"])
        self.render_mode, self._split = render_mode, _known_split(split)
        self._made = (scene, config, reward, split, render_mode)
        self._env = BatchEnv(
            find(scene) if isinstance(scene, str) else scene, config, reward, threads=1
        )
        self._painter: Painter | None = None
        self._seed, self._index, self._drawn = -1, -1, split
        self._observation: Observation | None = None
        places = self._env.task.view.places
        self._seen = np.concatenate(
            [
                np.arange(place.start, place.stop)
                for name, place in places.items()
                if name not in GOAL_PARTS
            ]
        )
        layout = self._env.layout
        self.action_space = spaces.Box(-1.0, 1.0, (layout.n_u,), np.float32)
        points = spaces.Box(-WORLD_BOUND, WORLD_BOUND, (3 * layout.k,), np.float64)
        state = spaces.Box(-STATE_BOUND, STATE_BOUND, (len(self._seen),), np.float32)
        self.observation_space = spaces.Dict(
            {"observation": state, "achieved_goal": points, "desired_goal": points}
        )

    def reset(
        self, *, seed: int | None = None, options: Info | None = None
    ) -> tuple[Observation, Info]:
        """Start an episode.

        Args:
            seed: Start over with this seed's first problem; None goes on to the next.
            options: Any of "index" (which problem of the seed) and "split" ("train" or "test").

        Raises:
            ConfigError: for an unknown option or split.
        """
        super().reset(seed=seed)
        options = options or {}
        for name in options:
            if name not in OPTIONS:
                raise unknown("reset option", name, OPTIONS)
        if seed is not None or self._seed < 0:
            self._seed, self._index = (
                int(self.np_random.integers(2**31)) if seed is None else seed,
                -1,
            )
        self._index = int(options.get("index", self._index + 1))
        if self._index < 0:
            raise ConfigError(f"reset option 'index': expected a number from 0, got {self._index}")
        split = _known_split(options.get("split", self._split))
        problem = self._env.problem(seed=self._seed, split=split, index=self._index)
        self._env.reset(ONE, [problem])
        self._drawn = split
        self._observation = self._observe()
        return self._observation, self._info()

    def step(self, action: Array) -> tuple[Observation, float, bool, bool, Info]:
        """Advance by one control period.

        A simulation that diverges ends the episode: truncated, reward 0, the observation as it was,
        and `info["diverged"]`.

        Raises:
            SpecError: if the action has another shape or is no number.
        """
        if self._observation is None:
            raise gymnasium.error.ResetNeeded("step: expected a reset first")
        action = np.asarray(action, dtype=np.float32)
        if action.shape != self.action_space.shape or not np.isfinite(action).all():
            raise SpecError(
                f"action: expected {self.action_space.shape} numbers in [-1, 1], got shape "
                f"{action.shape}: {action}"
            )
        outcome = self._env.step(np.clip(action, -1.0, 1.0)[None], ONE)
        info = self._info(outcome)
        if info["diverged"]:
            return self._observation, 0.0, False, True, info
        self._observation = self._observe()
        return (
            self._observation,
            float(np.mean(outcome.reward[0])),
            bool(outcome.terminated[0]),
            bool(outcome.truncated[0]),
            info,
        )

    def compute_reward(
        self, achieved_goal: Array, desired_goal: Array, info: Info | Sequence[Info]
    ) -> Any:
        """The reward had these been the palms and the goals, a float or (n,).

        Args:
            achieved_goal: Palms, shape (3k,) or (n, 3k) [m].
            desired_goal: Goals, of the same shape [m].
            info: What `step` returned, one or n of them.

        Raises:
            SpecError: if an info lacks the flags that `step` put into it.
        """
        return self._judge(achieved_goal, desired_goal, info)[0]

    def compute_terminated(
        self, achieved_goal: Array, desired_goal: Array, info: Info | Sequence[Info]
    ) -> Any:
        """Whether the task had ended there, a bool or (n,); arguments as `compute_reward`."""
        return self._judge(achieved_goal, desired_goal, info)[1]

    def compute_truncated(
        self, achieved_goal: Array, desired_goal: Array, info: Info | Sequence[Info]
    ) -> Any:
        """Whether the episode had been cut off there, a bool or (n,).

        Arguments as `compute_reward`.
        """
        return self._judge(achieved_goal, desired_goal, info)[2]

    def render(self) -> Array | None:
        """The present state as RGB (360, 480, 3) uint8, or None without a render mode.

        Raises:
            SimulationError: if there is no way to render here.
        """
        if self.render_mode is None:
            return None
        physics, (width, height) = self._env.physics, IMAGE
        if self._painter is None:
            self._painter = Painter(
                physics.model,
                view=view_of(self._env.scene.robot, physics.model),
                width=width,
                height=height,
            )
        return self._painter.paint(
            physics.qpos[0], physics.mocap_pos[0], sizes=physics.model_of(0).geom_size
        )

    def close(self) -> None:
        """Let go of the graphics context, if there is one."""
        if self._painter is not None:
            self._painter.close()
            self._painter = None

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle how it was made and which problem comes next: a copy needs a reset first."""
        return _remade, (self._made, self._seed, self._index)

    def _observe(self) -> Observation:
        task, physics = self._env.task, self._env.physics
        return {
            "observation": np.clip(self._env.state[0, self._seen], -STATE_BOUND, STATE_BOUND),
            "achieved_goal": task.palms(physics.sensors[:1]).ravel(),
            "desired_goal": task.goals(physics.mocap_pos[:1]).ravel(),
        }

    def _info(self, outcome: Outcome | None = None) -> Info:
        """What `step` says besides; after a reset the same keys, with nothing earned or touched."""
        rules, layout = self._env.task.rules, self._env.layout
        own = {item.name: item for item in after(rules.fields)}
        if outcome is None:
            columns = {
                name: np.zeros(layout.shape(item, 1), item.type) for name, item in own.items()
            }
            columns["distance"] = self._distance()
            rewards, success, diverged = np.zeros(layout.k), False, False
        else:
            columns = {name: outcome.columns[name] for name in own}
            rewards, success = outcome.reward[0], bool(outcome.success[0])
            diverged = bool(outcome.diverged[0])
        return {
            "rewards": rewards,
            **{name: _plain(column[0]) for name, column in columns.items()},
            "is_success": success,
            "step": int(self._env.simulation.steps[0]),
            "diverged": diverged,
            "seed": self._seed,
            "index": self._index,
            "split": self._drawn,
        }

    def _distance(self) -> Array:
        task, physics = self._env.task, self._env.physics
        return distances(task.palms(physics.sensors[:1]), task.goals(physics.mocap_pos[:1]))

    def _judge(
        self, achieved: Array, desired: Array, info: Info | Sequence[Info]
    ) -> tuple[Any, Any, Any]:
        """Reward, terminated and truncated, (n,) each, or scalars for one."""
        achieved, desired = np.asarray(achieved), np.asarray(desired)
        infos = [info] if isinstance(info, dict) else list(info)
        for item in infos:
            if "collision" not in item:
                raise SpecError(
                    "info: expected the one that step() returned, got one without 'collision' "
                    "(HerReplayBuffer: copy_info_dict=True)"
                )
        points = (*achieved.shape[:-1], -1, 3)
        distance = distances(achieved.reshape(points), desired.reshape(points))
        collision, instability, step = (
            np.array([item[name] for item in infos]).reshape(achieved.shape[:-1])
            for name in ("collision", "instability", "step")
        )
        measured = {"distance": distance, "collision": collision, "instability": instability}
        found = follow(self._env.task.rules, measured)
        terminated = found["terminated"]
        truncated = ~terminated & (step >= self._env.task.config.max_steps)
        return found["reward"].mean(axis=-1)[()], terminated[()], truncated[()]


def _remade(made: tuple[Any, Any, Any, str, str | None], seed: int, index: int) -> GymEnv:
    scene, config, reward, split, render_mode = made
    env = GymEnv(scene, config=config, reward=reward, split=split, render_mode=render_mode)
    env._seed, env._index = seed, index
    return env


def _plain(value: Any) -> Any:
    """A scalar as Python's own, an array as it is."""
    return value.item() if np.ndim(value) == 0 else value


def _known_split(split: str) -> str:
    if split not in SPLITS:
        raise unknown("split", split, SPLITS)
    return split
