"""An import: sources in, observed episodes out, with all that was understood of each.

Every source is read once; its episodes are written one by one, each published whole. A source that
cannot be used leaves no episode behind: it is read to its end before the first is written.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from coordlog.episode import Array, Json
from coordlog.errors import ConfigError, FormatError
from coordlog.exchange.joints import (
    JointMap,
    doubts,
    in_radians,
    joints_of,
    mapped,
    require_known,
    require_named,
)
from coordlog.exchange.motion import Motion, prepared
from coordlog.exchange.observed import attachments, observe
from coordlog.exchange.robot_model import RobotModel
from coordlog.exchange.sources import Reading, digest_of, kind_of, motions
from coordlog.record.beside import keep
from coordlog.record.writer import write_episode

BLOCK = 1000
"""Steps of a chunk: many, for all of them are there before the first is written."""


@dataclass(frozen=True)
class Plan:
    """How sources become episodes.

    Example:
        `Plan(Reading(topic="/joint_states"), gap=0.3)`
    """

    reading: Reading = field(default_factory=Reading)
    joints: JointMap = field(default_factory=JointMap)
    gap: float | None = None
    """begin an episode where nothing came for longer than this [s]"""
    split_topic: str = ""
    """begin an episode at every message on this topic"""
    split_clock: bool = False
    """begin an episode where time steps back"""
    resample: float = 0.0
    """samples a second; 0 keeps the source's"""


class Understood(NamedTuple):
    """One episode as it will be written, and what a person should know about it."""

    motion: Motion
    source_joints: tuple[str, ...]
    """names as the source has them"""
    doubts: tuple[str, ...]

    def to_json(self) -> Json:
        """For `--inspect --json`."""
        motion = self.motion
        return {
            "source": str(motion.source),
            "format": motion.format,
            "place": motion.place,
            "joints": list(motion.names),
            "source_joints": list(self.source_joints),
            "clock": motion.clock,
            "timing": motion.timing.to_json(),
            "velocity": "source" if motion.velocity is not None else "differences",
            "action": "source" if motion.action is not None else "the position reached next",
            "task": motion.task,
            "notes": list(motion.notes),
            "doubts": list(self.doubts),
        }


class Imported(NamedTuple):
    """What became of one source."""

    source: Path
    paths: tuple[Path, ...]
    steps: int
    understood: tuple[Understood, ...]
    left_out: tuple[str, ...]
    """pieces that are no episode, each with the reason"""
    present: int
    """episodes that were there from an earlier import"""


def understood(path: Path, plan: Plan, robot: RobotModel | None) -> Iterator[Understood]:
    """The episodes in a source, prepared and matched with the model.

    Raises:
        FormatError: if the source cannot be used, naming the place.
        ConfigError: if something must be said that is not.
    """
    _require_meant(path, plan)
    starts = _starts(path, plan)
    known = {} if robot is None else joints_of(robot.model)
    for found in motions(path, plan.reading):
        given = found.names
        require_named(found)
        motion = mapped(found, plan.joints)
        if robot is not None:
            require_known(motion, known)
        hinges = [known[name].hinge if name in known else True for name in motion.names]
        motion = in_radians(motion, plan.reading.degrees, hinges)
        rest = [name for name in known if name not in motion.names]
        if rest:
            said = f"not in the source, held at rest: {', '.join(rest)}"
            motion = replace(motion, notes=(*motion.notes, said))
        pieces = prepared(
            motion,
            gap=plan.gap,
            starts=starts,
            split_clock=plan.split_clock,
            rate=plan.resample,
        )
        for i, piece in enumerate(pieces):
            named = replace(piece, where=piece.where | {"piece": i})
            yield Understood(named, given, tuple(doubts(named, known)))


