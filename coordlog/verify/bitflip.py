"""Finding the one flipped bit in a block of bytes whose CRC is wrong.

A CRC is linear: the CRC of the damaged bytes XOR the stored one depends only on which bits differ.
For a single flipped bit that difference is different for every position (up to 512 MB), so the
position can be read off it.

Source: the generator polynomial of zlib's CRC-32, 0xEDB88320 reflected, is primitive, of period 2³²
− 1.
"""

from __future__ import annotations

import zlib
from typing import NamedTuple

_POLYNOMIAL = 0xEDB88320


class Flip(NamedTuple):
    """One bit: byte index, and bit within the byte from the lowest."""

    byte: int
    bit: int


def _table() -> tuple[int, ...]:
    table = []
    for value in range(256):
        for _ in range(8):
            value = value >> 1 ^ (_POLYNOMIAL if value & 1 else 0)
        table.append(value)
    return tuple(table)


_TABLE = _table()
_UNDO = {
    entry >> 24: (index, entry) for index, entry in enumerate(_TABLE)
}  # the top byte says which entry was used
_LAST_BYTE = {
    _TABLE[1 << bit]: bit for bit in range(8)
}  # the difference that one bit of the last byte makes


def locate(data: bytes | memoryview, crc: int) -> Flip | None:
    """The bit of `data` that must be flipped for its CRC to be `crc`.

    None if no single bit does it.
    """
    difference = zlib.crc32(data) ^ crc
    for byte in range(len(data) - 1, -1, -1):
        bit = _LAST_BYTE.get(difference)
        if bit is not None:
            return Flip(byte, bit)
        index, entry = _UNDO[difference >> 24]  # undo the effect of the byte that follows
        difference = ((difference ^ entry) << 8 | index) & 0xFFFFFFFF
    return None


def restored(data: bytes | memoryview, flip: Flip) -> bytes:
    """The data with that bit put back."""
    whole = bytearray(data)
    whole[flip.byte] ^= 1 << flip.bit
    return bytes(whole)
