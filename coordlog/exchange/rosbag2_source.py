"""ROS 2 bags in: a folder, a bare MCAP or an sqlite3 file, read through rosbags.

Joint states that are laid out alike are decoded together, one NumPy call for thousands; the other
message types one by one.

Source: OMG CDR (XCDR1, little endian); sensor_msgs, trajectory_msgs, control_msgs of ROS 2.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rosbags.highlevel import AnyReader, AnyReaderError
from rosbags.interfaces import Connection

from coordlog.episode import Array
from coordlog.errors import ConfigError, FormatError
from coordlog.exchange.frames import of_files, require_whole
from coordlog.exchange.joint_state import decode
from coordlog.exchange.motion import NS, Motion
from coordlog.exchange.rosbag2_metadata import ros2

JOINT_STATE = "sensor_msgs/msg/JointState"
TRAJECTORY = "trajectory_msgs/msg/JointTrajectory"
DYNAMIC = "control_msgs/msg/DynamicJointState"
KINDS = (JOINT_STATE, DYNAMIC, TRAJECTORY)
"""Message types that hold joint motion; the first of these in a bag is taken."""
SIMULATED = 10**17
"""Stamps below this [ns] count from the start of a simulation, not from 1970."""


class Row(NamedTuple):
    """One message, decoded."""

    names: tuple[str, ...]
    stamp: int
    position: Array
    velocity: Array | None


def motions(path: Path, *, topic: str = "", stamps: str = "") -> Iterator[Motion]:
    """The joint motion in a bag.

    Args:
        path: Folder of a bag, or its MCAP or sqlite3 file.
        topic: Topic to read; "" for the only one that can be.
        stamps: "header", "log", or "" for the header's unless they are all zero.

    Raises:
        FormatError: if the bag is damaged or holds no joint motion.
        ConfigError: if several topics could be meant, or there is none of that name.
    """
    with opened(path) as bag:
        connection = chosen(bag, path, topic)
        files = _files(bag, path)
        if connection.msgtype == JOINT_STATE:
            yield _joint_states(files, path, connection.topic, stamps)
            return
        raw = list(_messages(files, connection.topic))
        if connection.msgtype == TRAJECTORY:
            yield from _trajectories(bag, connection, path, raw)
            return
        motion = _dynamic(bag, connection, path, raw, stamps)
    yield motion


def stamps_of(path: Path, topic: str) -> Array:
    """Log times of every message on a topic [ns]: where episodes begin."""
    with opened(path) as bag:
        found = [item for item in bag.connections if item.topic == topic]
        if not found:
            names = ", ".join(sorted({item.topic for item in bag.connections}))
            raise ConfigError(f"{path}: no topic '{topic}'; it has {names}")
        parts = of_files(_files(bag, path), topic)
        return np.concatenate([np.zeros(0, np.int64), *(part.times for part in parts)])


@contextmanager
def opened(path: Path) -> Iterator[Any]:
    """A bag for reading; what rosbags cannot read becomes one sentence.

    Raises:
        FormatError: if it is damaged, encrypted, or not a bag.
    """
    try:
        for file in [path] if path.is_file() else sorted(path.iterdir()):
            require_whole(file)
        bag = AnyReader([path], default_typestore=ros2())
        bag.open()
    except FormatError:
        raise
    except Exception as error:  # rosbags lets errors of its decompressors and parsers through
        raise FormatError(f"{path}: {_said(error)}") from error
    try:
        yield bag
    except (AnyReaderError, OSError) as error:
        raise FormatError(f"{path}: {_said(error)}") from error
    finally:
        bag.close()


def chosen(bag: Any, path: Path, topic: str) -> Connection:
    """The connection that holds the joint motion.

    Raises:
        FormatError: if none does.
        ConfigError: if several do, or not the one that is asked for.
    """
    usable = [item for item in bag.connections if item.msgtype in KINDS]
    had = ", ".join(sorted({f"{item.topic} ({item.msgtype})" for item in bag.connections}))
    if topic:
        usable = [item for item in usable if item.topic == topic]
        if not usable:
            raise ConfigError(f"{path}: no joint motion on '{topic}'; it has {had or 'no topics'}")
    if not usable:
        raise FormatError(
            f"{path}: expected {', '.join(KINDS)}, got {had or 'no topics'}: there is no joint "
            "motion to import"
        )
    first = min(KINDS.index(item.msgtype) for item in usable)
    best = [item for item in usable if item.msgtype == KINDS[first]]
    if len({item.topic for item in best}) > 1:
        names = ", ".join(sorted({item.topic for item in best}))
        raise ConfigError(
            f"{path}: joint motion on several topics; choose one with --topic: {names}"
        )
    found: Connection = best[0]
    return found


def _joint_states(files: list[Path], path: Path, topic: str, clock: str) -> Motion:
    """All joint states of a topic, decoded together."""
    found = decode(of_files(files, topic), f"{path}: {topic}")
    stamps, said = chosen_clock(f"{path}: {topic}", found.header, found.log, clock)
    velocity = found.velocity
    return Motion(
        path,
        "rosbag2",
        topic,
        found.names,
        stamps,
        found.position,
        velocity if velocity is not None and np.isfinite(velocity).all() else None,
        clock=said,
        where={"topic": topic, "type": JOINT_STATE},
    )


def _files(bag: Any, path: Path) -> list[Path]:
    """The storage files of an open bag in order; those that were compressed whole, unpacked.

    Raises:
        FormatError: if messages are compressed one by one.
    """
    if path.is_file():
        return [path]
    reader = bag.readers[0]
    if reader.compression_mode == "message":
        raise FormatError(
            f"{path}: expected messages as they are, got each compressed by itself: `ros2 bag "
            "convert` the bag without compression_mode first"
        )
    return [Path(storage.path) for storage in reader.storage.storages]


def _messages(files: list[Path], topic: str) -> Iterator[tuple[int, bytes]]:
    """Log time and bytes of every message, as they were written."""
    for part in of_files(files, topic):
        rows = {
            place: row.tobytes()
            for places, data in part.groups
            for place, row in zip(places.tolist(), data, strict=True)
        }
        yield from ((time, rows[i]) for i, time in enumerate(part.times.tolist()))


def _deserialized(bag: Any, connection: Connection, data: bytes, where: str) -> Any:
    try:
        return bag.deserialize(data, connection.msgtype)
    except Exception as error:  # whatever reading past the end of the bytes raises
        raise FormatError(
            f"{where}: expected a {connection.msgtype}, got other bytes: {error}"
        ) from error


def _dynamic(
    bag: Any, connection: Connection, path: Path, raw: list[tuple[int, bytes]], clock: str
) -> Motion:
    """All dynamic joint states of a topic: interface values by name."""
    rows = []
    for i, (_, data) in enumerate(raw):
        found = {}
        where = f"{path}: {connection.topic}: message {i}"
        message = _deserialized(bag, connection, data, where)
        if len(message.joint_names) != len(message.interface_values):
            raise FormatError(
                f"{where}: expected interfaces of {len(message.joint_names)} joints, got "
                f"{len(message.interface_values)}"
            )
        for name, value in zip(message.joint_names, message.interface_values, strict=True):
            if len(value.interface_names) != len(value.values):
                raise FormatError(
                    f"{where}: {name}: expected a value for each of "
                    f"{', '.join(value.interface_names)}, got {len(value.values)}"
                )
            pairs = dict(zip(value.interface_names, value.values, strict=True))
            if "position" in pairs:
                found[str(name)] = (pairs["position"], pairs.get("velocity", np.nan))
        if not found:
            had = {each for value in message.interface_values for each in value.interface_names}
            raise FormatError(
                f"{where}: expected an interface 'position', got {', '.join(sorted(had)) or 'none'}"
            )
        names = tuple(sorted(found))
        values = np.array([found[name] for name in names])
        stamp = message.header.stamp
        rows.append(Row(names, stamp.sec * NS + stamp.nanosec, values[:, 0], values[:, 1]))
    if len({row.names for row in rows}) != 1:
        raise FormatError(
            f"{path}: {connection.topic}: the joints change from message to message"
            if rows
            else f"{path}: {connection.topic}: not a single message"
        )
    header = np.array([row.stamp for row in rows], np.int64)
    log = np.array([time for time, _ in raw], np.int64)
    stamps, said = chosen_clock(f"{path}: {connection.topic}", header, log, clock)
    velocity = np.stack([row.velocity for row in rows if row.velocity is not None])
    return Motion(
        path,
        "rosbag2",
        connection.topic,
        rows[0].names,
        stamps,
        np.stack([row.position for row in rows]),
        velocity if np.isfinite(velocity).all() else None,
        clock=said,
        where={"topic": connection.topic, "type": DYNAMIC},
    )


def _trajectories(
    bag: Any, connection: Connection, path: Path, raw: list[tuple[int, bytes]]
) -> Iterator[Motion]:
    """Every trajectory message as a motion of its own; time counts from the message's log time."""
    for i, (time, data) in enumerate(raw):
        where = f"{path}: {connection.topic}: message {i}"
        message = _deserialized(bag, connection, data, where)
        if not message.joint_names:
            raise FormatError(f"{where}: expected names of joints, got none")
        after = [p.time_from_start.sec * NS + p.time_from_start.nanosec for p in message.points]
        width = len(message.joint_names)
        for k, point in enumerate(message.points):
            if len(point.positions) != width:
                raise FormatError(
                    f"{where}: point {k}: expected positions of {width} joints, got "
                    f"{len(point.positions)}"
                )
        position = np.array([point.positions for point in message.points], np.float64)
        moving = all(len(point.velocities) == width for point in message.points)
        velocity = np.array([point.velocities if moving else () for point in message.points])
        yield Motion(
            path,
            "rosbag2",
            f"{connection.topic} message {i}",
            tuple(map(str, message.joint_names)),
            time + np.array(after, np.int64),
            position.reshape(len(after), width),
            velocity.reshape(len(after), width) if moving else None,
            clock="time_from_start",
            where={"topic": connection.topic, "type": TRAJECTORY, "message": i},
        )


def chosen_clock(where: str, header: Array, log: Array, wanted: str) -> tuple[Array, str]:
    """The stamps that are asked for, or the header's unless all of them are zero."""
    if wanted not in ("", "header", "log"):
        raise ConfigError(f"--stamps: expected header or log, got '{wanted}'")
    if wanted == "log" or (not wanted and not header.any()):
        return log, "log time"
    unset = np.flatnonzero(header == 0)
    if unset.tolist() == [0] and header.max() < SIMULATED:
        return header, "header stamps"  # a simulation's clock begins there
    if len(unset) and header.any():
        raise FormatError(
            f"{where}: message {unset[0]}: expected a header stamp, got zero, as in {len(unset)} "
            f"of {len(header)} messages; --stamps log takes the log times"
        )
    return header, "header stamps"


def _said(error: Exception) -> str:
    """The first line of what a library says, or what kind of error it was."""
    lines = str(error).strip().splitlines()
    text = lines[0] if lines else type(error).__name__
    return f"not a bag that can be read: {text}"
