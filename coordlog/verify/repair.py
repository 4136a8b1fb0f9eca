"""What is left of an interrupted or damaged recording, as a valid episode.

The bytes are walked from the start, without an index, up to the first record that is cut off or
damaged. A step is kept when the state it led to is known: from the step after it, or from the final
state. A file that is whole is copied, and so is one that is whole but for a single flipped bit,
which is put back. The original is never touched, nothing is overwritten.
"""

from __future__ import annotations

import zlib
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path as FilePath
from typing import NamedTuple

import numpy as np
from mcap.opcode import Opcode

from coordlog.episode import Array, Episode, Header, Result
from coordlog.errors import FormatError, StorageError, TruncatedError
from coordlog.record.chunk import expand
from coordlog.record.contents import Contents, contents, room_of
from coordlog.record.decoding import decode
from coordlog.record.messages import (
    decode_contacts,
    decode_inputs,
    decode_path,
    decode_topic,
    step_message,
)
from coordlog.record.metadata import HEADER_RECORDS, RESULT, decode_header, decode_result
from coordlog.record.opening import File, is_own, load, naming, summary_start, verify_summary
from coordlog.record.records import (
    DATA_END,
    MAGIC,
    RECORD_HEAD,
    TAIL_SIZE,
    unpack_attachment,
    unpack_metadata,
    walk,
)
from coordlog.record.storage import PART, PartFile, locked, move_new, refuse_existing, translated
from coordlog.record.topics import task_messages
from coordlog.record.writer import write_episode
from coordlog.spec import CONTACTS, FINAL, INPUTS, JOINT_STATE_TOPIC, KNOT, SPLINE, STEP
from coordlog.verify.damage import repaired

DRAFT = ".recovering"
"""Ends the name of what is being recovered."""
ABORTED = "recovered"
"""Why a recovered episode ends where it does."""


class Recovered(NamedTuple):
    """Where the episode went, and what could not come along."""

    path: FilePath
    steps_kept: int
    lost: str
    """For people; starts with "nothing" if no step was lost."""
    lossy: bool
    """Whether a step was lost."""


@dataclass(frozen=True)
class Salvage:
    """What can be told from the bytes of an unfinished or damaged file."""

    episode: Episode
    attachments: Mapping[str, bytes]
    display: bool
    lost: str
    lossy: bool


@dataclass
class _Ground:
    """The records up to the first one that is cut off or damaged."""

    found: Contents = field(default_factory=Contents)
    attachments: dict[str, bytes] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)


def recover(path: File, out: File | None = None) -> Recovered:
    """Write what is complete in a part file or a damaged file as a valid episode.

    What an earlier try left behind is removed; if this one fails, it leaves nothing behind.

    Args:
        path: The file; left as it is.
        out: Name of the episode; by default NAME.mcap for NAME.mcap.part, NAME.recovered.mcap for a
            damaged NAME.mcap.

    Raises:
        FormatError: if the file is not coordlog's, holds no step whose outcome is known, or is a
            finished episode already.
        StorageError: if the new file exists or cannot be written, or the file is being written by
            another process.
    """
    source = FilePath(path)
    target = target_of(source) if out is None else FilePath(out)
    draft = target.with_name(target.name + DRAFT)
    with locked(source) as ours:
        if not ours:
            raise StorageError(
                f"{source}: is being written or recovered by another process; wait for its end"
            )
        data = load(path)
        refuse_existing(target)
        _tidy(draft)
        try:
            with naming(path):
                done = _write(source, data, draft)
            with translated(target, "publish the file"):
                move_new(draft, target)
        except StorageError as error:
            cause = error.__cause__
            reason = (isinstance(cause, OSError) and cause.strerror) or str(error)
            raise StorageError(
                f"{target}: cannot write the recovered episode: {reason}; {source} is as it was"
            ) from error
        finally:
            _tidy(draft)
    return Recovered(target, *done)


def _tidy(draft: FilePath) -> None:
    """Remove what is left of a try to recover."""
    for leftover in (draft, draft.with_name(draft.name + PART)):
        with suppress(OSError):
            leftover.unlink()


def _write(source: FilePath, data: bytes, draft: FilePath) -> tuple[int, str, bool]:
    """Write the recovered episode; steps kept, what was lost, and whether a step was."""
    whole = restored_whole(data)
    if whole is None:
        salvage = salvaged(data)
        write_episode(
            draft, salvage.episode, attachments=salvage.attachments, display=salvage.display
        )
        return len(salvage.episode), salvage.lost, salvage.lossy
    if whole == data and source.suffix != PART:
        raise FormatError("a finished episode: there is nothing to recover")
    file = PartFile(draft)
    try:
        file.append(whole)
        file.publish()
    finally:
        file.close()
    lost = "nothing" if whole == data else "nothing; a flipped bit was put back"
    return len(decode(contents(whole))), lost, False


def restored_whole(data: bytes) -> bytes | None:
    """The bytes of a finished file, with one flipped bit put back if need be.

    None if the file is not whole.
    """
    try:
        start = summary_start(memoryview(data)[-TAIL_SIZE:], len(data))
        stop = start - DATA_END.size
        verify_summary(memoryview(data)[start:])
        opcode, _, crc = DATA_END.unpack_from(data, max(stop, 0))
        if opcode != Opcode.DATA_END:
            return None
        if crc not in (0, zlib.crc32(memoryview(data)[:stop])):
            repair = repaired(data, stop, crc)
            if repair is None:
                return None
            data = repair[0] + data[stop:]
        decode(contents(data))
    except FormatError:
        return None
    return data


