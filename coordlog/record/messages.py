"""Blocks of steps, contacts, final states and paths ↔ the messages of each topic; encoding and
decoding side by side.

`Encoder` makes one `Batch` per topic that has something to say; the `decode_…` functions take a
topic's `Stream`: its messages, and the fields that the file's own schema declares. log_time = start
of the episode + simulated time, in integer ns, strictly increasing within a topic.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from coordlog.episode import CONTACT, Array, Header, Path
from coordlog.errors import FormatError, SpecError
from coordlog.record.cdr import (
    columns_codec,
    joint_state_codec,
    lengths,
    message_codec,
)
from coordlog.record.chunk import PREFIX_SIZE, Batch, decode, encode
from coordlog.record.schema import Column, column, require_fields
from coordlog.record.topics import arm_topic, task_messages, topics
from coordlog.spec import (
    CONTACTS,
    FINAL,
    INPUTS,
    JOINT_STATE_TOPIC,
    KNOT,
    SPLINE,
    STEP,
    V1_STEP,
    Layout,
    Message,
    arm_message,
)

if TYPE_CHECKING:
    from coordlog.record.display import Shown

NS = 1_000_000_000

Records = Sequence[bytes | memoryview]
Columns = Mapping[str, Array]

_COUNT_AT = (
    PREFIX_SIZE + 12
)  # where a Contacts record holds the length of its first sequence: after encapsulation and step
_CONTACT_COLUMNS = tuple(name for name in CONTACT.names or () if name != "step")


class Stream(NamedTuple):
    """The messages of one topic, and the fields its schema declares; no fields if the file has no
    such topic.
    """

    columns: tuple[Column, ...]
    records: Records


def log_times(start_time: int, time: Array, *, after: int = -1) -> Array:
    """Log times [ns since the epoch] of simulated times [s].

    Raises:
        SpecError: if the times are not finite, or do not increase by at least a nanosecond, from
            `after` [ns] on.
    """
    if not np.isfinite(time).all():
        raise SpecError("time: expected finite seconds, got a value that is not")
    ns: Array = np.rint(time * NS).astype(np.int64) + start_time
    if ns[0] <= after or (ns[1:] <= ns[:-1]).any():
        early = np.diff(ns, prepend=after) <= 0
        raise SpecError(
            f"time: expected strictly increasing seconds, got {time[early][0]} after one that is "
            "not smaller"
        )
    return ns.astype(np.uint64)


def step_message(header: Header) -> Message:
    """The message of a step as the header's schema version has it."""
    return V1_STEP if header.version == 1 else STEP


