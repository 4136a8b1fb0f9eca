"""ROS 2 bags: a folder `NAME/` per episode with its messages and `metadata.yaml` (version 9).

A log becomes a bag as it is: the file's bytes, attachments and all, under the profile `ros2`, and
its metadata. Where something is added or sqlite3 is asked for, messages are copied byte for byte
with their log times, and what is no message stays in the log: a smoothed episode also has its path
as one `trajectory_msgs/msg/JointTrajectory` on `/joint_trajectory`, the spline's break points with
their velocities, its stamp zero, which controllers read as "start now". The episode's origin is in
`custom_data`.

Source: rosbags 0.11.9, rosbag2/writer.py; trajectory_msgs of ROS 2.
"""

from __future__ import annotations

import json
import shutil
import struct
import zlib
from collections.abc import Iterator, Sequence
from functools import lru_cache
from io import BytesIO
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Header, Statistics
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from coordlog.episode import Json
from coordlog.episode import Path as JointPath
from coordlog.exchange.blocks import Block, Options
from coordlog.exchange.source import Loaded
from coordlog.record.chunk import definitions, expand
from coordlog.record.opening import summary_start
from coordlog.record.records import DATA_END, MAGIC, TAIL_SIZE, pack, unpack_definitions, walk

TRAJECTORY_TOPIC = "/joint_trajectory"
TRAJECTORY = "trajectory_msgs/msg/JointTrajectory"
STORAGES = {"mcap": StoragePlugin.MCAP, "sqlite3": StoragePlugin.SQLITE3}
VERSION: Literal[9] = 9
PROFILE = "ros2"
_MESSAGE = struct.Struct("<HIQ")  # channel, sequence, log time
_PREFIX = 22
"""Bytes of an MCAP message before its payload."""
_NS = 1_000_000_000


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
    data = loaded.data
    if storage == "mcap" and loaded.episode.path is None:
        target.mkdir(parents=True)
        name = f"{target.name}.mcap"
        (target / name).write_bytes(_under_profile(data))
        (target / "metadata.yaml").write_text(_metadata(data, name, loaded.named()), "utf-8")
    else:
        _rewrite(loaded, data, target, STORAGES[storage])


def _rewrite(loaded: Loaded, data: bytes, target: Path, plugin: StoragePlugin) -> None:
    """Copy the messages of a log into a new bag, and add the trajectory of its path."""
    schemas, messages = _messages(data)
    with Writer(target, version=VERSION, storage_plugin=plugin) as bag:
        for key, value in loaded.named().items():
            text = value if isinstance(value, str) else json.dumps(value)
            bag.set_custom_data(key, text)
        connections = {}
        for topic, (kind, text) in schemas.items():
            types = types_of(kind, text)
            connections[topic] = bag.add_connection(topic, kind, typestore=types)
        path = loaded.episode.path
        if path is not None and TRAJECTORY_TOPIC not in connections:
            names = loaded.episode.header.env["action_joints"]
            channel = bag.add_connection(TRAJECTORY_TOPIC, TRAJECTORY, typestore=ros2())
            start = int(loaded.episode.header.episode["start_time"])
            bag.write(channel, start, trajectory(path, names))
        for message in messages:
            bag.write(connections[message.topic], message.time, message.data)


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


def _metadata(data: bytes, name: str, origin: Json) -> str:
    """metadata.yaml of a bag of one MCAP file, from the file's summary."""
    start = summary_start(data[-TAIL_SIZE:], len(data))
    summary = data[start : len(data) - TAIL_SIZE]
    schemas, channels = unpack_definitions(summary)
    kinds = {schema.id: schema for schema in schemas}
    (span,) = (span for span in walk(summary, 0) if span.opcode == Opcode.STATISTICS)
    about = Statistics.read(ReadDataStream(BytesIO(summary[span.start : span.end])))
    times = {"nanoseconds_since_epoch": about.message_start_time}
    duration = {"nanoseconds": about.message_end_time - about.message_start_time}
    count = about.message_count
    topics = [
        {
            "topic_metadata": {
                "name": channel.topic,
                "type": kinds[channel.schema_id].name,
                "serialization_format": "cdr",
                "offered_qos_profiles": [],
                "type_description_hash": _hash(
                    kinds[channel.schema_id].name, kinds[channel.schema_id].data.decode()
                ),
            },
            "message_count": about.channel_message_counts.get(channel.id, 0),
        }
        for channel in channels
    ]
    information = {
        "version": VERSION,
        "storage_identifier": "mcap",
        "duration": duration,
        "starting_time": times,
        "message_count": count,
        "topics_with_message_count": topics,
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [name],
        "files": [
            {"path": name, "starting_time": times, "duration": duration, "message_count": count}
        ],
        "custom_data": {
            key: value if isinstance(value, str) else json.dumps(value)
            for key, value in origin.items()
        },
        "ros_distro": "coordlog",
    }
    # JSON is YAML: no other library's dumper is as fast
    text = json.dumps({"rosbag2_bagfile_information": information}, indent=2, ensure_ascii=False)
    return text + "\n"


@lru_cache(maxsize=64)
def _hash(kind: str, text: str) -> str:
    return str(types_of(kind, text).hash_rihs01(kind))


@lru_cache(maxsize=1)
def ros2() -> Typestore:
    """The standard messages of ROS 2."""
    return get_typestore(Stores.LATEST)


@lru_cache(maxsize=64)
def types_of(kind: str, text: str) -> Typestore:
    """A store that knows one more message type, given its definition."""
    known = ros2()
    if kind in known.fielddefs:
        return known
    own = get_typestore(Stores.LATEST)
    own.register(get_types_from_msg(text, kind))
    return own


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
