"""One stored episode as one thing: read once, then whatever is asked of it, each part once."""

from __future__ import annotations

import hashlib
import os
import struct
import zlib
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from mcap.opcode import Opcode

from coordlog.episode import INITIAL_STATE, KINDS, Array, Episode, Header, Result
from coordlog.errors import FormatError, TruncatedError
from coordlog.record.contents import Contents, contents
from coordlog.record.decoding import decode, require_header
from coordlog.record.metadata import (
    EPISODE,
    RESULT,
    bytes_text,
    decode_header,
    decode_result,
    digest,
    require_readable,
    require_version,
    vouched,
)
from coordlog.record.opening import (
    File,
    is_own,
    load,
    naming,
    no_marker,
    require_coordlog,
    rewritten_by,
    summary_start,
    writer_of,
)
from coordlog.record.reader import attachments, metadata
from coordlog.record.records import (
    DATA_END,
    FOOTER,
    MAGIC,
    RECORD_HEAD,
    TAIL_SIZE,
    Span,
    unpack_metadata,
    walk,
)
from coordlog.record.writer import LIBRARY

if TYPE_CHECKING:
    import mujoco

_MARKER_INDEX = struct.Struct(f"<BQQQI{len(RESULT)}s")
"""Entry of the commit marker, the last metadata record, in a summary."""


class Recording:
    """A stored episode: its file is read when something is first asked of it, and only then.

    Everything is kept once it was asked for, so a recording can be handed from function to function
    and nobody opens the file again.

    Example:
        >>> recording = Recording("logs/a.mcap")                            # doctest: +SKIP
        >>> recording.header.episode["scene"], recording.result.clean       # doctest: +SKIP
        ('table', True)
        >>> recording.episode.qpos.shape, recording.model.nq                # doctest: +SKIP
        ((111, 34), 34)
    """

    def __init__(self, source: File, data: bytes | None = None) -> None:
        """Name an episode; nothing is read yet.

        Args:
            source: Its file; or with `data` what to call it.
            data: All bytes of the file, where they are at hand (from a pack, a bucket).
        """
        self.source = os.fspath(source)
        self._given = data

    def __repr__(self) -> str:
        return f"Recording({self.source!r})"

    @cached_property
    def data(self) -> bytes:
        """All bytes of the file.

        Raises:
            FormatError: if it is no episode.
            StorageError: if it cannot be read.
        """
        if self._given is None:
            return load(self.source)
        with naming(self.source):
            require_coordlog(self._given)
        return self._given

    @cached_property
    def digest(self) -> str:
        """sha256 of the file: the name by which lineages call it."""
        return hashlib.sha256(self.data).hexdigest()

    @cached_property
    def spans(self) -> list[Span]:
        """Where its records are."""
        return list(walk(self.data))

    @cached_property
    def untouched(self) -> bool:
        """Whether its commit marker vouches for every byte of the file, and the metadata can be
        read; False of files whose marker says nothing of bytes: those of earlier releases.
        """
        try:
            return _untouched(memoryview(self.data))
        except FormatError:
            return False

    @cached_property
    def rewritten(self) -> str:
        """The program that wrote the file's bytes anew; "" if coordlog did."""
        own = self.untouched or is_own(self.data, self.spans)
        return "" if own else rewritten_by(self.data)

    @cached_property
    def observed(self) -> bool:
        """Whether its file says that it came from outside, before anything vouches for that."""
        for span in walk(self.data):
            if span.opcode == Opcode.METADATA:
                name, said = unpack_metadata(self.data[span.start : span.end])
                if name == EPISODE:
                    return said.get("kind") == KINDS[1]
        return False

    @cached_property
    def header(self) -> Header:
        """Who made it how; vouched for.

        Raises:
            FormatError: if a metadata record is missing, not as declared, or not what was written.
        """
        with naming(self.source):
            return decode_header(self._metadata)

    @cached_property
    def result(self) -> Result:
        """How it ended; vouched for.

        Raises:
            TruncatedError: if the episode is not finished.
            FormatError: as `header`.
        """
        with naming(self.source):
            return decode_result(self._metadata[RESULT])

    @cached_property
    def episode(self) -> Episode:
        """Its columns.

        Raises:
            FormatError: if a message is missing or damaged.
        """
        with naming(self.source):
            return decode(self._contents)

    @cached_property
    def attachments(self) -> dict[str, bytes]:
        """Its attachments by name, CRCs and digests verified.

        Raises:
            FormatError: if one is damaged or missing.
        """
        with naming(self.source):
            return attachments(self.data)

    @cached_property
    def model(self) -> mujoco.MjModel:
        """The model it was simulated on, compiled from the attached text.

        Raises:
            FormatError: if there is none, or MuJoCo refuses it.
        """
        from coordlog.mjcf import load_attached

        with naming(self.source):
            return load_attached(self.attachments)

    @cached_property
    def initial_state(self) -> Array:
        """The full integration state it started in, (n_state,) float64.

        Raises:
            FormatError: if it is missing, or no whole number of values.
        """
        with naming(self.source):
            data = self.attachments.get(INITIAL_STATE, b"")
            if not data or len(data) % 8:
                raise FormatError(
                    f"attachment '{INITIAL_STATE}': expected float64 values, got {len(data)} bytes"
                )
        state = np.frombuffer(data, np.float64).copy()
        state.setflags(write=False)
        return state

    def has(self, topic: str) -> bool:
        """Whether the file has messages on a topic."""
        with naming(self.source):
            return topic in self._contents.messages

    @cached_property
    def _contents(self) -> Contents:
        return contents(self.data)

    @cached_property
    def _metadata(self) -> dict[str, dict[str, str]]:
        found = metadata(self.data)
        require_header(found)
        require_version(found[EPISODE])
        if RESULT not in found:
            raise TruncatedError(no_marker(len(self.data)))
        vouched(found)
        return {name: dict(values) for name, values in found.items()}


