"""`coordlog check` without the physics: is the file whole, and does its content hold together?

*file*: structure, every CRC, the commit marker, the schemas and the summary. Of a file whose commit
marker vouches for every byte nothing is expanded: it is as coordlog wrote it. *content*: the
messages of every topic are those that the decoded columns encode to, and all that can be recomputed
from the log is. A finding names file, step and field; damaged content is never an exception.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from itertools import zip_longest

from mcap.opcode import Opcode

from coordlog.episode import Episode
from coordlog.errors import FormatError, SpecError
from coordlog.record.chunk import definitions
from coordlog.record.contents import Contents, contents, require_room
from coordlog.record.decoding import decode, require_messages
from coordlog.record.messages import Encoder
from coordlog.record.metadata import vouched
from coordlog.record.opening import File, summary_start
from coordlog.record.reader import attachments, metadata
from coordlog.record.recording import Recording
from coordlog.record.records import DATA_END, FOOTER, MAGIC, RECORD_HEAD, TAIL_SIZE, walk
from coordlog.record.schema import column
from coordlog.spec import JOINT_STATE_TOPIC
from coordlog.verify.bitflip import locate
from coordlog.verify.damage import damages
from coordlog.verify.finding import Finding, Problem
from coordlog.verify.structure import schemas_fit, structure
from coordlog.verify.values import content

LEVELS = ("file", "content")

_COMPARED = RECORD_HEAD.size + 2
"""Where in a message record what must come out again begins: after the channel's id."""
_RECORDED = _COMPARED + 4
"""The same of a message that another tool numbered: after its sequence number."""


def check(source: File | Recording, *, level: str = "content") -> list[Finding]:
    """Everything that is wrong with one file, from its bytes upwards; what stands on damaged ground
    is not looked at.

    Args:
        source: The file, or a recording, which then has its bytes.
        level: "file" or "content", which includes "file".

    Raises:
        StorageError: if the file cannot be read.
    """
    recording = source if isinstance(source, Recording) else Recording(source)
    name = recording.source
    try:
        data = recording.data
        if level == "file" and recording.untouched:
            start = summary_start(data[-TAIL_SIZE:], len(data))
            if schemas_fit(definitions(data[start:])):
                return []
    except FormatError as error:
        return [Finding(name, "file", None, "file", "a finished coordlog episode", str(error))]
    found = [Finding(name, "file", *problem) for problem in _file(recording)]
    if found or level == "file":
        return found
    return [Finding(name, "content", *problem) for problem in _content(data)]


def rewritten(source: File | Recording) -> str:
    """What to say of an episode whose bytes another program wrote anew; "" if coordlog did.

    Raises:
        FormatError: if the file is no episode.
        StorageError: if it cannot be read.
    """
    recording = source if isinstance(source, Recording) else Recording(source)
    if not recording.rewritten:
        return ""
    said = "the bytes differ, every value is checked as it was recorded"
    return f"rewritten by {recording.rewritten}: {said}"


def _file(recording: Recording) -> list[Problem]:
    data, spans = recording.data, recording.spans
    try:
        if recording.rewritten:
            return list(_foreign(data))
        start = summary_start(memoryview(data)[-TAIL_SIZE:], len(data))
        found = list(_checksums(data, start))
        if not found:
            before = [span for span in spans if span.end <= start]
            require_room(memoryview(data), before)
            found = list(structure(data, start, before))
        if not found and not recording.untouched:
            _require_promised(data)
    except FormatError as error:
        return [Problem(None, "file", "a finished episode", str(error))]
    return found


def _require_promised(data: bytes) -> None:
    """Hold the values to the commit marker, in a file whose bytes are not those that it names.

    Raises:
        FormatError: naming the first topic that is not as it was written.
    """
    if "bytes" in vouched(metadata(data)):  # else it is of a release that promised no bytes
        found = contents(data)
        found.own = False  # whoever wrote our layout anew: its CRCs say nothing of ours
        decode(found)


def _foreign(data: bytes) -> Iterator[Problem]:
    """What is wrong in a file that another tool wrote: all that its CRCs and the commit marker
    vouch for; its layout is its own affair.
    """
    for span in walk(data):
        if span.opcode == Opcode.DATA_END:
            stop = span.start - RECORD_HEAD.size
            (crc,) = struct.unpack_from("<I", data, span.start)
            if crc not in (0, zlib.crc32(memoryview(data)[:stop])):
                yield from damages(data, stop, crc)
                return
            break
    found = contents(data)
    decode(found)
    attachments(data)
    for topic in require_messages(found, vouched(found.metadata)):
        yield Problem(None, f"topic {topic}", "its messages", "none: another tool left them out")


def _checksums(data: bytes, start: int) -> Iterator[Problem]:
    """The two CRCs that cover every byte but their own, and the bytes around those."""
    stop = start - DATA_END.size
    opcode, length, crc = DATA_END.unpack_from(data, stop) if stop >= len(MAGIC) else (0, 0, 0)
    if opcode != Opcode.DATA_END or length != DATA_END.size - RECORD_HEAD.size:
        yield Problem(None, "data end", f"a record at byte {stop}", "none")
    elif crc != zlib.crc32(memoryview(data)[:stop]):
        yield from damages(data, stop, crc)
    summary, stored = (
        memoryview(data)[start : len(data) - len(MAGIC) - 4],
        FOOTER.unpack_from(data, len(data) - TAIL_SIZE)[-1],
    )
    if stored != zlib.crc32(summary):
        flip = locate(summary, stored)
        where = (
            ""
            if flip is None
            else f": bit {flip.bit} of byte {start + flip.byte} of the file is flipped"
        )
        yield Problem(None, "summary", f"CRC {stored:08x}", f"{zlib.crc32(summary):08x}{where}")


def _content(data: bytes) -> list[Problem]:
    found = contents(data)
    try:
        episode = decode(found)
        return [*_messages(found, episode), *content(episode)]
    except (FormatError, SpecError) as error:
        return [Problem(None, "messages", "those of an episode", str(error))]
    except (
        KeyError,
        TypeError,
        IndexError,
        ValueError,
        OverflowError,
    ) as error:  # metadata of another shape than documented
        return [
            Problem(
                None,
                "metadata",
                "the keys that coordlog.episode.Header lists",
                f"{type(error).__name__}: {error}",
            )
        ]


def _messages(found: Contents, episode: Episode) -> Iterator[Problem]:
    """Encode the decoded columns again: every message must come out as it stands in the file, but
    for the channel it is on. Topics that are made for viewers from the model are not compared, nor
    those whose schema has more fields than are read.
    """
    columns = {name: values[: len(episode)] for name, values in episode.columns.items()}
    final = {name: episode.columns[name][-1:] for name in episode.before}
    encoder = Encoder(episode.header, display=True)
    wanted = encoder.final(len(episode), final)
    if len(episode):
        inputs = episode.inputs or None
        wanted |= encoder.steps(0, columns, episode.contacts, inputs)
    if episode.path is not None:
        wanted |= encoder.path(episode.path)
    start = _COMPARED if found.own else _RECORDED
    for topic in (*encoder.messages, JOINT_STATE_TOPIC):
        stream, message = found.stream(topic), encoder.messages.get(topic)
        if message is None and not stream.records:
            continue
        if message is not None and stream.columns != tuple(map(column, message.fields)):
            continue
        records = wanted[topic].records if topic in wanted else []
        for index, (a, b) in enumerate(zip_longest(records, stream.records)):
            if a is None or b is None or bytes(a[start:]) != b[start:]:
                yield Problem(
                    index, topic, "the message its columns encode to", "another" if b else "none"
                )
                break
