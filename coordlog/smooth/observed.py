"""An observed episode smoothed: what somebody else's robot did, moved more softly.

Nothing says what drove it, so the path is not executed: the episode that comes back is the path at
the log's own times, proven by its own model as any other path is, and says that it is kinematic.
"""

from __future__ import annotations

import hashlib
from dataclasses import replace
from typing import cast

import mujoco
import numpy as np

from coordlog.config import build
from coordlog.episode import CONTACT, Array, Episode, Json
from coordlog.errors import FormatError
from coordlog.kinematics.base_motion import require_fit
from coordlog.kinematics.clearance import SceneChecker
from coordlog.record.recording import Recording
from coordlog.robots.robot import Robot
from coordlog.smooth.feasibility import DistanceChecker
from coordlog.smooth.limits import Limits
from coordlog.smooth.result import FALLBACK, Result
from coordlog.smooth.smoother import smooth
from coordlog.tasks.config import EnvConfig

TRANSFORM = "smooth"
KINEMATIC = "kinematic: the path itself at the log's times, not executed"
FASTER = 1.02
"""A path may be faster than the log's fastest straight line between samples by this factor."""


def smooth_observed(recording: Recording, settings: Json) -> tuple[Episode, Json]:
    """Smooth an observed episode under its own model.

    Args:
        recording: The episode; it must carry its model.
        settings: Options of `coordlog.smooth.smooth`.

    Returns:
        The episode that takes its place, and the parameters that its lineage holds.

    Raises:
        FormatError: if it carries no model, or one that is not its own.
        SpecError: if it cannot be smoothed as it is; the message says why.
    """
    episode = recording.episode
    if not recording.attachments:
        raise FormatError(
            f"{recording.source}: an observed episode without a model: nothing could be proven; import it with --robot MODEL"
        )
    model, initial = recording.model, recording.initial_state
    require_fit(model, initial, episode)
    robot = Robot.from_json(episode.header.env["robot"])
    joints = [model.joint(name) for name in robot.action_joints]
    places = np.array([int(joint.qposadr[0]) for joint in joints])
    checker = SceneChecker(
        model,
        robot,
        build(EnvConfig, {}),
        time=episode.time,
        qpos=episode.qpos,
        initial=initial,
    )
    angles = episode.qpos[:, places]
    result = smooth(
        episode.time,
        angles,
        # The checker is one by its methods: kinematics knows nothing of smoothing.
        cast("DistanceChecker", checker),
        limits=_limits(model, [joint.id for joint in joints], episode.time, angles),
        continuous=checker.continuous,
        joints=robot.action_joints,
        units=checker.units,
        ends="natural" if settings["method"] == "paper" else "soft",
        **settings,
    )
    moved = result.status != FALLBACK and bool(result.lam.any())
    parameters = _parameters(result, settings, robot.action_joints, moved=moved)
    return _episode(recording, result, parameters, places, moved=moved), parameters


def _limits(model: mujoco.MjModel, joints: list[int], time: Array, angles: Array) -> Limits:
    """The model's ranges, widened to where the log itself has been; speeds of the log."""
    limited = model.jnt_limited[joints].astype(bool)
    low = np.where(limited, model.jnt_range[joints, 0], -np.inf)
    high = np.where(limited, model.jnt_range[joints, 1], np.inf)
    speed = np.abs(np.diff(angles, axis=0) / np.diff(time)[:, None]).max(axis=0)
    return Limits(
        np.minimum(low, angles.min(axis=0)),
        np.maximum(high, angles.max(axis=0)),
        speed=FASTER * np.maximum(speed, 1e-6),
    )


def _episode(
    recording: Recording, result: Result, parameters: Json, places: Array, *, moved: bool
) -> Episode:
    raw = recording.episode
    lineage = {"parents": [recording.digest], "transform": TRANSFORM, "parameters": parameters}
    name = hashlib.sha256(f"{recording.digest}/{TRANSFORM}/{parameters}".encode()).hexdigest()[:16]
    header = replace(raw.header, episode=raw.header.episode | {"id": name}, lineage=lineage)
    if not moved:
        columns = dict(raw.columns)
        return Episode(header, raw.result, contacts=raw.contacts, columns=columns)
    policy = raw.header.policy | {"kind": f"{raw.header.policy['kind']}, smoothed"}
    position = np.asarray(result.spline(raw.time))
    qpos, qvel = raw.qpos.copy(), raw.qvel.copy()
    qpos[:, places] = position
    speeds = {int(item["qpos"]): int(item["qvel"]) for item in raw.header.env["joints"]}
    qvel[:, [speeds[place] for place in places.tolist()]] = np.asarray(result.spline(raw.time, 1))
    columns = dict(raw.columns) | {
        "qpos": qpos,
        "qvel": qvel,
        "state": position.astype(np.float32),
        "action": position[1:].astype(np.float32),
    }
    return Episode(
        replace(header, policy=policy),
        raw.result,  # the writer computes it anew
        contacts=np.zeros(0, CONTACT),
        path=result.path(),
        columns=columns,
    )


def _parameters(result: Result, settings: Json, joints: tuple[str, ...], *, moved: bool) -> Json:
    """What is worth knowing about one smoothing; the keys of an executed one that there are."""
    steps = len(result.knots.time) - 1
    none = {"peak": None, "rate": None}
    return {
        "settings": settings,
        "status": result.status,
        "reason": result.reason,
        "steps_of": "path" if moved else "log",
        "execution": KINEMATIC if moved else "",
        "certified": bool(result.certified) and moved,
        "joints": [
            {"name": name, "lam": lam}
            for name, lam in zip(joints, result.lam.tolist(), strict=True)
        ],
        "deviation": dict(zip(joints, result.deviation.tolist(), strict=True)),
        "before": {name: _number(value) for name, value in result.before._asdict().items()},
        "after": {name: _number(value) for name, value in result.after._asdict().items()},
        "torque": {"before": none, "after": none},
        "steps": {"before": steps, "after": steps},
        "checks": result.checks,
        "slacks": result.slacks,
    }


def _number(value: float) -> float | None:
    """JSON has no infinity and no NaN: None stands for both."""
    return float(value) if np.isfinite(value) else None