class Encoder:
    """Turns the columns of one episode into batches of messages, by topic."""

    def __init__(self, header: Header, *, display: bool, shown: Shown | None = None) -> None:
        """Prepare for one episode.

        Args:
            header: Its metadata; of version 1 too, for comparing.
            display: Also make /joint_states and /coordlog/arm/NAME.
            shown: Also make /tf and /robot_description, of this.
        """
        self.layout, self.arms = header.layout, header.arms
        self.start_time: int = header.episode["start_time"]
        self._display, self._last, self._shown = display, -1, shown
        self._step = step_message(header)
        self._task = task_messages(header) if header.version > 1 else ()
        self._arm = arm_message(header.task, header.task_fields)
        fixed = (self._step, FINAL, CONTACTS, INPUTS, KNOT, SPLINE)
        self.messages = {message.topic: message for message in (*fixed, *self._task)} | {
            arm_topic(name): self._arm for name in self.arms
        }
        """Of every topic but those made from the model the message."""
        self._channel = {name: topic.id for name, topic in topics(header).items()}
        self._every = 1 if shown is None else shown.every(header.episode["control_period"])
        joints = header.env["joints"]
        self._names = tuple(joint["name"] for joint in joints)
        self._qpos, self._qvel = ([int(joint[key]) for joint in joints] for key in ("qpos", "qvel"))

    def steps(
        self, first_step: int, columns: Columns, contacts: Array, inputs: Columns | None = None
    ) -> dict[str, Batch]:
        """The batches of a block of steps; contacts are CONTACT rows sorted by step, inputs columns
        of `spec.INPUTS`.
        """
        n = len(columns["time"])
        step = np.arange(first_step, first_step + n)
        times = log_times(self.start_time, columns["time"], after=self._last)
        self._last = int(times[-1])
        numbered = {**_filled(self._step, columns, n), "step": step}
        batches = {STEP.topic: self._batch(self._step, times, step, numbered)}
        for message in self._task[:1]:
            if message.fields[1].name in columns:
                batches[message.topic] = self._batch(message, times, step, numbered)
        if len(contacts):
            batches[CONTACTS.topic] = self._contacts(contacts, first_step, times)
        if inputs is not None and len(inputs["step"]):
            batches[INPUTS.topic] = self._inputs(inputs, first_step, times)
        if self._display:
            batches |= self._joint_states(times, step, columns) | self._arm_scalars(
                times, step, columns
            )
        if self._shown is not None:
            batches |= self._shown.batches(
                self._channel,
                times,
                step,
                qpos=columns["qpos"],
                inputs=inputs,
                every=self._every,
            )
        return batches

    def final(self, step: int, columns: Columns) -> dict[str, Batch]:
        """The batches of the state after the last action; columns of one row."""
        steps = np.array([step])
        times = log_times(self.start_time, columns["time"], after=self._last)
        numbered = {**columns, "step": steps}
        return {
            message.topic: self._batch(message, times, steps, numbered)
            for message in (FINAL, *self._task[1:])
            if message.fields[-1].name in columns
        }

    def path(self, path: Path) -> dict[str, Batch]:
        """The batches of a smoothed path."""
        knots = {"time": path.knot_time, "position": path.knot_position, "weight": path.knot_weight}
        spline = {"time": path.time, "position": path.position, "velocity": path.velocity}
        return {
            message.topic: self._batch(
                message,
                log_times(self.start_time, columns["time"]),
                np.arange(len(columns["time"])),
                columns,
            )
            for message, columns in ((KNOT, knots), (SPLINE, spline))
        }

    def _batch(self, message: Message, times: Array, sequence: Array, columns: Columns) -> Batch:
        codec = message_codec(message, self.layout)
        return encode(
            codec, self._channel[message.topic], log_time=times, sequence=sequence, columns=columns
        )

    def _contacts(self, contacts: Array, first_step: int, times: Array) -> Batch:
        """One message per step that has contacts.

        Steps with equally many contacts are encoded together.
        """
        steps, first, counts = np.unique(contacts["step"], return_index=True, return_counts=True)
        times = times[steps - first_step]
        records: list[bytes | memoryview] = [b""] * len(steps)
        for count in np.unique(counts).tolist():
            (where,) = np.nonzero(counts == count)
            rows = contacts[first[where, None] + np.arange(count)]  # (messages, count)
            columns = {name: rows[name] for name in _CONTACT_COLUMNS} | {"step": steps[where]}
            codec = message_codec(CONTACTS, self.layout, count)
            batch = encode(
                codec,
                self._channel[CONTACTS.topic],
                log_time=times[where],
                sequence=steps[where],
                columns=columns,
            )
            for index, record in zip(where.tolist(), batch.records, strict=True):
                records[index] = record
        return Batch(self._channel[CONTACTS.topic], times, records)

    def _inputs(self, inputs: Columns, first_step: int, times: Array) -> Batch:
        """One message per change; a later substep of one step is a nanosecond later."""
        when = times[inputs["step"] - first_step] + inputs["substep"].astype(np.uint64)
        widths = tuple(inputs[item.name].shape[1] if item.size else None for item in INPUTS.fields)
        codec = columns_codec(INPUTS.name, tuple(map(column, INPUTS.fields)), widths)
        channel = self._channel[INPUTS.topic]
        return encode(codec, channel, log_time=when, sequence=inputs["step"], columns=inputs)

    def _joint_states(self, times: Array, step: Array, columns: Columns) -> dict[str, Batch]:
        sec, nanosec = np.divmod(times, np.uint64(NS))
        values = {
            "sec": sec,
            "nanosec": nanosec,
            "position": columns["qpos"][:, self._qpos],
            "velocity": columns["qvel"][:, self._qvel],
        }
        codec = joint_state_codec(self._names)
        return {
            JOINT_STATE_TOPIC: encode(
                codec,
                self._channel[JOINT_STATE_TOPIC],
                log_time=times,
                sequence=step,
                columns=values,
            )
        }

    def _arm_scalars(self, times: Array, step: Array, columns: Columns) -> dict[str, Batch]:
        fields = [item for item in self._arm.fields if item.name in columns]
        if len(fields) != len(self._arm.fields):
            return {}
        codec, batches = message_codec(self._arm, self.layout), {}
        for index, arm in enumerate(self.arms[: self.layout.k]):
            values = {item.name: columns[item.name][:, index] for item in fields}
            batches[arm_topic(arm)] = encode(
                codec, self._channel[arm_topic(arm)], log_time=times, sequence=step, columns=values
            )
        return batches


