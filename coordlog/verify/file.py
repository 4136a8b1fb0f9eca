"""`coordlog check` without the physics: is the file whole, and does its content hold together?

*file*: structure, every CRC, the commit marker, the schemas and the summary. *content*: the
messages of every topic are those that the decoded columns encode to, and all that can be recomputed
from the log is. A finding names file, step and field; damaged content is never an exception.
"""

from __future__ import annotations

import os
import zlib
from collections.abc import Iterator
from itertools import zip_longest

from mcap.opcode import Opcode

from coordlog.episode import Episode
from coordlog.errors import FormatError, SpecError
from coordlog.record.messages import Encoder
from coordlog.record.opening import File, load, summary_start
from coordlog.record.reader import Contents, contents, decode
from coordlog.record.records import DATA_END, FOOTER, MAGIC, RECORD_HEAD, TAIL_SIZE
from coordlog.spec import FINAL, STEP
from coordlog.verify.bitflip import locate
from coordlog.verify.damage import damages
from coordlog.verify.finding import Finding, Problem
from coordlog.verify.structure import structure
from coordlog.verify.values import Rewards, content

LEVELS = ("file", "content")


def check(path: File, *, level: str = "content", rewards: Rewards) -> list[Finding]:
    """Everything that is wrong with one file, from its bytes upwards; what stands on damaged ground
    is not looked at.

    Args:
        path: The file.
        level: "file" or "content", which includes "file".
        rewards: The reward equation, to recompute rewards from logged distances and flags.

    Raises:
        StorageError: if the file cannot be read.
    """
    name = os.fspath(path)
    try:
        data = load(path)
    except FormatError as error:
        return [Finding(name, "file", None, "file", "a finished coordlog episode", str(error))]
    found = [Finding(name, "file", *problem) for problem in _file(data)]
    if found or level == "file":
        return found
    return [Finding(name, "content", *problem) for problem in _content(data, rewards)]


def _file(data: bytes) -> list[Problem]:
    try:
        start = summary_start(memoryview(data)[-TAIL_SIZE:], len(data))
        found = list(_checksums(data, start))
        if not found:
            decode(contents(data))
            found = list(structure(data, start))
    except FormatError as error:
        return [Problem(None, "file", "a finished episode", str(error))]
    return found


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


def _content(data: bytes, rewards: Rewards) -> list[Problem]:
    found = contents(data)
    try:
        episode = decode(found)
        return [*_messages(found, episode), *content(episode, rewards)]
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
    """Encode the decoded columns again: every message of every topic must come out as it stands in
    the file.
    """
    columns = {item.name: getattr(episode, item.name)[: len(episode)] for item in STEP.fields[1:]}
    final = {item.name: getattr(episode, item.name)[-1:] for item in FINAL.fields[1:]}
    encoder = Encoder(episode.header, display=True)
    batches = {FINAL.topic: encoder.final(len(episode), final)}
    if len(episode):
        batches |= encoder.steps(0, columns, episode.contacts)
    if episode.path is not None:
        batches |= encoder.path(episode.path)
    for topic, records in found.messages.items():
        for index, (wanted, got) in enumerate(
            zip_longest(batches[topic].records if topic in batches else [], records)
        ):
            if wanted != got:
                yield Problem(
                    index, topic, "the message its columns encode to", "another" if got else "none"
                )
                break
