"""Whatever can be evaluated, by name: what `coordlog record --policy` takes, and models of
stable-baselines3 (.zip).
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np

from coordlog.contracts import Policy
from coordlog.episode import Array, Json
from coordlog.policies.registry import about, make_policy, policy_file
from coordlog.sim.env import BatchEnv
from coordlog.sim.gym import GOAL_PARTS, STATE_BOUND

FOREIGN = ".zip"
RUN = "run.json"
"""Lies beside a model that `experiments.scalar_peer` trained, and says what it learnt in."""
ABOUT = ("scene", "mode", "seed", "updates", "steps", "log_episodes", "data")
"""What a table keeps of what a policy file says of its training."""


class Foreign:
    """A model that was trained on `coordlog.GymEnv`; it sees the same numbers here."""

    def __init__(self, model: Any, env: BatchEnv) -> None:
        """Find the parts of the state that the Gymnasium environment shows."""
        self._model, self._view = model, env.task.view
        places = env.task.view.places
        self._seen = np.concatenate(
            [
                np.arange(place.start, place.stop)
                for name, place in places.items()
                if name not in GOAL_PARTS
            ]
        )

    def begin(self, ids: Array, state: Array, rngs: list[np.random.Generator]) -> None:
        """Nothing to prepare."""

    def observation(self, state: Array) -> dict[str, Array]:
        """What the model saw while learning."""
        return {
            "observation": np.clip(state[:, self._seen], -STATE_BOUND, STATE_BOUND),
            "achieved_goal": self._view.physical(state, "palms"),
            "desired_goal": self._view.physical(state, "goals"),
        }

    def act(self, ids: Array, state: Array) -> Array:
        """Actions without exploration, (n, n_u)."""
        action, _ = self._model.predict(self.observation(state), deterministic=True)
        return np.asarray(action, dtype=np.float32)


def learnt_in(name: str, scene: str) -> Json | None:
    """The `coordlog.env` record of the environment a policy learnt in, as far as it is known."""
    if name.endswith(FOREIGN):
        beside = Path(name).with_name(RUN)
        said = json.loads(beside.read_text(encoding="utf-8")) if beside.exists() else {}
        return said.get("env")
    file = policy_file(name, scene)
    return about(file)["env"] if file else None


def actor(name: str, env: BatchEnv, *, shield: bool | None = None) -> tuple[Policy, Json]:
    """The policy, and what a table says of it; `shield` as for `make_policy`.

    Raises:
        ConfigError: for an unknown name.
        SpecError: if it does not fit the environment.
    """
    if name.endswith(FOREIGN):
        from stable_baselines3 import TD3
        from stable_baselines3.common.buffers import DictReplayBuffer

        # The buffer for hindsight wants an environment of its own; to act, none is needed.
        small = {
            "replay_buffer_class": DictReplayBuffer,
            "replay_buffer_kwargs": {},
            "buffer_size": 1,
        }
        model = TD3.load(name, device="cpu", custom_objects=small)
        digest = hashlib.sha256(Path(name).read_bytes()).hexdigest()
        return Foreign(model, env), {
            "kind": "stable-baselines3 TD3",
            "sha256": digest,
            "training": {"steps": int(model.num_timesteps)},
        }
    policy, said = make_policy(name, env, shield=shield)
    file = policy_file(name, env.scene.name)
    trained = about(file) if file else {}
    return policy, {
        "kind": said["kind"],
        "sha256": said["checkpoint_sha256"],
        "training": {key: trained[key] for key in ABOUT if key in trained},
        **({"shield": said["shield"]} if "shield" in said else {}),
    }
