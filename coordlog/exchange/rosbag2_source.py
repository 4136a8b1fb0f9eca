"""ROS 2 bags in: a folder, a bare MCAP or an sqlite3 file, read through rosbags.

Joint states that are laid out alike are decoded together, one NumPy call for thousands; the other
message types one by one.

Source: OMG CDR (XCDR1, little endian); sensor_msgs, trajectory_msgs, control_msgs of ROS 2.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rosbags.highlevel import AnyReader, AnyReaderError
from rosbags.interfaces import Connection

from coordlog.episode import Array
from coordlog.errors import ConfigError, FormatError
from coordlog.exchange.motion import NS, Motion
from coordlog.exchange.rosbag2 import ros2

JOINT_STATE = "sensor_msgs/msg/JointState"
TRAJECTORY = "trajectory_msgs/msg/JointTrajectory"
DYNAMIC = "control_msgs/msg/DynamicJointState"
KINDS = (JOINT_STATE, DYNAMIC, TRAJECTORY)
"""Message types that hold joint motion; the first of these in a bag is taken."""


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
        raw = [(int(time), bytes(data)) for _, time, data in bag.messages([connection])]
        if connection.msgtype == TRAJECTORY:
            yield from _trajectories(bag, connection, path, raw)
            return
        if connection.msgtype == JOINT_STATE:
            motion = _joint_states(path, connection.topic, raw, stamps)
        else:
            motion = _dynamic(bag, connection, path, raw, stamps)
    yield motion


def stamps_of(path: Path, topic: str) -> Array:
    """Log times of every message on a topic [ns]: where episodes begin."""
    with opened(path) as bag:
        found = [item for item in bag.connections if item.topic == topic]
        if not found:
            names = ", ".join(sorted({item.topic for item in bag.connections}))
            raise ConfigError(f"{path}: no topic '{topic}'; it has {names}")
        return np.array([time for _, time, _ in bag.messages(found)], np.int64)


@contextmanager
def opened(path: Path) -> Iterator[Any]:
    """A bag for reading; what rosbags cannot read becomes one sentence.

    Raises:
        FormatError: if it is damaged, encrypted, or not a bag.
    """
    try:
        with AnyReader([path], default_typestore=ros2()) as bag:
            yield bag
    except (FormatError, ConfigError):
        raise
    except (AnyReaderError, OSError, ValueError, KeyError, IndexError, AssertionError) as error:
        raise FormatError(f"{path}: {_said(error)}") from error
    except Exception as error:
        raise FormatError(f"{path}: {_said(error)}") from error


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
            f"{path}: expected {', '.join(KINDS)}, got {had or 'no topics'}: there is no joint motion to import"
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


def _joint_states(path: Path, topic: str, raw: list[tuple[int, bytes]], clock: str) -> Motion:
    """All joint states of a topic; groups of messages with equal names are decoded at once."""
    groups: dict[tuple[bytes, int], list[int]] = {}
    for i, (_, data) in enumerate(raw):
        head = _names_end(data, path, i)
        groups.setdefault((data[12:head], len(data)), []).append(i)
    names: tuple[str, ...] = ()
    count = len(raw)
    position = velocity = np.zeros((0, 0))
    header = np.zeros(count, np.int64)
    moving = True
    for members in groups.values():
        alike = [raw[i][1] for i in members]
        own, sec, columns = _decoded(alike, path, members[0])
        if not names:
            names = own
            position, velocity = np.full((2, count, len(names)), np.nan)
        order = _order(own, names, path, topic, members[0])
        header[members] = sec
        position[np.ix_(members, order)] = columns[0]
        moving = moving and columns[1].shape == columns[0].shape
        if moving:
            velocity[np.ix_(members, order)] = columns[1]
    log = np.array([time for time, _ in raw], np.int64)
    stamps, said = chosen_clock(header, log, clock)
    return Motion(
        path,
        "rosbag2",
        topic,
        names,
        stamps,
        position,
        velocity if moving and np.isfinite(velocity).all() else None,
        clock=said,
        where={"topic": topic, "type": JOINT_STATE},
    )


def _names_end(data: bytes, path: Path, i: int) -> int:
    """Where the joint names of a serialized JointState end."""
    try:
        at = 16 + int.from_bytes(data[12:16], "little")
        at += -at % 4
        count = int.from_bytes(data[at : at + 4], "little")
        at += 4
        for _ in range(count):
            size = int.from_bytes(data[at : at + 4], "little")
            at += 4 + size + (-size % 4)
            if at > len(data) + 3:
                raise FormatError(f"{path}: message {i}: a JointState that ends within its names")
    except struct.error as error:
        raise FormatError(f"{path}: message {i}: {error}") from error
    return at


def _decoded(data: list[bytes], path: Path, i: int) -> tuple[tuple[str, ...], Array, list[Array]]:
    """Names, header stamps [ns] and position, velocity, effort of messages laid out alike."""
    first = data[0]
    if first[:2] != b"\x00\x01":
        raise FormatError(
            f"{path}: message {i}: expected little-endian CDR, got encapsulation {first[:2].hex()}"
        )
    table = np.frombuffer(b"".join(data), np.uint8).reshape(len(data), -1)
    stamps = table[:, 4:12].copy().view("<i4").astype(np.int64)
    ns = stamps[:, 0] * NS + table[:, 8:12].copy().view("<u4")[:, 0]
    names = _names(first)
    at = _names_end(first, path, i)
    columns = []
    for _ in range(3):
        at += -at % 4
        size = int.from_bytes(first[at : at + 4], "little")
        counts = table[:, at : at + 4].copy().view("<u4")[:, 0]
        at += 4
        if size:
            at += -(at - 4) % 8
        if (counts != size).any() or at + 8 * size > len(first):
            raise FormatError(f"{path}: message {i}: a JointState whose lengths do not add up")
        values = table[:, at : at + 8 * size].copy().view("<f8").reshape(len(data), size)
        columns.append(values)
        at += 8 * size
    if columns[0].shape[1] != len(names):
        raise FormatError(
            f"{path}: message {i}: expected a position for each of {len(names)} joints, got {columns[0].shape[1]}"
        )
    return names, ns, columns


def _names(data: bytes) -> tuple[str, ...]:
    at = 16 + int.from_bytes(data[12:16], "little")
    at += -at % 4
    count, found = int.from_bytes(data[at : at + 4], "little"), []
    at += 4
    for _ in range(count):
        at += -at % 4
        size = int.from_bytes(data[at : at + 4], "little")
        found.append(data[at + 4 : at + 3 + size].decode("utf-8", "replace"))
        at += 4 + size
    return tuple(found)


def _order(
    own: tuple[str, ...], names: tuple[str, ...], path: Path, topic: str, i: int
) -> list[int]:
    """Places of a message's joints among those of the first message."""
    if sorted(own) != sorted(names):
        missing = sorted(set(names) ^ set(own))
        raise FormatError(
            f"{path}: {topic}: message {i}: expected the joints of the first message, got others: {', '.join(missing)}; several publishers share the topic"
        )
    return [names.index(name) for name in own]