def _untouched(view: memoryview) -> bool:
    """Whether all bytes of a file are those that coordlog wrote when it committed the episode.

    The marker, sealed, holds CRCs of what is before it and of the summary; the end of the data
    section holds that of the rest. A tool that changes bytes and writes right CRCs anew does not
    write those of the marker.
    """
    size = len(view)
    start = summary_start(view[-TAIL_SIZE:], size)
    stop = start - DATA_END.size
    *_, offsets, stored = FOOTER.unpack_from(view, size - TAIL_SIZE)
    entry = offsets - _MARKER_INDEX.size
    if not start <= entry <= size - TAIL_SIZE - _MARKER_INDEX.size:
        return False
    opcode, _, at, length, _, name = _MARKER_INDEX.unpack_from(view, entry)
    if (opcode, name) != (Opcode.METADATA_INDEX, RESULT.encode()) or at + length != stop:
        return False
    if length < RECORD_HEAD.size:
        return False
    head = RECORD_HEAD.pack(Opcode.METADATA, length - RECORD_HEAD.size)
    if view[at : at + RECORD_HEAD.size] != head:
        return False
    name, marker = unpack_metadata(bytes(view[at + RECORD_HEAD.size : stop]))
    before = zlib.crc32(view[:at])
    end = DATA_END.pack(
        Opcode.DATA_END, DATA_END.size - RECORD_HEAD.size, zlib.crc32(view[at:stop], before)
    )
    summary = zlib.crc32(view[start : size - len(MAGIC) - 4])
    said = {key: value for key, value in marker.items() if key != "seal"}
    if (
        name != RESULT
        or said.get("bytes") != bytes_text(before, summary)
        or (bytes(view[stop:start]), stored) != (end, summary)
        or marker.get("seal") != digest(said)
    ):
        return False
    if writer_of(view) != LIBRARY:  # this release holds what it writes to the same tables
        records = metadata(view)
        require_header(records)
        require_readable(records)
        decode_result(marker)
    return True