def salvaged(data: bytes) -> Salvage:
    """Everything up to the first cut or damage whose outcome is known.

    Raises:
        FormatError: if that is not even one step.
    """
    ground = _ground(data)
    records, messages = ground.found.metadata, ground.found.messages
    if not set(HEADER_RECORDS) <= set(records):
        raise TruncatedError("ends within its opening metadata: nothing to recover")
    header, found = decode_header(records), ground.found
    rows = [decode_topic(found.stream(STEP.topic), step_message(header), header.layout)]
    ends = [decode_topic(found.stream(FINAL.topic), FINAL, header.layout)]
    for message, tables in zip(task_messages(header), (rows, ends), strict=False):
        if header.version > 1 and message.topic in messages:
            tables.append(decode_topic(found.stream(message.topic), message, header.layout))
    on_disk = min(_in_order(table["step"]) for table in rows)
    steps = {name: column[:on_disk] for table in rows for name, column in table.items()}
    final = {name: column for table in ends for name, column in table.items()}
    known = all(len(table["step"]) == 1 and int(table["step"][0]) == on_disk for table in ends)
    known = known and all(len(table["step"]) == on_disk for table in rows)
    kept = on_disk if known else on_disk - 1
    if kept < 1:
        raise TruncatedError(
            f"only {on_disk} steps are complete, and recovering needs one and the state it led to: "
            "nothing to recover"
        )
    if not known:
        ground.notes.insert(
            0, f"step {kept}, whose outcome is not on disk, and whatever followed it"
        )
    marker = decode_result(records[RESULT]).aborted if known and RESULT in records else ABORTED
    path = None
    if known and KNOT.topic in messages and SPLINE.topic in messages:
        path = decode_path(found.stream(KNOT.topic), found.stream(SPLINE.topic), header.layout)
    contacts = decode_contacts(found.stream(CONTACTS.topic), header.layout)
    inputs = decode_inputs(found.stream(INPUTS.topic))
    inside = inputs["step"] < kept if inputs else slice(0)
    episode = Episode(
        header=header,
        result=_unknown_result(marker),
        contacts=contacts[contacts["step"] < kept],
        path=path,
        inputs={name: column[inside] for name, column in inputs.items()},
        columns=_columns(header, steps, final if known else None, kept),
    )
    lost = "; ".join(ground.notes) if not known else "; ".join(["nothing", *ground.notes])
    return Salvage(episode, ground.attachments, JOINT_STATE_TOPIC in messages, lost, not known)


def _ground(data: bytes) -> _Ground:
    ground, at, view = _Ground(), len(MAGIC), memoryview(data)
    ground.found.own = is_own(data)
    room = room_of(len(data))
    for span in walk(data):
        content = view[span.start : span.end]
        try:
            if span.opcode == Opcode.CHUNK:
                chunk = expand(content, room=room)
                room -= len(chunk)
                ground.found.add_chunk(chunk)
            elif span.opcode == Opcode.METADATA:
                name, values = unpack_metadata(bytes(content))
                ground.found.metadata[name] = values
            elif span.opcode == Opcode.DATA_END:
                return ground
            elif span.opcode == Opcode.ATTACHMENT:
                name, stored = unpack_attachment(content)
                ground.attachments[name] = stored
            elif span.opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                ground.found.learn(data[span.start - RECORD_HEAD.size : span.end])
            elif span.opcode not in (Opcode.HEADER, Opcode.MESSAGE_INDEX):
                break
        except FormatError as error:
            ground.notes.append(str(error))
            if span.opcode != Opcode.ATTACHMENT:
                break
        at = span.end
    if len(data) > at:
        ground.notes.append(f"{len(data) - at} bytes after byte {at} are incomplete or damaged")
    return ground


def _in_order(steps: Array) -> int:
    """How many step numbers are 0, 1, … before the first that is not."""
    wrong = np.flatnonzero(steps != np.arange(len(steps)))
    return int(wrong[0]) if len(wrong) else len(steps)


def _columns(
    header: Header, steps: Mapping[str, Array], final: Mapping[str, Array] | None, kept: int
) -> dict[str, Array]:
    """The columns of an episode of `kept` steps, whose last state is the final one or that of the
    step after.
    """
    last = (
        {name: column[kept : kept + 1] for name, column in steps.items()}
        if final is None
        else final
    )
    return {
        item.name: np.concatenate([steps[item.name][:kept], last[item.name]])
        if item.when == "before"
        else steps[item.name][:kept]
        for item in header.fields
        if item.name in steps
    }


def _unknown_result(aborted: str) -> Result:
    """A result of which only the reason is known; writing the episode computes the rest."""
    return Result(0, (), False, False, False, False, aborted, "")


def target_of(source: FilePath) -> FilePath:
    """The name that a recovered episode gets by itself."""
    return (
        source.with_suffix("")
        if source.suffix == PART
        else source.with_name(source.stem + ".recovered" + source.suffix)
    )
