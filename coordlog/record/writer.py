"""One episode to one file, a block of steps at a time.

Header and attachments reach the operating system when the writer opens, every block when it is
written: a process that dies leaves NAME.mcap.part with everything up to its last block. `finish`
writes the final state and the commit marker, makes the file durable and gives it its name.
Identical input gives identical bytes.
"""

from __future__ import annotations

from collections.abc import Mapping
from os import PathLike
from pathlib import Path as FilePath
from types import TracebackType

import numpy as np

from coordlog.episode import CONTACT, Array, Episode, Header, Path, Result
from coordlog.errors import FormatError, SpecError
from coordlog.record.chunk import Batch, compose
from coordlog.record.container import Container
from coordlog.record.messages import Columns, Encoder
from coordlog.record.metadata import RESULT, encode_header, encode_result, require_readable
from coordlog.record.storage import PartFile
from coordlog.record.tally import Tally
from coordlog.record.topics import topics
from coordlog.spec import FINAL, STEP, Field
from coordlog.version import __version__

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
    ) -> None:
        """Create the part file and write everything known at the start.

        Args:
            path: Name of the finished file, ending in `.mcap`.
            header: Metadata of the episode; `env["joints"]` lists {name, qpos, qvel} of the joints
                to display.
            attachments: Content by name.
            display: Also write /joint_states and /coordlog/arm/NAME, for viewers.

        Raises:
            StorageError: if the file exists or cannot be written.
            SpecError: if the header cannot be written or read back.
        """
        metadata = encode_header(header)
        try:
            require_readable(metadata)
        except FormatError as error:
            raise SpecError(f"header: {error}") from None
        self.header = header
        self._encoder = Encoder(header, display=display)
        self._tally = Tally(header.layout.k)
        self._topics = topics(header.arms)
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
        self, first_step: int, columns: Columns, *, contacts: Array = _NO_CONTACTS
    ) -> None:
        """Append a block of steps as one chunk and hand it to the operating system.

        Args:
            first_step: Index of the first row: as many steps as were written before.
            columns: The fields of `spec.STEP` but `step`, each (n, …), n ≥ 1.
            contacts: CONTACT rows of these steps, sorted by step.

        Raises:
            SpecError: if a column is missing or of another shape or type, or the steps do not
                follow on.
            StorageError: if the file system refuses; what came before stays in the part file.
        """
        n = len(columns["time"])
        self._validate(STEP.fields[1:], columns, n)
        if first_step != self.length or n == 0:
            raise SpecError(
                f"first_step: expected {self.length} and at least one row, got {first_step} and {n}"
            )
        _validate_contacts(contacts, first_step, first_step + n)
        self._write(self._encoder.steps(first_step, columns, contacts))
        self._tally.add(columns)

    def finish(self, final: Columns, *, aborted: str = "", path: Path | None = None) -> Result:
        """Write the final state and the commit marker, and publish the file: `seal` and then
        `publish`.

        Args:
            final: time, qpos, qvel, state after the last action, without a step axis.
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
        row = {item.name: np.asarray(final[item.name])[None] for item in FINAL.fields[1:]}
        self._validate(FINAL.fields[1:], row, 1)
        batches = {FINAL.topic: self._encoder.final(self.length, row)}
        if path is not None:
            batches |= self._encoder.path(path)
        self._tally.add_states(row)
        result = self._tally.result(aborted)
        self._add(batches)
        self._container.add_metadata(RESULT, encode_result(result))
        self._container.finish()
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

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def _write(self, batches: dict[str, Batch]) -> None:
        self._add(batches)
        self._flush()

    def _add(self, batches: dict[str, Batch]) -> None:
        definitions = b"".join(self._container.define(self._topics[topic]) for topic in batches)
        self._container.add_chunk(compose(definitions, list(batches.values())))

    def _flush(self) -> None:
        self._file.append(self._container.drain())

    def _validate(self, items: tuple[Field, ...], columns: Columns, n: int) -> None:
        for item in items:
            wanted, array = self._encoder.layout.shape(item, n), columns.get(item.name)
            if array is None or array.shape != wanted or array.dtype != np.dtype(item.type):
                got = "nothing" if array is None else f"{array.dtype} of shape {array.shape}"
                raise SpecError(f"{item.name}: expected {item.type} of shape {wanted}, got {got}")


def _validate_contacts(contacts: Array, first: int, stop: int) -> None:
    if contacts.dtype != CONTACT:
        raise SpecError(f"contacts: expected rows of {CONTACT.names}, got {contacts.dtype}")
    steps = contacts["step"]
    if len(steps) and (steps[0] < first or steps[-1] >= stop or (np.diff(steps) < 0).any()):
        raise SpecError(
            f"contacts: expected steps {first} to {stop - 1} in order, got {steps.min()} to {steps.max()}"
        )


def write_episode(
    path: str | PathLike[str], episode: Episode, *, attachments: Mapping[str, bytes], display: bool
) -> Result:
    """Write an episode that is in memory; its `result` is computed anew but for `aborted`.

    Raises:
        StorageError: if the file exists or cannot be written; a part file that was begun stays.
    """
    with EpisodeWriter(path, episode.header, attachments=attachments, display=display) as writer:
        for first in range(0, len(episode), BLOCK):
            stop = min(first + BLOCK, len(episode))
            columns = {
                item.name: getattr(episode, item.name)[first:stop] for item in STEP.fields[1:]
            }
            low, high = np.searchsorted(episode.contacts["step"], (first, stop))
            writer.write_steps(first, columns, contacts=episode.contacts[low:high])
        final = {item.name: getattr(episode, item.name)[-1] for item in FINAL.fields[1:]}
        return writer.finish(final, aborted=episode.result.aborted, path=episode.path)
