"""A robot as data: everything that is particular to one robot stands in one frozen spec.

Scenes, tasks, the learner's mask, the width of every column and the groups of every plot follow
from it, for any number of arms. Nothing in the package asks which robot it is.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from math import isfinite
from numbers import Real
from pathlib import Path
from typing import Any

import numpy as np

from coordlog.episode import Array
from coordlog.errors import ConfigError, FormatError

_SPEC = ("name", "arms", "shared", "soles", "torso", "poses", "centre", "reach")


@dataclass(frozen=True)
class Arm:
    """One arm: one task, one reward, one critic head."""

    name: str
    palm: str
    """Name of the site that must reach the goal; or of a body, which then gets one."""
    joints: tuple[str, ...]
    """Joints that move this arm and no other, base to tip."""
    at: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Where the palm is in the frame of the body that `palm` names, if that is a body [m]."""


@dataclass(frozen=True)
class Robot:
    """One robot: its model and the names the rest of the package needs.

    The action drives `shared` joints first, then each arm's own, in order. Every joint of the
    action needs a position servo, whatever it is called; joints with a servo and no place in the
    action are held at their pose, and all other actuators at one control.

    Example:
        >>> from pathlib import Path
        >>> arm = Arm("arm", palm="attachment_site", joints=("shoulder_pan_joint", "elbow_joint"))
        >>> Robot("ur5e", Path("ur5e.xml"), (arm,), poses={"stand": {}}).action_joints
        ('shoulder_pan_joint', 'elbow_joint')
    """

    name: str
    mjcf: str | Path
    """The robot alone, MJCF or URDF: a file, or the text of one."""
    arms: tuple[Arm, ...]
    shared: tuple[str, ...] = ()
    """Joints that move every arm (the spine), base to tip."""
    soles: tuple[str, ...] = ()
    """Geoms the robot stands on; empty for a robot that cannot fall."""
    torso: str = ""
    """Body whose tilt counts as falling; needed if there are soles."""
    poses: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    """Named start poses [rad, m]; joints not named are where the model's keyframe of that name has
    them, or at its zero. Every robot has "stand"."""
    centre: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Middle of the workspace [m]: positions in the policy state are relative to it."""
    reach: float = 1.0
    """Half the extent of the workspace [m]: positions in the policy state are divided by it."""
    assets: Mapping[str, bytes] | Path | None = None
    """The files a model given as text names: their bytes by name, or the folder they lie in. A
    model given as a file finds its own."""
    servo_gains: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """Gains (kp, kv) of the position servos that joints get which have a motor or no actuator, by
    joint, "*" for all others [N·m/rad, N·m·s/rad; N/m, N·s/m]."""
    ranges: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """Ranges of action joints whose model gives none [rad, m]; a hinge gets ±π by itself."""
    held: Mapping[str, float] = field(default_factory=dict)
    """Control of actuators that are no joint's servo (a gripper's tendon), by name; without it what
    the model's keyframe says, or 0."""
    excludes: tuple[tuple[str, str], ...] = ()
    """Pairs of bodies that never collide, beside those the model excludes itself."""

    def __post_init__(self) -> None:
        if not self.arms and not self.poses:
            return  # of an episode of another program's environment: nothing but looked at
        if not self.arms:
            raise ConfigError(f"robot '{self.name}': expected at least one arm, got none")
        joints = self.action_joints
        if len(set(joints)) != len(joints):
            raise ConfigError(
                f"robot '{self.name}': a joint belongs to one arm or is shared by all, got twice: "
                f"{joints}"
            )
        if self.soles and not self.torso:
            raise ConfigError(
                f"robot '{self.name}': a robot with soles needs the name of its torso body"
            )
        for where, value in self._numbers():
            if isinstance(value, bool) or not isinstance(value, Real) or not isfinite(value):
                raise ConfigError(
                    f"robot '{self.name}': expected a finite number as {where}, got {value!r}"
                )
        if self.reach <= 0:
            raise ConfigError(f"robot '{self.name}': expected reach above 0 m, got {self.reach:g}")
        names = [arm.name for arm in self.arms]
        if len(set(names)) != len(names):
            raise ConfigError(f"robot '{self.name}': expected arms of different names, got {names}")
        for joint, (low, high) in self.ranges.items():
            if low >= high:
                raise ConfigError(
                    f"robot '{self.name}': expected ranges['{joint}'] as (low, high), got "
                    f"({low:g}, {high:g})"
                )
        if any(kp <= 0 or kv < 0 for kp, kv in self.servo_gains.values()):
            raise ConfigError(
                f"robot '{self.name}': expected servo_gains (kp, kv) with kp > 0 and kv >= 0, got "
                f"{dict(self.servo_gains)}"
            )
        if "stand" not in self.poses:
            raise ConfigError(
                f"robot '{self.name}': expected a start pose called 'stand', got "
                f"{sorted(self.poses)}"
            )

    def _numbers(self) -> Iterator[tuple[str, Any]]:
        """Every number of the spec, with where it stands."""
        for pose, angles in self.poses.items():
            yield from ((f"poses['{pose}']['{joint}']", angle) for joint, angle in angles.items())
        yield from ((f"held['{name}']", value) for name, value in self.held.items())
        for table in ("servo_gains", "ranges"):
            for name, pair in getattr(self, table).items():
                if not isinstance(pair, tuple | list) or len(pair) != 2:
                    raise ConfigError(
                        f"robot '{self.name}': expected two numbers as {table}['{name}'], got "
                        f"{pair!r}"
                    )
                yield from ((f"{table}['{name}']", value) for value in pair)
        yield from (("centre", value) for value in self.centre)
        yield "reach", self.reach

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

    def gains(self, joint: str) -> tuple[float, float] | None:
        """Gains (kp, kv) of the servo a joint gets where its model has none; None if none are
        given.
        """
        return self.servo_gains.get(joint, self.servo_gains.get("*"))

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

        Raises:
            FormatError: if it says too little: logs of other programs need not describe a robot.
        """
        arms = tuple(
            Arm(arm["name"], arm["palm"], tuple(arm["joints"])) for arm in data.get("arms", ())
        )
        if not arms:
            return cls(data["name"], mjcf, ())
        missing = [key for key in _SPEC if key not in data]
        if missing:
            raise FormatError(
                f"robot: expected its {', '.join(_SPEC)}; {', '.join(missing)} missing"
            )
        centre = tuple(data["centre"])
        shared, soles = tuple(data["shared"]), tuple(data["soles"])
        name, torso, poses = data["name"], data["torso"], data["poses"]
        return cls(name, mjcf, arms, shared, soles, torso, poses, centre, data["reach"])