def _dynamic(
    bag: Any, connection: Connection, path: Path, raw: list[tuple[int, bytes]], clock: str
) -> Motion:
    """All dynamic joint states of a topic: interface values by name."""
    rows = []
    for i, (_, data) in enumerate(raw):
        message = bag.deserialize(data, connection.msgtype)
        found = {}
        for name, value in zip(message.joint_names, message.interface_values, strict=True):
            pairs = dict(zip(value.interface_names, value.values, strict=True))
            if "position" in pairs:
                found[str(name)] = (pairs["position"], pairs.get("velocity", np.nan))
        if not found:
            raise FormatError(f"{path}: {connection.topic}: message {i}: no 'position' interface")
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
    stamps, said = chosen_clock(header, np.array([time for time, _ in raw], np.int64), clock)
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
        message = bag.deserialize(data, connection.msgtype)
        after = [p.time_from_start.sec * NS + p.time_from_start.nanosec for p in message.points]
        position = np.array([point.positions for point in message.points], np.float64)
        velocity = np.array([point.velocities for point in message.points], np.float64)
        yield Motion(
            path,
            "rosbag2",
            f"{connection.topic} message {i}",
            tuple(map(str, message.joint_names)),
            time + np.array(after, np.int64),
            position.reshape(len(after), -1),
            velocity if velocity.shape == position.shape else None,
            clock="time_from_start",
            where={"topic": connection.topic, "type": TRAJECTORY, "message": i},
        )


def chosen_clock(header: Array, log: Array, wanted: str) -> tuple[Array, str]:
    """The stamps that are asked for, or the header's unless all of them are zero."""
    if wanted not in ("", "header", "log"):
        raise ConfigError(f"--stamps: expected header or log, got '{wanted}'")
    if wanted == "log" or (not wanted and not header.any()):
        return log, "log time"
    return header, "header stamps"


def _said(error: Exception) -> str:
    """The first line of what a library says, or what kind of error it was."""
    lines = str(error).strip().splitlines()
    text = lines[0] if lines else type(error).__name__
    return f"not a bag that can be read: {text}"