def _filled(message: Message, columns: Columns, n: int) -> Columns:
    """The columns, with empty ones for actuators where they are not logged."""
    missing = {
        item.name: np.zeros((n, 0))
        for item in message.fields
        if item.size == "n_c" and item.name not in columns
    }
    return {**columns, **missing}


def decode_topic(stream: Stream, message: Message, layout: Layout) -> dict[str, Array]:
    """Columns of a topic's messages by field name, `step` included; of one episode, or of several
    one after the other. The layout is the file's own: fields that are not the message's are left.

    Raises:
        FormatError: if the file's schema lacks a field or has it with another type, or a message is
            not as long as the layout says.
    """
    wanted = tuple(map(column, message.fields))
    if not stream.records or stream.columns == wanted:
        return decode(message_codec(message, layout), stream.records)[1]
    require_fields(message.name, stream.columns, message.fields)
    widths = lengths(message.name, stream.columns, stream.records[0][PREFIX_SIZE:])
    declared = {item.name: layout.width(item) for item in message.fields}
    for item, width in zip(stream.columns, widths, strict=True):
        if declared.get(item.name, width) != width:
            raise FormatError(
                f"{message.name}: expected {declared[item.name]} entries of {item.name} for this "
                f"robot, got {width}"
            )
    columns = decode(columns_codec(message.name, stream.columns, widths), stream.records)[1]
    return {item.name: columns[item.name] for item in message.fields}


def decode_inputs(stream: Stream) -> dict[str, Array]:
    """Columns of Inputs messages; none of an episode that has none.

    Raises:
        FormatError: as `decode_topic`.
    """
    if not stream.records:
        return {}
    require_fields(INPUTS.name, stream.columns, INPUTS.fields)
    widths = lengths(INPUTS.name, stream.columns, stream.records[0][PREFIX_SIZE:])
    columns = decode(columns_codec(INPUTS.name, stream.columns, widths), stream.records)[1]
    return {item.name: columns[item.name] for item in INPUTS.fields}


def decode_path(knots: Stream, spline: Stream, layout: Layout) -> Path:
    """A smoothed path."""
    knot = decode_topic(knots, KNOT, layout)
    curve = decode_topic(spline, SPLINE, layout)
    return Path(
        knot["time"],
        knot["position"],
        knot["weight"],
        curve["time"],
        curve["position"],
        curve["velocity"],
    )


def decode_contacts(stream: Stream, layout: Layout) -> Array:
    """CONTACT rows of Contacts messages, sorted by step.

    Raises:
        FormatError: if a message is not as long as its count says, or the schema has other fields.
    """
    wanted = tuple(map(column, CONTACTS.fields))
    if stream.records and stream.columns != wanted:
        require_fields(CONTACTS.name, stream.columns, CONTACTS.fields)
        raise FormatError(f"schema {CONTACTS.name}: expected no field but {wanted}")
    groups: dict[int, list[bytes | memoryview]] = {}
    for record in stream.records:
        count = int.from_bytes(record[_COUNT_AT : _COUNT_AT + 4], "little")
        groups.setdefault(count, []).append(record)
    parts = [np.empty(0, CONTACT)]
    for count, group in groups.items():
        if count * 44 > len(group[0]):  # 44 bytes a contact
            raise FormatError(
                f"{CONTACTS.name}: {count} contacts do not fit into a message of {len(group[0])} "
                "bytes"
            )
        columns = decode(message_codec(CONTACTS, layout, count), group)[1]
        rows = np.empty((len(group), count), CONTACT)
        rows["step"] = columns["step"][:, None]
        for name in _CONTACT_COLUMNS:
            rows[name] = columns[name]
        parts.append(rows.ravel())
    contacts = np.concatenate(parts)
    return contacts[np.argsort(contacts["step"], kind="stable")]
