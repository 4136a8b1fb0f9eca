"""A robot as data: everything that is particular to one robot stands in one frozen spec.

Scenes, tasks, the learner's mask, the width of every column and the groups of every plot follow
from it, for any number of arms. Nothing in the package asks which robot it is.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from coordlog.episode import Array
from coordlog.errors import ConfigError


@dataclass(frozen=True)
class Arm:
    """One arm: one task, one reward, one critic head."""

    name: str
    palm: str
    """Name of the site that must reach the goal."""
    joints: tuple[str, ...]
    """Joints that move this arm and no other, base to tip."""


@dataclass(frozen=True)
class Robot:
    """One robot: its model and the names the rest of the package needs.

    The action drives `shared` joints first, then each arm's own, in order. Every joint of the
    action must have a position servo of the same name; joints with a servo and no place in the
    action are held at their pose.
    """

    name: str
    mjcf: str
    """The robot alone, as a whole MJCF document: no floor, no scene, no files."""
    arms: tuple[Arm, ...]
    shared: tuple[str, ...] = ()
    """Joints that move every arm (the spine), base to tip."""
    soles: tuple[str, ...] = ()
    """Box geoms the robot stands on; empty for a robot that cannot fall."""
    torso: str = ""
    """Body whose tilt counts as falling; needed if there are soles."""
    poses: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    """Named start poses [rad]; joints not named are at zero. Every robot has "stand"."""
    centre: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Middle of the workspace [m]: positions in the policy state are relative to it."""
    reach: float = 1.0
    """Half the extent of the workspace [m]: positions in the policy state are divided by it."""

    def __post_init__(self) -> None:
        if not self.arms:
            raise ConfigError(f"robot '{self.name}': expected at least one arm, got none")
        joints = self.action_joints
        if len(set(joints)) != len(joints):
            raise ConfigError(
                f"robot '{self.name}': a joint belongs to one arm or is shared by all, got twice: {joints}"
            )
        if self.soles and not self.torso:
            raise ConfigError(
                f"robot '{self.name}': a robot with soles needs the name of its torso body"
            )
        if "stand" not in self.poses:
            raise ConfigError(
                f"robot '{self.name}': expected a start pose called 'stand', got {sorted(self.poses)}"
            )

    @property
    def action_joints(self) -> tuple[str, ...]:
        """Joints in the order of the action: shared, then arm by arm."""
        return self.shared + tuple(name for arm in self.arms for name in arm.joints)

    @property
    def served(self) -> dict[str, list[int]]:
        """Action entries that move each arm: the shared ones and its own.

        DiGrad's mask follows from this.
        """
        index = {name: i for i, name in enumerate(self.action_joints)}
        return {arm.name: [index[name] for name in self.shared + arm.joints] for arm in self.arms}

    def speeds(self, *, private: float, shared: float) -> Array:
        """Speed of every action joint at action 1, (n_u,) [rad/s]: a robot that stands on feet
        moves its shared joints slower.
        """
        slow = [name in self.shared and bool(self.soles) for name in self.action_joints]
        return np.asarray(np.where(slow, shared, private))

    def to_json(self) -> dict[str, Any]:
        """Everything but the model text, JSON-able; `from_json` is its inverse."""
        return {
            "name": self.name,
            "arms": [
                {"name": arm.name, "palm": arm.palm, "joints": list(arm.joints)}
                for arm in self.arms
            ],
            "shared": list(self.shared),
            "soles": list(self.soles),
            "torso": self.torso,
            "poses": {pose: dict(joints) for pose, joints in self.poses.items()},
            "centre": list(self.centre),
            "reach": self.reach,
        }

    @classmethod
    def from_json(cls, data: Mapping[str, Any], *, mjcf: str = "") -> Robot:
        """The spec a log carries.

        A log's model is attached whole, scene included, so `mjcf` may stay empty.
        """
        arms = tuple(Arm(arm["name"], arm["palm"], tuple(arm["joints"])) for arm in data["arms"])
        centre = tuple(data["centre"])
        shared, soles = tuple(data["shared"]), tuple(data["soles"])
        return cls(
            data["name"],
            mjcf,
            arms,
            shared,
            soles,
            data["torso"],
            data["poses"],
            centre,
            data["reach"],
        )
