"""The topics from which rerun, Foxglove and RViz show the moving robot: /robot_description and /tf.

Their values come from the logged state and the attached model alone, rounded to what can be seen;
nothing is ever read back from them.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping
from functools import lru_cache

import numpy as np
from mcap.opcode import Opcode

from coordlog.episode import INITIAL_STATE, MODEL_XML, Array
from coordlog.errors import CoordlogError
from coordlog.mjcf import load_attached
from coordlog.record.cdr import ENCAPSULATION
from coordlog.record.chunk import PREFIX_SIZE, Batch
from coordlog.record.records import RECORD_HEAD
from coordlog.sim.description import Description
from coordlog.spec import DESCRIPTION_TOPIC, TRANSFORMS_TOPIC

RATE = 15.0
"""Poses a second, at most: what eyes follow. At every step they would be half of what a file's
viewing topics weigh, and most of what writing them costs."""
NS = 1_000_000_000
_HEAD = struct.Struct("<BQHIQQ")  # opcode, length, channel, sequence, log time, publish time
_VALUES = 7
"""Numbers in a transform: a translation and a quaternion."""


class Shown:
    """What one episode shows: its robot and scene, and where the mocap bodies are."""

    def __init__(
        self, description: Description, state: Array, radii: Mapping[str, float] | None = None
    ) -> None:
        """For one episode.

        Args:
            description: How its model is drawn; shared by episodes.
            state: Its initial integration state, which holds the first poses of mocap bodies.
            radii: Radii of spheres that differ from the model's, by geom [m].
        """
        self._description, self._text = description, description.urdf(radii)
        self._mocap = description.mocap(state)

    @classmethod
    def of(cls, attachments: Mapping[str, bytes]) -> Shown | None:
        """What an episode shows, from its attachments; None where they hold no model that MuJoCo
        takes.
        """
        if MODEL_XML not in attachments:
            return None
        try:
            description = Description(load_attached(attachments))
            state = np.frombuffer(attachments.get(INITIAL_STATE, b""))
        except (CoordlogError, ValueError):
            return None
        return cls(description, state)

    def batches(
        self,
        channel: Mapping[str, int],
        times: Array,
        step: Array,
        *,
        qpos: Array,
        inputs: Mapping[str, Array] | None,
        every: int,
    ) -> dict[str, Batch]:
        """A block of /tf, of every so many steps, and before the first /robot_description."""
        mocap, rows = self._moved(step, inputs), np.flatnonzero(step % every == 0)
        found = {}
        if len(rows):
            transforms = self._description.transforms(qpos[rows], mocap[rows])
            layout = _layout(self._description.links, self._description.parents)
            found[TRANSFORMS_TOPIC] = layout.batch(
                channel[TRANSFORMS_TOPIC], times[rows], step[rows], transforms
            )
        if self._text:
            record = _text(channel[DESCRIPTION_TOPIC], int(times[0]), self._text)
            found[DESCRIPTION_TOPIC] = Batch(channel[DESCRIPTION_TOPIC], times[:1], [record])
            self._text = ""
        return found

    @staticmethod
    def every(control_period: float) -> int:
        """Steps from one pose to the next.

        Example:
            >>> Shown.every(0.04), Shown.every(0.12), Shown.every(0.002)
            (2, 1, 34)
        """
        return max(1, math.ceil(1.0 / (RATE * control_period)))

    def _moved(self, step: Array, inputs: Mapping[str, Array] | None) -> Array:
        """Poses of the mocap bodies at each step, (n, n_mocap, 7)."""
        mocap = np.repeat(self._mocap[None], len(step), axis=0)
        if inputs is not None and self._mocap.size:
            for row, at in enumerate(inputs["step"].tolist()):
                pose = np.hstack(
                    [
                        inputs["mocap_pos"][row].reshape(-1, 3),
                        inputs["mocap_quat"][row].reshape(-1, 4),
                    ]
                )
                mocap[step >= at] = pose
            self._mocap = mocap[-1]
        return mocap


class _Transforms:
    """The fixed layout of a TFMessage for given links: only stamps and numbers vary."""

    def __init__(self, links: tuple[str, ...], parents: tuple[str, ...]) -> None:
        body = bytearray(struct.pack("<I", len(parents)))
        stamps, numbers = [], []
        for link, parent in zip(links[1:], parents, strict=True):
            body += bytes(-len(body) % 4)
            stamps.append(len(body) // 4)
            body += bytes(8) + _string(parent)
            body += bytes(-len(body) % 4) + _string(link)
            body += bytes(-len(body) % 8)
            numbers.append(len(body) // 8)
            body += bytes(8 * _VALUES)
        self._size = len(body)
        self._template = bytes(body) + bytes(-len(body) % 8)
        self._stamps = np.array(stamps, np.intp)
        self._numbers = (np.array(numbers, np.intp)[:, None] + np.arange(_VALUES)).ravel()

    def batch(self, channel: int, times: Array, step: Array, values: Array) -> Batch:
        """One message per row of values, (n, links, 7)."""
        n = len(times)
        body = np.frombuffer(bytearray(self._template * n), np.float64).reshape(n, -1)
        body[:, self._numbers] = values.reshape(n, -1)
        sec, nanosec = np.divmod(times, np.uint64(NS))
        words = body.view(np.uint32)
        words[:, self._stamps], words[:, self._stamps + 1] = sec[:, None], nanosec[:, None]
        rows, records = body.view(np.uint8), []
        length = PREFIX_SIZE + len(ENCAPSULATION) + self._size - RECORD_HEAD.size
        for row, (time, number) in enumerate(zip(times.tolist(), step.tolist(), strict=True)):
            head = _HEAD.pack(Opcode.MESSAGE, length, channel, number, time, time)
            records.append(head + ENCAPSULATION + rows[row, : self._size].tobytes())
        return Batch(channel, times, records)


@lru_cache(maxsize=16)
def _layout(links: tuple[str, ...], parents: tuple[str, ...]) -> _Transforms:
    return _Transforms(links, parents)


def _text(channel: int, time: int, text: str) -> bytes:
    payload = ENCAPSULATION + _string(text)
    length = PREFIX_SIZE + len(payload) - RECORD_HEAD.size
    return _HEAD.pack(Opcode.MESSAGE, length, channel, 0, time, time) + payload


def _string(text: str) -> bytes:
    data = text.encode() + b"\0"
    return struct.pack("<I", len(data)) + data
