"""Somebody else's joint motion as an episode of ours: *observed*, not simulated.

N samples are the N states of an episode of N - 1 steps. What an action was is taken from the source
where it commands the same joints; otherwise it is the position that was reached next. Nothing is
rewarded, nothing is claimed to replay. Every number is the source's, turned into the model's units
where a person said so; the lineage says what was done and names the source by its sha256.
"""

from __future__ import annotations

import platform
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import mujoco
import numpy as np

from coordlog.episode import CONTACT, INITIAL_STATE, Array, Episode, Header, Json
from coordlog.exchange.joints import Joint, joints_of
from coordlog.exchange.motion import NS, Motion
from coordlog.exchange.robot_model import RobotModel
from coordlog.record.tally import Tally
from coordlog.sim.physics import STATE
from coordlog.spec import SCHEMA_VERSION
from coordlog.version import __version__

KIND = "observed"


class Placed(NamedTuple):
    """Where the joints of a motion stand in qpos and qvel."""

    joints: list[Joint]
    qpos: Array
    """(n_q,): what the model is at where the source says nothing"""
    n_v: int


def observe(
    motion: Motion,
    robot: RobotModel | None,
    *,
    digest: str,
    index: int,
    parameters: Json,
) -> Episode:
    """A motion as an episode.

    Args:
        motion: Prepared: finite, its time going forward, in rad and m, its joints the model's.
        robot: The model; None for an episode of joints alone.
        digest: sha256 of the source.
        index: Number of the episode in its source.
        parameters: What was done on the way here, for the lineage.

    Raises:
        SpecError: if the columns do not fit the header.
    """
    placed = _placed(motion, robot)
    length = len(motion) - 1
    velocity, made = _velocity(motion)
    qpos = _spread(motion.position, [joint.qpos for joint in placed.joints], placed.qpos)
    qvel = _spread(velocity, [joint.qvel for joint in placed.joints], np.zeros(placed.n_v))
    action = motion.position[1:] if motion.action is None else motion.action[:-1]
    truncated = np.zeros(length, bool)
    truncated[-1:] = True
    columns = {
        "time": (motion.stamps - motion.stamps[0]) / NS,
        "qpos": qpos,
        "qvel": qvel,
        "state": motion.position.astype(np.float32),
        "action": action.astype(np.float32),
        "reward": np.zeros((length, 0)),
        "terminated": np.zeros(length, bool),
        "truncated": truncated,
    }
    said = parameters | {"velocity": made, "timing": motion.timing.to_json()}
    said["action"] = "source" if motion.action is not None else "the position reached next"
    if motion.action is not None:
        said["last_action"] = motion.action[-1].tolist()
    header = _header(motion, robot, placed, digest=digest, index=index, parameters=said)
    tally = Tally(header)
    tally.add_states({"qpos": qpos, "qvel": qvel})
    result = replace(tally.result(""), length=length, truncated=length > 0)
    return Episode(header, result, contacts=np.zeros(0, CONTACT), columns=columns)


def attachments(episode: Episode, robot: RobotModel | None) -> Mapping[str, bytes]:
    """What an observed episode carries: its model, at rest in the first sample."""
    if robot is None:
        return {}
    data = mujoco.MjData(robot.model)
    data.qpos[:], data.qvel[:] = episode.qpos[0], episode.qvel[0]
    mujoco.mj_forward(robot.model, data)
    state = np.zeros(mujoco.mj_stateSize(robot.model, STATE))
    mujoco.mj_getState(robot.model, data, state, STATE)
    return {**robot.attachments, INITIAL_STATE: state.tobytes()}


def _placed(motion: Motion, robot: RobotModel | None) -> Placed:
    if robot is None:
        joints = [
            Joint(name, i, i, -np.inf, np.inf, hinge=True) for i, name in enumerate(motion.names)
        ]
        return Placed(joints, np.zeros(len(joints)), len(joints))
    known = joints_of(robot.model)
    return Placed([known[name] for name in motion.names], robot.rest, int(robot.model.nv))


def _spread(values: Array, places: list[int], rest: Array) -> Array:
    """Columns (N, joints) at their places (N, n); what has none is at rest."""
    if places == list(range(len(rest))):
        return values
    whole = np.tile(rest, (len(values), 1))
    whole[:, places] = values
    return whole


def _velocity(motion: Motion) -> tuple[Array, str]:
    """The source's velocities, or differences over the real times."""
    if motion.velocity is not None:
        return motion.velocity, "source"
    if len(motion) < 2:
        return np.zeros_like(motion.position), "unknown: a single sample"
    seconds = (motion.stamps - motion.stamps[0]) / NS
    slopes: Array = np.gradient(motion.position, seconds, axis=0)
    return slopes, "differences of the positions over their times"


def _header(
    motion: Motion,
    robot: RobotModel | None,
    placed: Placed,
    *,
    digest: str,
    index: int,
    parameters: Json,
) -> Header:
    name = robot.name if robot is not None else str(motion.where.get("robot_type") or "unknown")
    episode = {
        "schema_version": SCHEMA_VERSION,
        "kind": KIND,
        "id": f"{digest[:12]}-{index:06d}",
        "run": "import",
        "robot": name,
        "scene": "observed",
        "split": "",
        "seed": None,
        "index": index,
        "start": "",
        "control_period": motion.timing.period or 1.0,
        "start_time": int(motion.stamps[0]),
        "goals": [],
        "obstacles": [],
        "task": motion.task,
        "source": {
            "format": motion.format,
            "name": motion.source.name,
            "place": motion.place,
            "sha256": digest,
            "joints": list(parameters.get("source_joints", motion.names)),
            "map": parameters.get("map", {name: [name, 1.0, 0.0] for name in motion.names}),
            **motion.where,
        },
    }
    policy = {"kind": KIND, "name": motion.format, "checkpoint_sha256": "", "noise": {}}
    lineage = {"parents": [digest], "transform": "import", "parameters": parameters}
    return Header(episode, _env(robot, placed, name), policy, lineage)


def _env(robot: RobotModel | None, placed: Placed, name: str) -> Json:
    named = [joint.name for joint in placed.joints]
    listed: Sequence[Joint] = (
        placed.joints if robot is None else tuple(joints_of(robot.model).values())
    )
    width = len(named)
    return {
        "coordlog_version": __version__,
        "mujoco_version": mujoco.__version__,
        "architecture": platform.machine(),
        "task": {"name": "", "fields": []},
        "reward": {},
        "config": {},
        "robot": {"name": name} if robot is None else robot.spec(named),
        "joints": [
            {"name": joint.name, "qpos": joint.qpos, "qvel": joint.qvel} for joint in listed
        ],
        "actuators": [],
        "geoms": [] if robot is None else robot.geoms,
        "arms": {},
        "action_joints": named,
        "state": named,
        "layout": {
            "n_q": len(placed.qpos),
            "n_v": placed.n_v,
            "n_x": width,
            "n_u": width,
            "k": 0,
            "n_c": 0,
        },
    }
