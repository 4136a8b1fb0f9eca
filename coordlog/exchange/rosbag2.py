"""ROS 2 bags: a folder `NAME/` per episode with its messages and `metadata.yaml` (version 9).

A log becomes a bag as it is: the file's bytes, attachments and all, under the profile `ros2`, and
its metadata. In sqlite3 its messages are copied byte for byte with their log times, and what is no
message stays in the log. A smoothed episode also has its path as one
`trajectory_msgs/msg/JointTrajectory` on `/joint_trajectory`, in a file of its own before the log's:
the spline's break points with their velocities, its stamp zero, which controllers read as "start
now". The episode's origin is in `custom_data`.

Source: rosbags 0.11.9, rosbag2/; trajectory_msgs of ROS 2.
"""

from __future__ import annotations

import shutil
import sqlite3
import struct
import zlib
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import closing
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Header
from mcap.writer import Writer as McapWriter

from coordlog.episode import Json
from coordlog.episode import Path as JointPath
from coordlog.exchange.blocks import Block, Options
from coordlog.exchange.rosbag2_metadata import (
    File,
    Topic,
    definition,
    hash_of,
    metadata,
    ros2,
    summarized,
)
from coordlog.exchange.source import Loaded
from coordlog.record.chunk import definitions, expand
from coordlog.record.files import PATH_OF_BAG
from coordlog.record.opening import OF_A_BAG, summary_start
from coordlog.record.records import DATA_END, MAGIC, TAIL_SIZE, pack, unpack_definitions, walk

TRAJECTORY_TOPIC = "/joint_trajectory"
TRAJECTORY = "trajectory_msgs/msg/JointTrajectory"
PROFILE = "ros2"
_MESSAGE = struct.Struct("<HIQ")  # channel, sequence, log time
_PREFIX = 22
"""Bytes of an MCAP message before its payload."""
_NS = 1_000_000_000


_TABLES = """
CREATE TABLE schema(schema_version INTEGER PRIMARY KEY, ros_distro TEXT NOT NULL);
CREATE TABLE metadata(
  id INTEGER PRIMARY KEY, metadata_version INTEGER NOT NULL, metadata TEXT NOT NULL);
CREATE TABLE topics(
  id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL,
  serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL,
  type_description_hash TEXT NOT NULL);
CREATE TABLE message_definitions(
  id INTEGER PRIMARY KEY, topic_type TEXT NOT NULL, encoding TEXT NOT NULL,
  encoded_message_definition TEXT NOT NULL, type_description_hash TEXT NOT NULL);
CREATE TABLE messages(
  id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, timestamp INTEGER NOT NULL,
  data BLOB NOT NULL);
CREATE INDEX timestamp_idx ON messages (timestamp ASC);
INSERT INTO schema VALUES (4, 'coordlog');
"""
"""Tables of rosbag2's sqlite3 storage, schema 4."""


class Message(NamedTuple):
    """One message of a log, as it lies in the file."""

    topic: str
    time: int
    """log time [ns]"""
    data: bytes


def write_block(block: Block) -> Json:
    """A bag for each episode of a block."""
    for loaded in block.loaded():
        target = block.folder / loaded.path.stem
        shutil.rmtree(target, ignore_errors=True)  # half a bag of an interrupted export
        write_bag(loaded, target, storage=block.options.storage)
    return {}


def assemble(folder: Path, journals: Sequence[Json], options: Options) -> None:
    """Nothing stands once per set: every bag is whole by itself."""


def write_bag(loaded: Loaded, target: Path, *, storage: str = "mcap") -> None:
    """Write one episode as a bag.

    Args:
        loaded: The episode.
        target: Folder of the bag; must not exist.
        storage: mcap or sqlite3.
    """
    target.mkdir(parents=True)
    episode = loaded.episode
    start = int(episode.header.episode["start_time"])
    moves = b"" if episode.path is None else trajectory(episode.path, _joints(loaded))
    if storage == "sqlite3":
        files = [_sqlite3(loaded.data, target / f"{target.name}.db3", moves, start)]
    else:
        path = target / f"{target.name}.mcap"
        path.write_bytes(_under_profile(loaded.data))
        files = [summarized(loaded.data, path.name)]
        if moves:
            files.insert(0, _trajectory_file(target, moves, start))
    (target / "metadata.yaml").write_text(metadata(files, storage, loaded.named()), "utf-8")


def _joints(loaded: Loaded) -> Sequence[str]:
    return list(loaded.episode.header.env["action_joints"])


