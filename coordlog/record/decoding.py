"""Records of files → columns → episodes, held to what the commit marker promises."""

from __future__ import annotations

import hashlib
import zlib
from collections.abc import Mapping, Sequence

import numpy as np

from coordlog.episode import Array, Episode, Header, Json, Path, Result
from coordlog.errors import FormatError, TruncatedError
from coordlog.record.chunk import PREFIX_SIZE, Rows
from coordlog.record.contents import Contents
from coordlog.record.messages import (
    Stream,
    decode_contacts,
    decode_inputs,
    decode_path,
    decode_topic,
    step_message,
)
from coordlog.record.metadata import (
    HEADER_RECORDS,
    RESULT,
    decode_header,
    decode_result,
    vouched,
)
from coordlog.record.topics import task_messages
from coordlog.spec import CONTACTS, FINAL, INPUTS, KNOT, SPLINE, STEP, Layout, Message

UNCOMMITTED = "ends without its commit marker; recover what is complete with `coordlog recover`"


def require_header(records: Mapping[str, Mapping[str, str]]) -> None:
    """Hold the records of a file to being those of an episode.

    Raises:
        FormatError: naming those that are missing.
    """
    missing = [name for name in HEADER_RECORDS if name not in records]
    if missing:
        raise FormatError(f"metadata {', '.join(missing)} missing: not a coordlog episode")


def opened_episode(found: Contents) -> tuple[Header, Result]:
    """Header and result of a file of which the topics of rows were looked at, vouched for.

    Raises:
        FormatError: if they are missing, not as declared, or not what was written.
    """
    require_header(found.metadata)
    if RESULT not in found.metadata:
        raise TruncatedError(UNCOMMITTED)
    header, result = decode_header(found.metadata), decode_result(found.metadata[RESULT])
    if not found.own:  # nothing but the marker vouches for what another tool wrote
        decode(found)
    require_messages(found, vouched(found.metadata), rows=True)
    return header, result


def decode(found: Contents, *, verify: bool = True) -> Episode:
    """The episode out of a file's records.

    Raises:
        FormatError: if messages are missing, of another size, or not in order; with `verify` also
            if the commit marker does not vouch for the metadata and the messages.
    """
    header = decode_header(found.metadata)
    if RESULT not in found.metadata:
        raise TruncatedError(UNCOMMITTED)
    result = decode_result(found.metadata[RESULT])
    promised = vouched(found.metadata) if verify else {}
    layout = header.layout
    steps, final, _ = joined([found], header, [result])
    absent = require_messages(found, promised)
    columns = {
        item.name: np.concatenate([steps[item.name], final[item.name]])
        if item.when == "before"
        else steps[item.name]
        for item in header.fields
        if item.name in steps
    }
    path: Path | None = None
    if KNOT.topic in found.messages and SPLINE.topic in found.messages:
        path = decode_path(found.stream(KNOT.topic), found.stream(SPLINE.topic), layout)
    contacts = decode_contacts(found.stream(CONTACTS.topic), layout)
    inputs = decode_inputs(found.stream(INPUTS.topic))
    episode = Episode(header, result, contacts=contacts, path=path, inputs=inputs, columns=columns)
    if verify and (absent or not found.sure or not found.own):
        _require_digest(episode)
    return episode


def _require_digest(episode: Episode) -> None:
    states = np.concatenate([episode.qpos, episode.qvel], axis=1)
    got = hashlib.sha256(states.tobytes()).hexdigest()
    if got != episode.result.digest:
        raise FormatError(
            f"qpos and qvel: expected the digest {episode.result.digest[:16]}… that the commit "
            f"marker has, got {got[:16]}…: the states are not those that were recorded"
        )


def require_messages(found: Contents, promised: Json, *, rows: bool = False) -> list[str]:
    """Hold the messages of a file to the counts of its commit marker, and to its CRCs where no
    chunk of ours has one: those of another tool vouch for what that tool wrote.

    Args:
        found: The file's records.
        promised: What the marker vouches for (`metadata.vouched`); empty for version 1.
        rows: Whether only topics of rows were looked at; their counts are those of the steps.

    Returns:
        Topics that another tool has left out of the file.

    Raises:
        FormatError: naming the first topic that is not as it was written.
    """
    absent = []
    for topic, (count, crc) in promised.get("messages", {}).items():
        records = found.messages.get(topic, [])
        if rows and not records:
            continue
        if not records and count and not found.own and topic not in (STEP.topic, FINAL.topic):
            absent.append(topic)
        elif len(records) != count:
            raise FormatError(f"topic {topic}: expected {count} messages, got {len(records)}")
        elif not (found.sure and found.own) and payload_crc(found.stream(topic).records) != crc:
            raise FormatError(f"topic {topic}: the messages are not those that were recorded")
    return absent


def payload_crc(records: Sequence[bytes | memoryview] | Rows, crc: int = 0) -> int:
    """CRC-32 of the payloads of messages, one after the other: the same in whatever file they
    stand.
    """
    if isinstance(records, Rows):
        return zlib.crc32(np.ascontiguousarray(records.payloads()).data, crc)
    for record in records:
        crc = zlib.crc32(record[PREFIX_SIZE:], crc)
    return crc


def joined(
    group: Sequence[Contents], header: Header, results: Sequence[Result]
) -> tuple[dict[str, Array], dict[str, Array], Array]:
    """Columns of all steps and of all final states of files that have the same fields and layout,
    and the lengths of their episodes. What a task logs is left out where the files lack its topic.

    Raises:
        FormatError: if a message is missing, of another size, or not in order.
    """
    layout, lengths = header.layout, np.array([result.length for result in results])
    steps = _decoded(group, step_message(header), layout)
    final = _decoded(group, FINAL, layout)
    require_order(steps["step"], final["step"], lengths)
    task = [
        _decoded(group, message, layout)
        for message in (task_messages(header) if header.version > 1 else ())
    ]
    logged = [len(columns["step"]) > 0 for columns in task]
    if task and all(logged[1:]) and (logged[0] or not lengths.sum()):
        last = task[1] if len(task) > 1 else {"step": final["step"]}
        require_order(task[0].pop("step"), last.pop("step"), lengths)
        steps |= task[0]
        final |= last
    return steps, final, lengths


def _decoded(group: Sequence[Contents], message: Message, layout: Layout) -> dict[str, Array]:
    streams = [found.stream(message.topic) for found in group]
    columns = {stream.columns for stream in streams if stream.records}
    if len(columns) > 1:
        raise FormatError(f"schema {message.name}: expected the same fields in every file")
    records = [record for stream in streams for record in stream.records]
    return decode_topic(Stream(next(iter(columns), ()), records), message, layout)


def require_order(steps: Array, finals: Array, lengths: Array) -> None:
    """Hold the step numbers of one or more episodes to 0, 1, … and their final states to the
    lengths.

    Raises:
        FormatError: naming the first step that is not the next one.
    """
    total = int(lengths.sum())
    if len(finals) != len(lengths) or (finals != lengths).any() or len(steps) != total:
        raise FormatError(
            f"expected {lengths.tolist()} steps and a final state, got {len(steps)} steps and "
            f"final states {finals.tolist()}"
        )
    wanted = np.arange(total) - np.repeat(np.cumsum(lengths) - lengths, lengths)
    if (steps != wanted).any():
        row = int(np.flatnonzero(steps != wanted)[0])
        raise FormatError(f"step: expected {wanted[row]}, got {steps[row]}")
