"""Naming what is damaged in a file whose data section fails its CRC.

A single flipped bit is found from the CRC alone (`bitflip`): the undamaged bytes are then known for
certain, and comparing the two says which step and field it hit. Other damage is named by the steps
of the chunks that fail their own CRC.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from mcap.opcode import Opcode

from coordlog.episode import Header
from coordlog.errors import FormatError
from coordlog.record.cdr import message_codec
from coordlog.record.chunk import PREFIX_SIZE, expand
from coordlog.record.contents import room_of
from coordlog.record.messages import step_message
from coordlog.record.metadata import decode_header
from coordlog.record.records import (
    MAGIC,
    RECORD_HEAD,
    Span,
    unpack_attachment,
    unpack_metadata,
    walk,
)
from coordlog.record.topics import task_messages, topics
from coordlog.spec import FINAL, Layout, Message
from coordlog.verify.bitflip import Flip, locate, restored
from coordlog.verify.finding import Problem

_SEQUENCE_AT = 11  # of a message record: its step number
_STEP_CHANNEL = 1  # in every file of our own layout


def repaired(data: bytes, stop: int, crc: int) -> tuple[bytes, Flip] | None:
    """The data section `data[:stop]` with its one flipped bit put back, and which it was.

    None if it is not one bit.
    """
    flip = locate(memoryview(data)[:stop], crc)
    return None if flip is None else (restored(memoryview(data)[:stop], flip), flip)


def damages(data: bytes, stop: int, crc: int) -> Iterator[Problem]:
    """What is damaged in the data section `data[:stop]`, which should have this CRC."""
    repair = repaired(data, stop, crc)
    if repair is not None:
        yield _flipped(data, *repair)
        return
    failed, room = False, room_of(len(data))
    for span in walk(data, stop=stop):
        if span.opcode == Opcode.CHUNK:
            content = memoryview(data)[span.start : span.end]
            try:
                room -= len(expand(content, room=room))
            except FormatError as error:
                failed = True
                yield _unreadable(data, span, str(error))
    if not failed:
        yield Problem(None, "data section", f"CRC {crc:08x}", "other bytes, outside the chunks")


def _flipped(data: bytes, intact: bytes, flip: Flip) -> Problem:
    where = f"bit {flip.bit} of byte {flip.byte} of the file is flipped"
    span = next(
        (span for span in walk(intact) if span.start - RECORD_HEAD.size <= flip.byte < span.end),
        None,
    )
    if span is None:
        return Problem(None, "magic", MAGIC.hex(), where)
    content = memoryview(intact)[span.start : span.end]
    if span.opcode == Opcode.METADATA:
        return Problem(
            None, f"metadata {unpack_metadata(bytes(content))[0]}", "the bytes written", where
        )
    if span.opcode == Opcode.ATTACHMENT:
        return Problem(
            None, f"attachment {unpack_attachment(content)[0]}", "the bytes written", where
        )
    if span.opcode != Opcode.CHUNK:
        return Problem(
            None, Opcode(span.opcode).name.lower().replace("_", " "), "the bytes written", where
        )
    try:
        broken = expand(memoryview(data)[span.start : span.end], verify=False)
    except FormatError:
        broken = b""
    return _compared(intact, expand(content), broken, where) or _unreadable(intact, span, where)


def _compared(intact: bytes, whole: bytes, broken: bytes, where: str) -> Problem | None:
    """The first message of an expanded chunk that the damage reached; None if it cannot be told."""
    if len(whole) != len(broken) or whole == broken:
        return None
    header = _header(intact)
    names = {topic.id: name for name, topic in topics(header).items()}
    at = int(np.flatnonzero(np.frombuffer(whole, np.uint8) != np.frombuffer(broken, np.uint8))[0])
    span = next(span for span in walk(whole, 0) if at < span.end)
    record, other = (data[span.start - RECORD_HEAD.size : span.end] for data in (whole, broken))
    if span.opcode != Opcode.MESSAGE:
        return Problem(None, Opcode(span.opcode).name.lower(), "the bytes written", where)
    step = int.from_bytes(record[_SEQUENCE_AT : _SEQUENCE_AT + 4], "little")
    topic = names[int.from_bytes(record[RECORD_HEAD.size : RECORD_HEAD.size + 2], "little")]
    decoded = {message.topic: message for message in (step_message(header), FINAL)}
    decoded |= {message.topic: message for message in task_messages(header)}
    if topic in decoded:
        named = _field(decoded[topic], header.layout, record, other)
        if named is not None:
            return Problem(step, named[0], named[1], f"{named[2]}: {where}")
    return Problem(step, topic, "the bytes written", where)


def _field(
    message: Message, layout: Layout, record: bytes, other: bytes
) -> tuple[str, str, str] | None:
    """Name, true value and damaged value where two records of one message first differ.

    None if that is not in a field.
    """
    at = int(np.flatnonzero(np.frombuffer(record, np.uint8) != np.frombuffer(other, np.uint8))[0])
    codec = message_codec(message, layout)
    for name in codec.fields:
        dtype, offset = codec.dtype.fields[name][:2]  # type: ignore[index]
        item, start = dtype.base, PREFIX_SIZE + int(offset)
        if start <= at < start + dtype.itemsize:
            index = (at - start) // item.itemsize
            true, false = (
                np.frombuffer(data, item, 1, start + index * item.itemsize)[0]
                for data in (record, other)
            )
            return f"{name}[{index}]" if dtype.shape else name, str(true), str(false)
    return None


def _unreadable(data: bytes, span: Span, reason: str) -> Problem:
    """A chunk of which no more can be said than which steps it holds, by the messages before it."""
    first = 0
    for before in walk(data, stop=span.start - RECORD_HEAD.size):
        if before.opcode == Opcode.MESSAGE_INDEX:
            first += _indexed_steps(memoryview(data)[before.start : before.end])
    after = next(walk(data, span.end), None)
    count = (
        _indexed_steps(memoryview(data)[after.start : after.end])
        if after and after.opcode == Opcode.MESSAGE_INDEX
        else 0
    )
    holds = f"steps {first} to {first + count - 1}" if count else "what follows the last step"
    return Problem(first, "chunk", f"{holds}, undamaged", reason)


def _indexed_steps(content: memoryview) -> int:
    """Steps that a message index record counts; 0 for other topics."""
    channel = int.from_bytes(content[:2], "little")
    return (len(content) - 6) // 16 if channel == _STEP_CHANNEL else 0


def _header(data: bytes) -> Header:
    records = (
        unpack_metadata(data[span.start : span.end])
        for span in walk(data)
        if span.opcode == Opcode.METADATA
    )
    return decode_header(dict(records))
