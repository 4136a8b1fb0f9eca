"""One episode to one file, a block of steps at a time.

Header and attachments reach the operating system when the writer opens, every block when it is
written: a process that dies leaves NAME.mcap.part with everything up to its last block. `finish`
writes the final state and the commit marker, makes the file durable and gives it its name.
Identical input gives identical bytes.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from functools import partial
from os import PathLike
from pathlib import Path as FilePath
from typing import TYPE_CHECKING

import numpy as np

from coordlog.episode import CONTACT, MODEL_XML, Array, Episode, Header, Path, Result
from coordlog.errors import FormatError, SpecError
from coordlog.record.chunk import Batch, compose
from coordlog.record.container import Container
from coordlog.record.decoding import payload_crc
from coordlog.record.messages import Columns, Encoder
from coordlog.record.metadata import (
    RESULT,
    encode_commit,
    encode_header,
    require_readable,
    sealed,
)
from coordlog.record.storage import PartFile
from coordlog.record.tally import Tally
from coordlog.record.topics import is_logged, topics
from coordlog.spec import CORE, INPUTS, Field, before
from coordlog.version import __version__

if TYPE_CHECKING:
    from coordlog.record.display import Shown

LIBRARY = f"coordlog/{__version__}"
BLOCK = 25
"""Steps in a chunk: a second of simulated time at the default control period, so that no crash
costs more."""

_NO_CONTACTS = np.empty(0, CONTACT)


class EpisodeWriter:
    """Writes one episode; a context manager that leaves NAME.mcap.part behind unless `finish` was
    reached.

    Not safe to share between threads, but it may be opened, fed and finished on different ones.
    """

    def __init__(
        self,
        path: str | PathLike[str],
        header: Header,
        *,
        attachments: Mapping[str, bytes],
        display: bool,
        shown: Shown | None = None,
    ) -> None:
        """Create the part file and write everything known at the start.

        Args:
            path: Name of the finished file, ending in `.mcap`.
            header: Metadata of the episode; `env["joints"]` lists {name, qpos, qvel} of the joints
                to display. One of version 1 is written as one of this version.
            attachments: Content by name.
            display: Also write /robot_description, /tf, /joint_states and /coordlog/arm/NAME, for
                viewers.
            shown: What the first two say, where the caller has it; otherwise it is made from the
                attached model, and without a model there are none.

        Raises:
            StorageError: if the file exists or cannot be written.
            SpecError: if the header cannot be written or read back.
        """
        header = header.current()
        metadata = encode_header(header)
        try:
            require_readable(metadata)
        except FormatError as error:
            raise SpecError(f"header: {error}") from None
        self.header = header
        if display and shown is None:
            shown = _shown(attachments)
        self._fields = header.fields
        self._encoder = Encoder(header, display=display, shown=shown if display else None)
        self._tally = Tally(header)
        self._topics = topics(header)
        self._metadata = metadata
        self._attached = {
            name: hashlib.sha256(content).hexdigest() for name, content in attachments.items()
        }
        self._messages: dict[str, tuple[int, int]] = {}
        self._container = Container(LIBRARY)
        for name, values in metadata.items():
            self._container.add_metadata(name, values)
        for name, content in attachments.items():
            kind = "application/zstd" if name.endswith(".zst") else "application/octet-stream"
            self._container.add_attachment(
                name, content, media_type=kind, log_time=header.episode["start_time"]
            )
        self._file = PartFile(FilePath(path))
        self._flush()

    @property
    def path(self) -> FilePath:
        """Name of the file once it is finished."""
        return self._file.path

    @property
    def part(self) -> FilePath:
        """Name of the file while it is being written."""
        return self._file.part

    @property
    def length(self) -> int:
        """Steps written so far."""
        return self._tally.length

    def write_steps(
        self,
        first_step: int,
        columns: Columns,
        *,
        contacts: Array = _NO_CONTACTS,
        inputs: Columns | None = None,
    ) -> None:
        """Append a block of steps as one chunk and hand it to the operating system.

        Args:
            first_step: Index of the first row: as many steps as were written before.
            columns: The fields of the header (`Header.fields`), each (n, …), n ≥ 1; of its task all
                or none.
            contacts: CONTACT rows of these steps, sorted by step.
            inputs: What else the physics was given in these steps, when it changed: columns of
                `spec.INPUTS`, sorted by step and substep.

        Raises:
            SpecError: if a column is missing or of another shape or type, or the steps do not
                follow on.
            StorageError: if the file system refuses; what came before stays in the part file.
        """
        n = len(columns["time"])
        self._validate(self._fields, columns, n)
        if first_step != self.length or n == 0:
            raise SpecError(
                f"first_step: expected {self.length} and at least one row, got {first_step} and {n}"
            )
        _validate_contacts(contacts, first_step, first_step + n)
        if inputs is not None:
            _validate_inputs(inputs, first_step, first_step + n)
        self._add(self._encoder.steps(first_step, columns, contacts, inputs))
        self._flush()
        self._tally.add(columns)

    def finish(self, final: Columns, *, aborted: str = "", path: Path | None = None) -> Result:
        """Write the final state and the commit marker, and publish the file: `seal` and then
        `publish`.

        Args:
            final: The fields that hold before an action (`spec.before`), after the last one,
                without a step axis.
            aborted: Why recording stopped before the episode ended; "" if it ended.
            path: The smoothed path that was executed, if this is one.

        Returns:
            The result as written.

        Raises:
            SpecError: if the final state or the path is not what the layout says.
            StorageError: if the file system refuses or the name was taken meanwhile; the part file
                stays.
        """
        result = self.seal(final, aborted=aborted, path=path)
        self.publish()
        return result

    def seal(self, final: Columns, *, aborted: str = "", path: Path | None = None) -> Result:
        """Write the final state, the commit marker and the summary; see `finish`.

        The part file is then complete.
        """
        items = before(self._fields)
        row = {
            item.name: np.asarray(final[item.name])[None] for item in items if item.name in final
        }
        self._validate(items, row, 1)
        batches = self._encoder.final(self.length, row)
        if path is not None:
            batches |= self._encoder.path(path)
        self._tally.add_states(row)
        result = self._tally.result(aborted)
        self._add(batches)
        marker = encode_commit(
            result,
            metadata=self._metadata,
            attachments=self._attached,
            messages=self._messages,
        )
        self._container.commit(RESULT, partial(sealed, marker))
        self._flush()
        return result

    def publish(self) -> None:
        """Make a sealed file durable and give it its name; waits for the disk, so it may run on a
        thread of its own.

        Raises:
            StorageError: if the file system refuses or the name was taken meanwhile; the part file
                stays.
        """
        self._file.publish()

    def close(self) -> None:
        """Let go of the file.

        An unfinished episode stays as a part file, for `coordlog recover`.
        """
        self._file.close()

    def discard(self) -> None:
        """Close and delete the part file: an episode that nobody wants."""
        self._file.discard()

    def __enter__(self) -> EpisodeWriter:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _add(self, batches: dict[str, Batch]) -> None:
        for topic, batch in batches.items():
            if is_logged(topic):
                count, crc = self._messages.get(topic, (0, 0))
                records = batch.records
                self._messages[topic] = (count + len(records), payload_crc(records, crc))
        definitions = b"".join(self._container.define(self._topics[topic]) for topic in batches)
        self._container.add_chunk(compose(definitions, list(batches.values())))

    def _flush(self) -> None:
        self._file.append(self._container.drain())

    def _validate(self, items: tuple[Field, ...], columns: Columns, n: int) -> None:
        task = any(item.owner != CORE and item.name in columns for item in items)
        for item in items:
            if item.owner != CORE and not task:
                continue
            wanted, array = self._encoder.layout.shape(item, n), columns.get(item.name)
            if array is None or array.shape != wanted or array.dtype != np.dtype(item.type):
                got = "nothing" if array is None else f"{array.dtype} of shape {array.shape}"
                raise SpecError(f"{item.name}: expected {item.type} of shape {wanted}, got {got}")


def _shown(attachments: Mapping[str, bytes]) -> Shown | None:
    if MODEL_XML not in attachments:
        return None
    from coordlog.record.display import Shown  # loads MuJoCo

    return Shown.of(attachments)


def _validate_contacts(contacts: Array, first: int, stop: int) -> None:
    if contacts.dtype != CONTACT:
        raise SpecError(f"contacts: expected rows of {CONTACT.names}, got {contacts.dtype}")
    steps = contacts["step"]
    if len(steps) and (steps[0] < first or steps[-1] >= stop or (np.diff(steps) < 0).any()):
        raise SpecError(
            f"contacts: expected steps {first} to {stop - 1} in order, got {steps.min()} to "
            f"{steps.max()}"
        )


def _validate_inputs(inputs: Columns, first: int, stop: int) -> None:
    n = len(inputs.get("step", ()))
    for item in INPUTS.fields:
        array = inputs.get(item.name)
        fits = array is not None and len(array) == n and array.ndim == 1 + bool(item.size)
        if array is None or not fits or array.dtype != np.dtype(item.type):
            got = "nothing" if array is None else f"{array.dtype} of shape {array.shape}"
            raise SpecError(f"inputs: {item.name}: expected {n} rows of {item.type}, got {got}")
    order = inputs["step"] * (1 << 20) + inputs["substep"]
    if n and (
        inputs["step"][0] < first or inputs["step"][-1] >= stop or (np.diff(order) <= 0).any()
    ):
        raise SpecError(f"inputs: expected steps {first} to {stop - 1} in order, each change once")


def _inputs_between(inputs: Columns, first: int, stop: int) -> Columns | None:
    if not inputs:
        return None
    inside = (inputs["step"] >= first) & (inputs["step"] < stop)
    return {name: values[inside] for name, values in inputs.items()}


def write_episode(
    path: str | PathLike[str],
    episode: Episode,
    *,
    attachments: Mapping[str, bytes],
    display: bool,
    shown: Shown | None = None,
    block: int = BLOCK,
) -> Result:
    """Write an episode that is in memory; its `result` is computed anew but for `aborted`.

    Arguments as of `EpisodeWriter`, and `block`, the steps of a chunk.

    Raises:
        StorageError: if the file exists or cannot be written; a part file that was begun stays.
    """
    with EpisodeWriter(
        path, episode.header, attachments=attachments, display=display, shown=shown
    ) as writer:
        for first in range(0, len(episode), block):
            stop = min(first + block, len(episode))
            columns = {name: values[first:stop] for name, values in episode.columns.items()}
            low, high = np.searchsorted(episode.contacts["step"], (first, stop))
            inputs = _inputs_between(episode.inputs, first, stop)
            writer.write_steps(first, columns, contacts=episode.contacts[low:high], inputs=inputs)
        final = {name: episode.columns[name][-1] for name in episode.before}
        return writer.finish(final, aborted=episode.result.aborted, path=episode.path)
