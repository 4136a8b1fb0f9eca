"""The scenes as Gymnasium ids, `coordlog/<scene>-v0`; loads neither MuJoCo nor a model."""

from __future__ import annotations

import gymnasium

from coordlog.tasks.scene import SCENES


def gym_id(scene: str) -> str:
    """The Gymnasium id of a scene."""
    return f"coordlog/{scene}-v0"


def register() -> None:
    """Register every scene; Gymnasium calls this by itself (the entry point in pyproject.toml), and
    calling it again is harmless.
    """
    for scene in SCENES:
        if gym_id(scene) not in gymnasium.registry:
            gymnasium.register(
                gym_id(scene), entry_point="coordlog.sim.gym:GymEnv", kwargs={"scene": scene}
            )
