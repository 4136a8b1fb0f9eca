"""Which joint of a model each joint of a source is, and in which unit."""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np

from coordlog.config import load_toml
from coordlog.episode import Array
from coordlog.errors import ConfigError, FormatError
from coordlog.exchange.motion import Motion

BEYOND = 1.05
"""How far outside its range a joint may be before its unit is doubted."""


class Joint(NamedTuple):
    """A hinge or slide of a model."""

    name: str
    qpos: int
    """its place in qpos"""
    qvel: int
    low: float
    high: float
    """range [rad or m]; infinite if unlimited"""
    hinge: bool


@dataclass(frozen=True)
class JointMap:
    """What a person says about the joints of a source.

    Example:
        `JointMap(joints={"j1": "shoulder"}, scale={"gripper": 0.01})`
    """

    joints: Mapping[str, str] = field(default_factory=dict)
    """source's name: model's name; "" leaves the joint out"""
    scale: Mapping[str, float] = field(default_factory=dict)
    """by the source's name: position · scale + offset, in rad or m"""
    offset: Mapping[str, float] = field(default_factory=dict)


def read_map(path: Path) -> JointMap:
    """A joint map from TOML, with the tables `joints`, `scale` and `offset`.

    Raises:
        ConfigError: if it is no such file.
    """
    tables = load_toml(path, "joint map")
    kinds: dict[str, tuple[type, ...]] = {
        "joints": (str,),
        "scale": (int, float),
        "offset": (int, float),
    }
    for name, table in tables.items():
        if name not in kinds or not isinstance(table, dict):
            raise ConfigError(f"{path}: expected the tables joints, scale, offset, got '{name}'")
        for key, value in table.items():
            if not isinstance(value, kinds[name]) or isinstance(value, bool):
                wanted = "a name" if name == "joints" else "a number"
                raise ConfigError(f"{path}: [{name}] {key}: expected {wanted}, got {value!r}")
    return JointMap(**tables)


def joints_of(model: mujoco.MjModel) -> dict[str, Joint]:
    """The hinges and slides of a model, by name."""
    found = {}
    for i in range(model.njnt):
        kind = int(model.jnt_type[i])
        hinge = kind == int(mujoco.mjtJoint.mjJNT_HINGE)
        if not hinge and kind != int(mujoco.mjtJoint.mjJNT_SLIDE):
            continue
        low, high = model.jnt_range[i] if model.jnt_limited[i] else (-np.inf, np.inf)
        name = model.joint(i).name or f"joint_{i}"
        place = int(model.jnt_qposadr[i]), int(model.jnt_dofadr[i])
        found[name] = Joint(name, *place, float(low), float(high), hinge)
    return found


def mapped(motion: Motion, given: JointMap) -> Motion:
    """The motion with joints renamed, scaled and left out as a person says.

    Raises:
        ConfigError: if the map speaks of a joint that the source lacks.
    """
    for table in (given.joints, given.scale, given.offset):
        for name in table:
            if name not in motion.names:
                raise ConfigError(
                    f"--joints: {name}: not in {motion}{_nearest(name, motion.names)}"
                )
    if given == JointMap():
        return motion
    kept = [i for i, name in enumerate(motion.names) if given.joints.get(name, name)]
    scale = np.array([given.scale.get(motion.names[i], 1.0) for i in kept])
    offset = np.array([given.offset.get(motion.names[i], 0.0) for i in kept])
    left = [name for name in motion.names if not given.joints.get(name, name)]
    notes = (*motion.notes, f"left out as told: {', '.join(left)}") if left else motion.notes
    return replace(
        motion,
        names=tuple(given.joints.get(motion.names[i], motion.names[i]) for i in kept),
        position=motion.position[:, kept] * scale + offset,
        velocity=None if motion.velocity is None else motion.velocity[:, kept] * scale,
        action=None if motion.action is None else motion.action[:, kept] * scale + offset,
        notes=notes,
    )


def require_named(motion: Motion) -> None:
    """Hold every joint of a motion to have a name of its own.

    Raises:
        FormatError: naming the first that has none, or another's.
    """
    for i, name in enumerate(motion.names):
        if not name:
            raise FormatError(f"{motion}: joint {i}: expected a name, got none")
        if name in motion.names[:i]:
            raise FormatError(f"{motion}: expected each joint once, got {name} twice")


def require_known(motion: Motion, joints: Mapping[str, Joint]) -> None:
    """Hold every joint of a motion to be one of the model, each once.

    Raises:
        FormatError: naming those that are not, each with the nearest names of the model.
    """
    twice = sorted({name for name in motion.names if motion.names.count(name) > 1})
    if twice:
        raise FormatError(f"{motion}: expected each joint once, got {', '.join(twice)} twice")
    lost = [name for name in motion.names if name not in joints]
    if lost:
        said = "; ".join(f"{name}{_nearest(name, list(joints))}" for name in lost[:8])
        more = f" and {len(lost) - 8} more" if len(lost) > 8 else ""
        raise FormatError(
            f"{motion}: {len(lost)} of {len(motion.names)} joints are none of the model: "
            f"{said}{more}; name them in --joints MAP.toml"
        )


def in_radians(motion: Motion, degrees: bool, hinges: Sequence[bool]) -> Motion:
    """The motion with its hinges turned from degrees into radians, if a person says so."""
    if not degrees:
        return motion
    factor = np.where(np.asarray(hinges, bool), np.pi / 180, 1.0)
    velocity, action = motion.velocity, motion.action
    return replace(
        motion,
        position=motion.position * factor,
        velocity=None if velocity is None else velocity * factor,
        action=None if action is None else action * factor,
        notes=(*motion.notes, "angles turned from degrees into radians, as told"),
    )


def doubts(motion: Motion, joints: Mapping[str, Joint]) -> list[str]:
    """What about the positions looks like another unit, one sentence each."""
    low, high = motion.position.min(axis=0), motion.position.max(axis=0)
    known = [joints.get(name) for name in motion.names]
    angles = [i for i, joint in enumerate(known) if joint is None or joint.hinge]
    outside = [
        i for i, joint in enumerate(known) if joint is not None and _out(joint, low, high, i)
    ]
    reach = np.maximum(np.abs(low), np.abs(high))
    large = [i for i in angles if reach[i] > 2 * np.pi * BEYOND]
    fits = all(
        joint is None or not _out(joint, np.radians(low), np.radians(high), i)
        for i, joint in enumerate(known)
        if i in angles
    )
    if large and fits and (len(outside) > len(angles) / 2 or joints == {}):
        worst = max(large, key=lambda i: reach[i])
        return [
            f"{motion.names[worst]} reaches {reach[worst]:.4g}: degrees are suspected; --degrees "
            "turns them into radians"
        ]
    return [
        f"{motion.names[i]} goes from {low[i]:.4g} to {high[i]:.4g}, "
        f"outside the model's {known[i].low:.4g} to {known[i].high:.4g}"  # type: ignore[union-attr]
        for i in outside
    ]


def _out(joint: Joint, low: Array, high: Array, i: int) -> bool:
    slack = (BEYOND - 1) * max(abs(joint.low), abs(joint.high))
    return bool(low[i] < joint.low - slack or high[i] > joint.high + slack)


def _nearest(name: str, choices: Sequence[str]) -> str:
    near = difflib.get_close_matches(name, choices, n=3, cutoff=0.4) or list(choices)[:3]
    return f" (nearest: {', '.join(near)})" if near else ""
