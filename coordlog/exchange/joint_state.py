"""`sensor_msgs/msg/JointState` in CDR, many messages at once.

Whatever the order of the names in a message, their padded lengths add up to the same: positions
begin at one place in all messages of the same joints.

Source: OMG CDR (XCDR1, little endian); common_interfaces of ROS 2.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from coordlog.episode import Array
from coordlog.errors import FormatError
from coordlog.exchange.frames import Part
from coordlog.exchange.motion import NS

_LITTLE_ENDIAN = (0, 1)
_ZSTD = np.frombuffer(b"\x28\xb5\x2f\xfd", np.uint8)
"""How a Zstandard frame begins."""


class JointStates(NamedTuple):
    """Joint states of a topic, their columns in the order of the first message's names."""

    names: tuple[str, ...]
    log: Array
    """(n,) int64: log times [ns]"""
    header: Array
    """(n,) int64: header stamps [ns]"""
    position: Array
    """(n, joints) float64"""
    velocity: Array | None
    """(n, joints) float64, if every message has it"""


def decode(parts: Iterable[Part], where: str) -> JointStates:
    """Decode every message, a part at a time, in the order in which they were written.

    Raises:
        FormatError: if a message is not a JointState, or is of other joints than the first.
    """
    found: list[JointStates] = []
    count = 0
    for part in parts:
        if len(part.times):
            found.append(_decoded(part, found[0].names if found else (), where, count))
            count += len(part.times)
    if not found:
        raise FormatError(f"{where}: expected joint states, got not a single message")
    log, header, position = (
        np.concatenate([getattr(each, name) for each in found])
        for name in ("log", "header", "position")
    )
    speeds = [each.velocity for each in found if each.velocity is not None]
    velocity = np.concatenate(speeds) if len(speeds) == len(found) else None
    return JointStates(found[0].names, log, header, position, velocity)


def _decoded(part: Part, names: tuple[str, ...], where: str, first: int) -> JointStates:
    """A part; `first` is the number of its first message, for what is said of it."""
    count = len(part.times)
    header = np.empty(count, np.int64)
    position = velocity = np.empty((count, 0))
    moving = True
    for places, data in sorted(part.groups, key=lambda group: int(group[0][0])):
        if (data[:, :4] == _ZSTD).all():
            raise FormatError(
                f"{where}: expected messages as they are, got each compressed by itself: `ros2 "
                "bag convert` the bag without compression_mode first"
            )
        if data.shape[1] < 16 or (data[:, :2] != _LITTLE_ENDIAN).any():
            raise FormatError(
                f"{where}: message {first + places[0]}: expected a JointState in little-endian CDR"
            )
        header[places] = _stamps(data)
        for rows in _alike_counts(data):
            at = places[rows]
            own, order, columns = _table(data[rows], where, first + at)
            if not position.shape[1]:
                names = names or own
                position, velocity = np.empty((2, count, len(names)))
            to = _places_among(own, names, order, f"{where}: message {first + at[0]}")
            _put(position, at, to, columns[0])
            moving = moving and columns[1].shape == columns[0].shape
            if moving:
                _put(velocity, at, to, columns[1])
    return JointStates(names, part.times, header, position, velocity if moving else None)


def _table(data: Array, topic: str, at: Array) -> tuple[tuple[str, ...], Array, list[Array]]:
    """Names, their order and the columns of messages whose frame name is as long."""
    where = f"{topic}: message {at[0]}"
    own, order, end = _ordered(data, topic, at)
    columns = _columns(data, end, where)
    if columns[0].shape[1] != len(own):
        raise FormatError(
            f"{where}: expected a position for each of {len(own)} joints, got {columns[0].shape[1]}"
        )
    if not own:
        raise FormatError(f"{where}: expected joints, got not a single one")
    return own, order, columns


def _stamps(data: Array) -> Array:
    fields = np.ascontiguousarray(data[:, 4:12]).view("<u4").astype(np.int64)
    return fields[:, 0] * NS + fields[:, 1]