def _sqlite3(data: bytes, path: Path, moves: bytes, start: int) -> File:
    """Copy the messages of a log into a database, and add the trajectory of its path."""
    schemas, messages = _messages(data)
    found = list(messages)
    if moves:
        schemas[TRAJECTORY_TOPIC] = (TRAJECTORY, definition(TRAJECTORY))
        found.insert(0, Message(TRAJECTORY_TOPIC, start, moves))
    numbers = {topic: i for i, topic in enumerate(schemas, 1)}
    kinds = sorted(set(schemas.values()))
    with closing(sqlite3.connect(path)) as bag:
        bag.executescript(f"PRAGMA journal_mode = OFF; PRAGMA synchronous = OFF; {_TABLES}")
        bag.executemany(
            "INSERT INTO message_definitions VALUES (NULL, ?, 'ros2msg', ?, ?)",
            [(kind, text, hash_of(kind, text)) for kind, text in kinds],
        )
        bag.executemany(
            "INSERT INTO topics VALUES (?, ?, ?, 'cdr', '[]', ?)",
            [
                (numbers[name], name, kind, hash_of(kind, text))
                for name, (kind, text) in schemas.items()
            ],
        )
        bag.executemany(
            "INSERT INTO messages VALUES (NULL, ?, ?, ?)",
            [(numbers[message.topic], message.time, message.data) for message in found],
        )
        bag.commit()
    counts = Counter(message.topic for message in found)
    topics = tuple(Topic(name, *schemas[name], counts[name]) for name in schemas)
    return File(path.name, found[0].time, found[-1].time, topics)


def _trajectory_file(target: Path, moves: bytes, start: int) -> File:
    """The trajectory in a file of its own, before the log's in the bag: the log stays as it is."""
    name = target.name + PATH_OF_BAG
    text = definition(TRAJECTORY)
    with (target / name).open("wb") as stream:
        writer = McapWriter(stream)
        writer.start(profile=PROFILE, library=OF_A_BAG)
        schema = writer.register_schema(TRAJECTORY, "ros2msg", text.encode())
        channel = writer.register_channel(TRAJECTORY_TOPIC, "cdr", schema)
        writer.add_message(channel, start, moves, start)
        writer.finish()  # type: ignore[no-untyped-call]
    return File(name, start, start, (Topic(TRAJECTORY_TOPIC, TRAJECTORY, text, 1),))


def _under_profile(data: bytes) -> bytes:
    """The same file with the profile `ros2` in its header; every record stays where it was.

    The name of the writing library gives up as many letters as the profile needs.
    """
    span = next(walk(memoryview(data)))
    header = Header.read(ReadDataStream(BytesIO(data[span.start : span.end])))
    if header.profile == PROFILE:
        return data
    spare = len(header.library) + len(header.profile) - len(PROFILE)
    changed = pack(Header(profile=PROFILE, library=header.library[:spare]))
    whole = bytearray(data)
    whole[len(MAGIC) : span.end] = changed
    stop = summary_start(data[-TAIL_SIZE:], len(data))
    end = stop - DATA_END.size
    opcode, size, crc = DATA_END.unpack_from(whole, end)
    if crc:  # zero: the writer left it out
        DATA_END.pack_into(whole, end, opcode, size, zlib.crc32(whole[:end]))
    return bytes(whole)


def trajectory(path: JointPath, names: Sequence[str]) -> bytes:
    """A smoothed path as a serialized JointTrajectory."""
    types = ros2().types
    after = np.rint((path.time - path.time[0]) * _NS).astype(np.int64)
    points = [
        types["trajectory_msgs/msg/JointTrajectoryPoint"](
            positions=np.ascontiguousarray(position),
            velocities=np.ascontiguousarray(velocity),
            accelerations=np.zeros(0),
            effort=np.zeros(0),
            time_from_start=types["builtin_interfaces/msg/Duration"](
                sec=int(ns // _NS), nanosec=int(ns % _NS)
            ),
        )
        for ns, position, velocity in zip(after, path.position, path.velocity, strict=True)
    ]
    stamp = types["builtin_interfaces/msg/Time"](sec=0, nanosec=0)
    header = types["std_msgs/msg/Header"](stamp=stamp, frame_id="")
    message = types[TRAJECTORY](header=header, joint_names=list(names), points=points)
    return bytes(ros2().serialize_cdr(message, TRAJECTORY))


def _messages(data: bytes) -> tuple[dict[str, tuple[str, str]], Iterator[Message]]:
    """Type and definition of every topic of a log, and its messages in order of time."""
    view = memoryview(data)
    schemas: dict[str, tuple[str, str]] = {}
    topics: dict[int, str] = {}
    kinds: dict[int, Any] = {}
    found: list[tuple[int, int, str, bytes]] = []
    for span in walk(view, len(MAGIC)):
        if span.opcode != Opcode.CHUNK:
            continue
        chunk = expand(view[span.start : span.end], verify=True)
        head = definitions(chunk)
        own_schemas, channels = unpack_definitions(head)
        kinds |= {schema.id: schema for schema in own_schemas}
        for channel in channels:
            schema = kinds[channel.schema_id]
            topics[channel.id] = channel.topic
            schemas[channel.topic] = (schema.name, schema.data.decode())
        for record in walk(chunk, len(head)):
            number, _, time = _MESSAGE.unpack_from(chunk, record.start)
            payload = bytes(chunk[record.start + _PREFIX : record.end])
            found.append((time, len(found), topics[number], payload))
    found.sort()
    return schemas, (Message(topic, time, raw) for time, _, topic, raw in found)
