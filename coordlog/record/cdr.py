"""NumPy columns ↔ CDR payloads, whole blocks of messages at once.

Once a robot's lengths are known every message but Contacts has a fixed layout, so a block of
messages is one structured array: encoding fills its columns over a template that already holds
everything constant (encapsulation, sequence lengths, padding), decoding is one `np.frombuffer` and
a comparison with that template. Contacts are fixed for a given count.

Source: DDS-XTypes 1.3 §7.4.3, plain CDR version 1, little-endian: four bytes of encapsulation, then
every value aligned to its own size, counted from the end of the encapsulation; a sequence or string
is preceded by its uint32 length.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from coordlog.episode import Array
from coordlog.errors import FormatError
from coordlog.record.schema import Column, column
from coordlog.spec import Layout, Message

ENCAPSULATION = b"\x00\x01\x00\x00"
"""CDR version 1, little-endian, no options."""

TYPES = {
    "int8": "<i1",
    "uint8": "<u1",
    "byte": "<u1",
    "char": "<u1",
    "int16": "<i2",
    "uint16": "<u2",
    "int32": "<i4",
    "uint32": "<u4",
    "int64": "<i8",
    "uint64": "<u8",
    "float32": "<f4",
    "float64": "<f8",
    "bool": "?",
}
"""NumPy types of the ROS 2 primitives; each is aligned to its size."""

_RAW = "raw bytes"  # a field that overlaps all others


@dataclass(frozen=True, eq=False)
class Codec:
    """The fixed layout of one message type: columns in, payloads out, and back.

    `dtype` has one field per variable field of the message, at the place CDR gives it. `template`
    is a payload whose variable bytes are zero. `fixed` are the indices of all other bytes, and
    `label` says what each of them is part of.
    """

    name: str
    dtype: np.dtype[np.void]
    template: bytes
    fixed: Array
    label: tuple[str, ...]
    fields: tuple[str, ...]
    flags: Array

    def encode(self, rows: Array, columns: Mapping[str, Array]) -> None:
        """Fill rows that start as copies of the template.

        `columns` holds (n, …) values by field name.
        """
        for name in self.fields:
            rows[name] = columns[name]

    def decode(self, rows: Array) -> dict[str, Array]:
        """Contiguous columns by field name out of n payloads.

        Raises:
            FormatError: if a byte that must be constant differs, or a bool is neither 0 nor 1;
                names the field.
        """
        raw = rows[_RAW]
        differs = raw[:, self.fixed] != np.frombuffer(self.template, np.uint8)[self.fixed]
        if differs.any():
            row, byte = np.argwhere(differs)[0]
            at = int(self.fixed[byte])
            raise FormatError(
                f"{self.name} message {row}: {self.label[byte]}: expected byte "
                f"{self.template[at]}, got {raw[row, at]}"
            )
        if self.flags.size and raw[:, self.flags].max(initial=0) > 1:
            raise FormatError(f"{self.name}: a bool is neither 0 nor 1")
        # np.ascontiguousarray would copy nothing of one row, and leave it unaligned
        return {name: np.array(rows[name], order="C") for name in self.fields}


class _Wire:
    """Lays one payload out, field by field."""

    def __init__(self) -> None:
        self.template = bytearray()
        self.offsets: dict[str, tuple[int, object]] = {}
        self.label: dict[int, str] = {}
        self.flags: list[int] = []
        self.constant(ENCAPSULATION, "encapsulation")

    def align(self, size: int, label: str) -> None:
        """Pad to a multiple of `size`, counted from the end of the encapsulation."""
        self.constant(
            bytes(-(len(self.template) - len(ENCAPSULATION)) % size), f"padding before {label}"
        )

    def constant(self, value: bytes, label: str) -> None:
        """Append bytes that are the same in every message."""
        self.label |= dict.fromkeys(
            range(len(self.template), len(self.template) + len(value)), label
        )
        self.template += value

    def length(self, value: int, label: str) -> None:
        """Append the uint32 length of a sequence or string."""
        self.align(4, label)
        self.constant(struct.pack("<I", value), f"length of {label}")

    def string(self, value: str, label: str) -> None:
        """Append a constant string, which counts its closing zero."""
        data = value.encode() + b"\0"
        self.length(len(data), label)
        self.constant(data, label)

    def variable(self, name: str, kind: str, width: int | None) -> None:
        """Append a field: a scalar (`width` None) or a sequence of a known length."""
        if width is not None:
            self.length(width, name)
        item = np.dtype(TYPES[kind])
        if width != 0:  # an empty sequence is not followed by alignment
            self.align(item.itemsize, name)
        at, size = len(self.template), item.itemsize * (1 if width is None else width)
        self.offsets[name] = (at, item if width is None else (item, (width,)))
        self.flags += range(at, at + size) if kind == "bool" else ()
        self.template += bytes(size)

    def codec(self, name: str) -> Codec:
        size = len(self.template)
        dtype = np.dtype(
            {
                "names": [*self.offsets, _RAW],
                "formats": [*(form for _, form in self.offsets.values()), (np.uint8, (size,))],
                "offsets": [*(at for at, _ in self.offsets.values()), 0],
                "itemsize": size,
            }
        )
        fixed = np.array(sorted(self.label), np.intp)
        label = tuple(self.label[int(at)] for at in fixed)
        return Codec(
            name,
            dtype,
            bytes(self.template),
            fixed,
            label,
            tuple(self.offsets),
            np.array(self.flags, np.intp),
        )


Widths = tuple[int | None, ...]
"""Length of each field of a message; None for a scalar."""


@lru_cache(maxsize=256)
def message_codec(message: Message, layout: Layout, contacts: int = 0) -> Codec:
    """The codec of a message of `spec` for one robot.

    `contacts` is the length c of Contacts.
    """
    symbols = {"n_j": layout.n_j, "c": contacts}
    widths = tuple(
        symbols[item.size] if item.size in symbols else layout.width(item)
        for item in message.fields
    )
    return columns_codec(message.name, tuple(map(column, message.fields)), widths)


@lru_cache(maxsize=256)
def columns_codec(name: str, columns: tuple[Column, ...], widths: Widths) -> Codec:
    """The codec of a message whose fields a schema text declares, for known lengths.

    Raises:
        FormatError: if a field is of a type whose size varies.
    """
    wire = _Wire()
    for item, width in zip(columns, widths, strict=True):
        if item.type not in TYPES:
            raise FormatError(
                f"schema {name}: expected fields of primitive types, got '{item}': "
                "use a release that knows it"
            )
        wire.variable(item.name, item.type, width)
    return wire.codec(name)


def lengths(name: str, columns: tuple[Column, ...], payload: bytes | memoryview) -> Widths:
    """The length of every field as one message has it.

    Raises:
        FormatError: if the message ends within a field, or a field is of a type whose size varies.
    """
    columns_codec(name, columns, tuple(0 if item.array else None for item in columns))
    at, found = len(ENCAPSULATION), []
    for item in columns:
        size, width = np.dtype(TYPES[item.type]).itemsize, None
        if item.array:
            at = _aligned(at, 4) + 4
            width = int.from_bytes(payload[at - 4 : at], "little")
        count = 1 if width is None else width
        at = (_aligned(at, size) if count else at) + count * size
        if at > len(payload):
            raise FormatError(f"{name}: a message of {len(payload)} bytes ends within {item.name}")
        found.append(width)
    return tuple(found)


def _aligned(at: int, size: int) -> int:
    return at + -(at - len(ENCAPSULATION)) % size


@lru_cache(maxsize=64)
def joint_state_codec(names: tuple[str, ...]) -> Codec:
    """The codec of sensor_msgs/msg/JointState for fixed joint names.

    Columns sec, nanosec, position, velocity.
    """
    wire = _Wire()
    wire.variable("sec", "int32", None)
    wire.variable("nanosec", "uint32", None)
    wire.string("", "header.frame_id")
    wire.length(len(names), "name")
    for name in names:
        wire.string(name, "name")
    wire.variable("position", "float64", len(names))
    wire.variable("velocity", "float64", len(names))
    wire.length(0, "effort")
    return wire.codec("sensor_msgs/msg/JointState")
