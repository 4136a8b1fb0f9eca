"""What stands beside the messages of a ROS 2 bag: metadata.yaml, message types and their hashes.

Source: rosbags 0.11.9, rosbag2/; REP 2011 for the hashes of types.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from functools import lru_cache
from io import BytesIO
from typing import NamedTuple

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Statistics
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from coordlog.episode import Json
from coordlog.record.opening import summary_start
from coordlog.record.records import TAIL_SIZE, unpack_definitions, walk

VERSION = 9


class Topic(NamedTuple):
    """A topic of one file of a bag."""

    name: str
    kind: str
    text: str
    """definition of its messages"""
    count: int


class File(NamedTuple):
    """What metadata.yaml says of one file of a bag."""

    name: str
    start: int
    """first log time [ns]"""
    stop: int
    topics: tuple[Topic, ...]


def summarized(data: bytes, name: str) -> File:
    """What metadata.yaml says of an MCAP file, from its summary."""
    start = summary_start(data[-TAIL_SIZE:], len(data))
    summary = data[start : len(data) - TAIL_SIZE]
    schemas, channels = unpack_definitions(summary)
    kinds = {schema.id: schema for schema in schemas}
    (span,) = (span for span in walk(summary, 0) if span.opcode == Opcode.STATISTICS)
    about = Statistics.read(ReadDataStream(BytesIO(summary[span.start : span.end])))
    topics = tuple(
        Topic(
            channel.topic,
            kinds[channel.schema_id].name,
            kinds[channel.schema_id].data.decode(),
            about.channel_message_counts.get(channel.id, 0),
        )
        for channel in channels
    )
    return File(name, about.message_start_time, about.message_end_time, topics)


def metadata(files: Sequence[File], storage: str, origin: Json) -> str:
    """metadata.yaml of a bag."""
    topics = [
        {
            "topic_metadata": {
                "name": topic.name,
                "type": topic.kind,
                "serialization_format": "cdr",
                "offered_qos_profiles": [],
                "type_description_hash": hash_of(topic.kind, topic.text),
            },
            "message_count": topic.count,
        }
        for file in files
        for topic in file.topics
    ]
    begin, end = min(file.start for file in files), max(file.stop for file in files)
    information = {
        "version": VERSION,
        "storage_identifier": storage,
        "duration": {"nanoseconds": end - begin},
        "starting_time": {"nanoseconds_since_epoch": begin},
        "message_count": sum(topic.count for file in files for topic in file.topics),
        "topics_with_message_count": topics,
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [file.name for file in files],
        "files": [
            {
                "path": file.name,
                "starting_time": {"nanoseconds_since_epoch": file.start},
                "duration": {"nanoseconds": file.stop - file.start},
                "message_count": sum(topic.count for topic in file.topics),
            }
            for file in files
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


@lru_cache(maxsize=8)
def definition(kind: str) -> str:
    """Text of a standard message type."""
    return str(ros2().generate_msgdef(kind, ros_version=2)[0])


@lru_cache(maxsize=64)
def hash_of(kind: str, text: str) -> str:
    """RIHS01 hash of a message type."""
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