def _alike_counts(data: Array) -> list[Array]:
    """Rows whose frame name is as long: their joint names begin at one place."""
    sizes = np.ascontiguousarray(data[:, 12:16]).view("<u4")[:, 0]
    return [np.flatnonzero(sizes == size) for size in np.unique(sizes)]


def _ordered(data: Array, topic: str, at: Array) -> tuple[tuple[str, ...], Array, int]:
    """Names of the first row, each row's names as places among them (n, joints), or (joints,) if
    all rows have one order, and where the names end.
    """
    where = f"{topic}: message {at[0]}"
    start = _aligned(16 + int(np.ascontiguousarray(data[0, 12:16]).view("<u4")[0]))
    names, end = _names(data[0].tobytes(), start, where)
    if (data[:, start:end] == data[0, start:end]).all():
        return names, np.arange(len(names)), end
    region = np.ascontiguousarray(data[:, start:end])
    rows, first, inverse = np.unique(
        region.view(f"V{end - start}")[:, 0], return_index=True, return_inverse=True
    )
    place = {name: i for i, name in enumerate(names)}
    table = np.zeros((len(rows), len(names)), np.int64)
    for i, row in enumerate(rows):
        where = f"{topic}: message {at[first[i]]}"
        own, own_end = _names(bytes(start) + row.tobytes(), start, where)
        if set(own) != set(names) or own_end != end:
            _refuse(own, names, where)
        table[i] = [place[name] for name in own]
    return names, table[inverse], end


def _names(data: bytes, start: int, where: str) -> tuple[tuple[str, ...], int]:
    count, found = int.from_bytes(data[start : start + 4], "little"), []
    at = start + 4
    for _ in range(count):
        at = _aligned(at)
        size = int.from_bytes(data[at : at + 4], "little")
        if not size or at + 4 + size > len(data):
            raise FormatError(f"{where}: a JointState that ends within its names")
        found.append(data[at + 4 : at + 3 + size].decode("utf-8", "replace"))
        at += 4 + size
    return tuple(found), _aligned(at)


def _columns(data: Array, at: int, where: str) -> list[Array]:
    """Position, velocity and effort of messages laid out alike."""
    columns = []
    for _ in range(3):
        if at + 4 > data.shape[1]:
            raise FormatError(f"{where}: a JointState that was cut off")
        counts = np.ascontiguousarray(data[:, at : at + 4]).view("<u4")
        size = int(counts[0, 0])
        at += 4
        if size > 0:
            at += -(at - 4) % 8  # doubles are aligned to 8 bytes after the encapsulation
        if (counts != size).any() or at + 8 * size > data.shape[1]:
            raise FormatError(f"{where}: a JointState whose lengths do not add up")
        cut = np.ascontiguousarray(data[:, at : at + 8 * size])
        columns.append(cut.view("<f8") if size else np.zeros((len(data), 0)))
        at += 8 * size
    return columns


def _places_among(own: tuple[str, ...], names: tuple[str, ...], order: Array, where: str) -> Array:
    """Each row's joints as places among those of the first message of all."""
    if set(own) != set(names) or len(own) != len(names):
        _refuse(own, names, where)
    return np.array([names.index(name) for name in own], np.int64)[order]


def _put(out: Array, at: Array, to: Array, values: Array) -> None:
    """Put rows of values where they belong: row by row where all have one order."""
    if to.ndim > 1:
        out[at[:, None], to] = values
        return
    straight = (to == np.arange(len(to))).all()
    out[at] = values if straight else values[:, np.argsort(to)]


def _refuse(own: tuple[str, ...], names: tuple[str, ...], where: str) -> None:
    lost, new = sorted(set(names) - set(own)), sorted(set(own) - set(names))
    parts = [f"without {', '.join(lost)}"] * bool(lost) + [f"with {', '.join(new)}"] * bool(new)
    raise FormatError(
        f"{where}: expected the joints of the first message, got a message "
        f"{' and '.join(parts) or 'of other counts'}: the names changed, or several publishers "
        "share the topic; record each on a topic of its own"
    )


def _aligned(at: int) -> int:
    return at + -at % 4
