"""Blocks of steps, contacts, final states and paths ↔ the messages of each topic; encoding and
decoding side by side.

`Encoder` makes one `Batch` per topic that has something to say; the `decode_…` functions take a
topic's message records. log_time = start of the episode + simulated time, in integer ns, strictly
increasing within a topic.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from coordlog.episode import CONTACT, Array, Header, Path
from coordlog.errors import FormatError, SpecError
from coordlog.record.cdr import joint_state_codec, message_codec
from coordlog.record.chunk import PREFIX_SIZE, Batch, decode, encode
from coordlog.record.topics import arm_topic, topics
from coordlog.spec import (
    ARM,
    CONTACTS,
    FINAL,
    JOINT_STATE_TOPIC,
    KNOT,
    SPLINE,
    STEP,
    Layout,
    Message,
)

NS = 1_000_000_000

Records = Sequence[bytes | memoryview]
Columns = Mapping[str, Array]

_COUNT_AT = (
    PREFIX_SIZE + 12
)  # where a Contacts record holds the length of its first sequence: after encapsulation and step
_CONTACT_COLUMNS = tuple(name for name in CONTACT.names or () if name != "step")


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
            f"time: expected strictly increasing seconds, got {time[early][0]} after one that is not smaller"
        )
    return ns.astype(np.uint64)


class Encoder:
    """Turns the columns of one episode into batches of messages, by topic."""

    def __init__(self, header: Header, *, display: bool) -> None:
        self.layout, self.arms = header.layout, header.arms
        self.start_time: int = header.episode["start_time"]
        self._display, self._last = display, -1
        self._channel = {name: topic.id for name, topic in topics(self.arms).items()}
        joints = header.env["joints"]
        self._names = tuple(joint["name"] for joint in joints)
        self._qpos, self._qvel = ([int(joint[key]) for joint in joints] for key in ("qpos", "qvel"))

    def steps(self, first_step: int, columns: Columns, contacts: Array) -> dict[str, Batch]:
        """The batches of a block of steps; contacts are CONTACT rows sorted by step."""
        n = len(columns["time"])
        step = np.arange(first_step, first_step + n)
        times = log_times(self.start_time, columns["time"], after=self._last)
        self._last = int(times[-1])
        batches = {STEP.topic: self._batch(STEP, times, step, {**columns, "step": step})}
        if len(contacts):
            batches[CONTACTS.topic] = self._contacts(contacts, first_step, times)
        if self._display:
            batches |= self._joint_states(times, step, columns) | self._arm_scalars(
                times, step, columns
            )
        return batches

    def final(self, step: int, columns: Columns) -> Batch:
        """The batch of the state after the last action; columns of one row."""
        steps = np.array([step])
        times = log_times(self.start_time, columns["time"], after=self._last)
        return self._batch(FINAL, times, steps, {**columns, "step": steps})

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
        codec, batches = message_codec(ARM, self.layout), {}
        for index, arm in enumerate(self.arms):
            values = {item.name: columns[item.name][:, index] for item in ARM.fields}
            batches[arm_topic(arm)] = encode(
                codec, self._channel[arm_topic(arm)], log_time=times, sequence=step, columns=values
            )
        return batches


def decode_steps(records: Records, layout: Layout) -> dict[str, Array]:
    """Columns of Step messages, `step` included.

    Of one episode, or of several one after the other.
    """
    return decode(message_codec(STEP, layout), records)[1]


def decode_final(records: Records, layout: Layout) -> dict[str, Array]:
    """Columns of the Final message, one row; of several episodes, a row each."""
    return decode(message_codec(FINAL, layout), records)[1]


def decode_path(knots: Records, spline: Records, layout: Layout) -> Path:
    """A smoothed path."""
    knot = decode(message_codec(KNOT, layout), knots)[1]
    curve = decode(message_codec(SPLINE, layout), spline)[1]
    return Path(
        knot["time"],
        knot["position"],
        knot["weight"],
        curve["time"],
        curve["position"],
        curve["velocity"],
    )


def decode_contacts(records: Records, layout: Layout) -> Array:
    """CONTACT rows of Contacts messages, sorted by step.

    Raises:
        FormatError: if a message is not as long as its count says.
    """
    groups: dict[int, list[bytes | memoryview]] = {}
    for record in records:
        count = int.from_bytes(record[_COUNT_AT : _COUNT_AT + 4], "little")
        groups.setdefault(count, []).append(record)
    parts = [np.empty(0, CONTACT)]
    for count, group in groups.items():
        if count * 44 > len(group[0]):  # 44 bytes a contact
            raise FormatError(
                f"{CONTACTS.name}: {count} contacts do not fit into a message of {len(group[0])} bytes"
            )
        columns = decode(message_codec(CONTACTS, layout, count), group)[1]
        rows = np.empty((len(group), count), CONTACT)
        rows["step"] = columns["step"][:, None]
        for name in _CONTACT_COLUMNS:
            rows[name] = columns[name]
        parts.append(rows.ravel())
    contacts = np.concatenate(parts)
    return contacts[np.argsort(contacts["step"], kind="stable")]
