"""MCAP of any program in: joint positions in JSON or protobuf messages, their fields named.

A field is a path of names, `state.joints.position`; on its way through a list it gathers from every
entry, so that both `{"name": […], "position": […]}` and `{"joints": [{"name": …, "position": …}]}`
can be said.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from mcap.reader import make_reader

from coordlog.errors import ConfigError, FormatError
from coordlog.exchange.frames import require_whole
from coordlog.exchange.motion import Motion

ENCODINGS = ("json", "protobuf")
GUESSES = (("name", "position"), ("names", "positions"), ("joints.name", "joints.position"))
"""Fields of names and positions that are tried where none are said."""


def motions(
    path: Path, *, topic: str = "", names: str = "", position: str = "", fixed: tuple[str, ...] = ()
) -> Iterator[Motion]:
    """The joint motion on one topic of an MCAP file, stamped with its log times.

    Args:
        path: The file.
        topic: Topic to read; "" for the only one that fits.
        names: Field of the joints' names.
        position: Field of their positions.
        fixed: Names of the joints, for messages without any.

    Raises:
        FormatError: if the file is damaged or a message does not have these fields.
        ConfigError: if the topic or a field must be named and is not.
    """
    stamps: list[int] = []
    rows: list[list[float]] = []
    known: tuple[str, ...] = fixed
    with path.open("rb") as stream:
        try:
            reader = make_reader(stream, validate_crcs=True)
            chosen = _topic(path, reader, topic)
            decoders: dict[int, Callable[[bytes], Any]] = {}
            fields = (names, position)
            for schema, channel, message in _messages(path, reader, chosen):
                if channel.id not in decoders:
                    decoders[channel.id] = _decoder(path, schema, channel.message_encoding)
                value = decoders[channel.id](message.data)
                where = f"{path}: {chosen}: message {len(rows)}"
                if not fields[1]:
                    fields = _guess(where, value, fixed)
                own = fixed or tuple(map(str, _list(where, value, fields[0])))
                known = known or own
                rows.append(_row(where, known, own, _list(where, value, fields[1])))
                stamps.append(message.log_time)
        except (json.JSONDecodeError, UnicodeDecodeError, RecursionError) as error:
            raise FormatError(f"{path}: message {len(rows)}: expected JSON: {error}") from error
        except (TypeError, ValueError, KeyError, AttributeError) as error:
            raise FormatError(
                f"{path}: message {len(rows)}: expected numbers as positions: {error}"
            ) from error
    yield Motion(
        path,
        "mcap",
        chosen,
        known,
        np.array(stamps, np.int64),
        np.array(rows, np.float64).reshape(len(rows), len(known)),
        clock="log time",
        where={"topic": chosen, "names": fields[0], "position": fields[1]},
    )


def _row(
    where: str, known: tuple[str, ...], own: tuple[str, ...], numbers: list[Any]
) -> list[float]:
    """The positions of the joints `known`, of a message that may name them in another order.

    Raises:
        FormatError: if the message is of other joints.
        TypeError: if it holds no numbers.
    """
    if sorted(own) != sorted(known) or len(numbers) != len(own):
        raise FormatError(
            f"{where}: expected positions of {', '.join(known)}, got {len(numbers)} of "
            f"{', '.join(own)}"
        )
    if any(isinstance(each, bool) for each in numbers):
        raise TypeError("got true or false")
    found = dict(zip(own, numbers, strict=True))
    return [float(found[name]) for name in known]


def is_ros2(path: Path) -> bool:
    """Whether the messages of an MCAP file are CDR, which rosbags reads.

    Raises:
        FormatError: if it cannot be read.
    """
    require_whole(path)
    with path.open("rb") as stream:
        reader = make_reader(stream)
        kinds = {channel.message_encoding for channel in _channels(path, reader)}
    if kinds and not kinds & {"cdr", *ENCODINGS}:
        raise FormatError(
            f"{path}: expected messages in cdr (ROS 2), {' or '.join(ENCODINGS)}, got "
            f"{', '.join(sorted(kinds))}"
        )
    return not kinds & set(ENCODINGS)


def _messages(path: Path, reader: Any, topic: str) -> Iterator[Any]:
    """Schema, channel and message of all messages on a topic."""
    try:
        yield from reader.iter_messages(topics=topic, log_time_order=False)
    except Exception as error:  # the reader lets errors of its decompressors through
        raise _unreadable(path, error) from error


def _channels(path: Path, reader: Any) -> list[Any]:
    """The channels of a file, from its summary."""
    try:
        summary = reader.get_summary()
    except Exception as error:  # as above
        raise _unreadable(path, error) from error
    about = summary and summary.statistics
    if about and about.message_count and not summary.channels:
        raise FormatError(f"{path}: its summary names no channels: `mcap recover` writes it anew")
    return [] if summary is None else list(summary.channels.values())


def _unreadable(path: Path, error: Exception) -> FormatError:
    said = str(error) or type(error).__name__
    return FormatError(f"{path}: not an MCAP file that can be read: {said}")


def _topic(path: Path, reader: Any, topic: str) -> str:
    channels = _channels(path, reader)
    usable = sorted({item.topic for item in channels if item.message_encoding in ENCODINGS})
    if topic and topic not in usable:
        raise ConfigError(
            f"{path}: no JSON or protobuf topic '{topic}'; it has {', '.join(usable)}"
        )
    if not topic and len(usable) != 1:
        raise ConfigError(
            f"{path}: choose one with --topic: {', '.join(usable) or 'there is none'}"
        )
    return topic or usable[0]


def _decoder(path: Path, schema: Any, encoding: str) -> Callable[[bytes], Any]:
    if encoding == "json":
        return lambda data: json.loads(data)
    from google.protobuf import descriptor_pb2, descriptor_pool, json_format, message_factory
    from google.protobuf.message import DecodeError

    if schema is None:
        raise FormatError(f"{path}: a protobuf topic without its schema: cannot be decoded")
    pool = descriptor_pool.DescriptorPool()
    try:
        for file in descriptor_pb2.FileDescriptorSet.FromString(schema.data).file:
            pool.Add(file)
        kind = message_factory.GetMessageClass(pool.FindMessageTypeByName(schema.name))
    except (DecodeError, KeyError, TypeError) as error:
        raise FormatError(
            f"{path}: expected a protobuf schema of {schema.name}, got one that cannot be used: "
            f"{error}"
        ) from error

    def decoded(data: bytes) -> Any:
        try:
            message = kind.FromString(data)
        except DecodeError as error:
            raise ValueError(f"expected a {schema.name}, got other bytes ({error})") from error
        return json_format.MessageToDict(
            message, preserving_proto_field_name=True, always_print_fields_with_no_presence=True
        )

    return decoded


def _guess(where: str, value: Any, fixed: tuple[str, ...]) -> tuple[str, str]:
    for names, position in GUESSES:
        if _gather(value, position) and (fixed or _gather(value, names)):
            return names, position
    had = ", ".join(value) if isinstance(value, dict) else type(value).__name__
    raise ConfigError(
        f"{where}: name the fields with --names-field and --position-field; the message has {had}"
    )


def _list(where: str, value: Any, field: str) -> list[Any]:
    found = _gather(value, field)
    if not found:
        raise FormatError(f"{where}: expected a list in '{field}', got nothing")
    return found


def _gather(value: Any, field: str) -> list[Any]:
    found = [value]
    for name in field.split("."):
        inner: list[Any] = []
        for each in found:
            for item in each if isinstance(each, list) else [each]:
                if isinstance(item, dict) and name in item:
                    inner.append(item[name])
        found = inner
    return found[0] if len(found) == 1 and isinstance(found[0], list) else found
