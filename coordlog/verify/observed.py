"""What can be proven of an observed episode, and what cannot.

Its file is held to structure and content as any other. Nothing says what forces moved the robot, so
no physics is replayed; what its own model says of its samples is counted and told: limits, speeds,
contact. None of that makes an observation wrong, and nothing of it is called sound.
"""

from __future__ import annotations

import mujoco
import numpy as np

from coordlog.episode import Array, Episode
from coordlog.errors import CoordlogError
from coordlog.record.recording import Recording

SLACK = 1e-3
"""Beyond its range by more than this a joint is outside [rad, m]."""
_SCALAR = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
UNPROVEN = "physics, torques and balance cannot be proven"


def judged(recording: Recording) -> str:
    """One sentence about an observed episode; "" for one that was simulated.

    Raises:
        FormatError: if the file is no finished episode.
    """
    if recording.header.kind != "observed":
        return ""
    said = [_speeds(recording.episode)]
    if recording.attachments:
        try:
            said += [_limits(recording.episode, recording.model)]
            said += [_contacts(recording.episode, recording.model)]
        except CoordlogError as error:
            said += [f"its model does not load: {error}"]
    else:
        said += ["without a model: no limits, no contact"]
    return f"observed, not simulated: {recording.source}: {'; '.join(said)}; {UNPROVEN}"


def _speeds(episode: Episode) -> str:
    """The fastest joint, by the positions and their times."""
    joints = episode.header.env["joints"]
    if not joints or len(episode) < 1:
        return "no joint moves"
    steps = np.diff(episode.qpos[:, [int(joint["qpos"]) for joint in joints]], axis=0)
    speed = np.abs(steps) / np.diff(episode.time)[:, None]
    row, joint = np.unravel_index(int(speed.argmax()), speed.shape)
    return f"fastest {joints[int(joint)]['name']}, {speed.max():.3g}/s at sample {int(row)}"


def _limits(episode: Episode, model: mujoco.MjModel) -> str:
    """Joints outside their ranges, the farthest first."""
    outside: list[tuple[float, str]] = []
    for i in np.flatnonzero(model.jnt_limited).tolist():
        if model.jnt_type[i] not in _SCALAR:
            continue
        values = episode.qpos[:, model.jnt_qposadr[i]]
        low, high = model.jnt_range[i]
        beyond: Array = np.maximum(low - values, values - high)
        count = int((beyond > SLACK).sum())
        if count:
            far = float(beyond.max())
            name = model.joint(i).name
            outside.append((far, f"{name} outside its range at {count} samples, by {far:.3g}"))
    if not outside:
        return "joints within their ranges"
    return ", ".join(text for _, text in sorted(outside, reverse=True))


def _contacts(episode: Episode, model: mujoco.MjModel) -> str:
    """Samples at which the model touches itself or its scene, and the deepest of them."""
    data = mujoco.MjData(model)
    touching, deepest, pair = 0, 0.0, ""
    for qpos in episode.qpos:
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_collision(model, data)
        deep = [contact for contact in data.contact[: data.ncon] if contact.dist < 0]
        touching += bool(deep)
        for contact in deep:
            if -contact.dist > deepest:
                deepest = float(-contact.dist)
                pair = " and ".join(_name(model, int(geom)) for geom in contact.geom)
    if not touching:
        return "no contact of the model with itself or its scene at the samples"
    return (
        f"contact at {touching} of {len(episode.qpos)} samples, deepest {deepest * 1e3:.3g} mm "
        f"({pair})"
    )


def _name(model: mujoco.MjModel, geom: int) -> str:
    return str(model.geom(geom).name or model.body(int(model.geom_bodyid[geom])).name or geom)