def import_source(
    path: Path,
    out: Path,
    plan: Plan,
    robot: RobotModel | None,
    *,
    force: bool = False,
) -> Imported:
    """Write the episodes of one source.

    Args:
        path: File or folder.
        out: Folder of the episodes; made if it is missing.
        plan: How to read and cut.
        robot: The model; None for episodes of joints alone.
        force: Write episodes that are there again.

    Raises:
        FormatError: if the source cannot be used; nothing was written of it then.
        StorageError: if an episode cannot be written.
    """
    digest = digest_of(path)
    pieces = list(understood(path, plan, robot))
    left_out = [
        f"{piece.motion}: a single sample, at {piece.motion.stamps[0]} ns: not an episode"
        for piece in pieces
        if len(piece.motion) < 2
    ]
    kept = [piece for piece in pieces if len(piece.motion) > 1]
    if not kept:
        raise FormatError(
            f"{path}: expected two samples of different stamps in a row, got {len(pieces)} by "
            "themselves"
            + "".join(f"; {note}" for piece in pieces[:1] for note in piece.motion.notes)
        )
    out.mkdir(parents=True, exist_ok=True)
    if robot is not None:
        keep(out, robot.looks.meshes)
    paths, present = [], 0
    for index, piece in enumerate(kept):
        target = out / f"{_stem(path)}-{index:06d}-{_mark(digest, plan, robot)}.mcap"
        paths.append(target)
        if target.exists() and not force:
            present += 1
            continue
        target.unlink(missing_ok=True)
        target.with_name(target.name + ".part").unlink(missing_ok=True)
        parameters = _parameters(piece, plan, robot)
        episode = observe(piece.motion, robot, digest=digest, index=index, parameters=parameters)
        write_episode(
            target, episode, attachments=attachments(episode, robot), display=True, block=BLOCK
        )
    steps = sum(len(piece.motion) - 1 for piece in kept)
    return Imported(path, tuple(paths), steps, tuple(kept), tuple(left_out), present)


_MEANT = {
    "topic": ("rosbag2", "mcap"),
    "stamps": ("rosbag2",),
    "state": ("lerobot", "robomimic", "minari"),
    "action": ("lerobot",),
    "columns": ("parquet", "csv"),
    "clock": ("parquet", "csv"),
    "names": ("mcap", "robomimic", "minari"),
    "names_field": ("mcap",),
    "position_field": ("mcap",),
    "rate": ("robomimic", "minari", "parquet", "csv"),
}
"""Kinds of sources that each way of reading means something for."""


def _require_meant(path: Path, plan: Plan) -> None:
    """Hold what was said about reading to mean something for this source."""
    kind = kind_of(path)
    for name, kinds in _MEANT.items():
        if getattr(plan.reading, name) and kind not in kinds:
            option = "--" + name.replace("_", "-")
            raise ConfigError(f"{path}: {option} is for {', '.join(kinds)}; this is {kind}")


def _starts(path: Path, plan: Plan) -> Array | None:
    if not plan.split_topic:
        return None
    if kind_of(path) != "rosbag2":
        raise ConfigError(f"{path}: --split-topic is for ROS 2 bags; this is a {kind_of(path)}")
    from coordlog.exchange.rosbag2_source import stamps_of

    return np.sort(stamps_of(path, plan.split_topic))


def _parameters(piece: Understood, plan: Plan, robot: RobotModel | None) -> Json:
    """What was done on the way, for the lineage; JSON alone."""
    reading = {key: value for key, value in asdict(plan.reading).items() if value}
    return {
        "reading": reading
        | ({"columns": list(plan.reading.columns)} if plan.reading.columns else {}),
        "joint_map": {
            "joints": dict(plan.joints.joints),
            "scale": dict(plan.joints.scale),
            "offset": dict(plan.joints.offset),
        },
        "source_joints": list(piece.source_joints),
        "map": _map(piece, plan, robot),
        "clock": piece.motion.clock,
        "resampled": plan.resample or None,
        "robot": robot.name if robot is not None else None,
        "notes": list(piece.motion.notes),
        "doubts": list(piece.doubts),
    }


def _map(piece: Understood, plan: Plan, robot: RobotModel | None) -> Json:
    """What leads back: by the source's name the model's joint, and position = source · factor +
    offset.
    """
    known = {} if robot is None else joints_of(robot.model)
    found: Json = {}
    for name in piece.source_joints:
        joint = plan.joints.joints.get(name, name)
        if not joint:
            continue
        hinge = known[joint].hinge if joint in known else True
        turn = math.pi / 180 if plan.reading.degrees and hinge else 1.0
        scale, offset = plan.joints.scale.get(name, 1.0), plan.joints.offset.get(name, 0.0)
        found[name] = [joint, scale * turn, offset * turn]
    return found


def _stem(path: Path) -> str:
    kept = [letter if letter.isalnum() or letter in "-_" else "-" for letter in path.stem]
    return "".join(kept) or "source"


def _mark(digest: str, plan: Plan, robot: RobotModel | None) -> str:
    """Eight letters that differ if source, plan or model do: names never collide."""
    whole = hashlib.sha256(f"{digest}{plan}".encode())
    for content in () if robot is None else robot.attachments.values():
        whole.update(content)
    return whole.hexdigest()[:8]
