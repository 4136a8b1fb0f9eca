"""One episode on its way to the viewer: what came out of its file, and everything derived from it
that more than one panel needs.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import rerun as rr

from coordlog.episode import Array, Episode
from coordlog.errors import ConfigError
from coordlog.kinematics.geometry import Geometry, Motion
from coordlog.path import Path as Spline
from coordlog.record.beside import Beside
from coordlog.robots.robot import Robot

TIMELINE = "sim_time"
SPLINE_PARTS = 4
"""A spline is drawn as this many straight lines per piece."""


@dataclass(frozen=True, eq=False)
class Show:
    """An episode to be shown, as read from its file."""

    name: str
    """Title; of several shows each needs its own."""
    episode: Episode
    attachments: Mapping[str, bytes] = field(default_factory=dict)
    """By the names of `coordlog.episode`; the model among them is what is drawn."""
    file: str = ""
    """Where it came from, to be named in the text; "" if it came from no file."""


class Stage:
    """A show with its geometry worked out: places in the recording, times, poses."""

    def __init__(
        self, show: Show, *, label: str = "", offset: float = 0.0, ghost: bool = False
    ) -> None:
        """Work out an episode's geometry.

        Args:
            show: What to show.
            label: Short name that tells it from the other shows, under which all its entities are;
                "" if it is the only one.
            offset: Sideways shift of the whole scene along y [m].
            ghost: Draw it translucent and pale, behind another one.

        Raises:
            FormatError: if the file's model is missing or cannot be used.
        """
        self.show, self.episode = show, show.episode
        self.offset, self.ghost = offset, ghost
        self.robot = Robot.from_json(show.episode.header.env["robot"])
        self.label, self.root = label, "/" + rr.escape_entity_path_part(label) if label else ""
        beside = Beside(show.file) if show.file else None
        self.geometry = Geometry.of(show.episode, show.attachments, beside)
        self.motion: Motion = self.geometry.motion(show.episode.qpos)

    @property
    def arms(self) -> tuple[str, ...]:
        """Arm names, in the order of every per-arm column."""
        return self.episode.header.arms

    @cached_property
    def groups(self) -> dict[str, list[int]]:
        """Action entries by the part of the robot they move: the shared joints, then every arm's
        own.
        """
        index = {name: i for i, name in enumerate(self.robot.action_joints)}
        named = {"shared": self.robot.shared} if self.robot.shared else {}
        named |= {arm.name: arm.joints for arm in self.robot.arms}
        return {group: [index[name] for name in names] for group, names in named.items()}

    def entity(self, *parts: str) -> str:
        """Path of an entity of this show."""
        return self.root + "/" + "/".join(rr.escape_entity_path_part(part) for part in parts)

    @cached_property
    def states(self) -> rr.TimeColumn:
        """Times of the T + 1 states."""
        return clock(self.episode.time)

    @cached_property
    def outcomes(self) -> rr.TimeColumn:
        """Times at which what the T actions led to is known: those of the states they led to."""
        return clock(self.episode.time[1:])

    @cached_property
    def starts(self) -> rr.TimeColumn:
        """Times at which the T actions start."""
        return clock(self.episode.time[:-1])

    @cached_property
    def spline(self) -> tuple[Array, Array] | None:
        """The smoothed path as a dense polyline: times (n,) [s] and angles (n, n_j) [rad].

        Break points are among them, unchanged.
        """
        path = self.episode.path
        if path is None or len(path.time) < 2:
            return None
        steps = np.diff(path.time)[:, None] * (np.arange(SPLINE_PARTS) / SPLINE_PARTS)
        time = np.append((path.time[:-1, None] + steps).ravel(), path.time[-1])
        position = Spline(path.time, path.position, path.velocity)(time)
        position[::SPLINE_PARTS] = path.position
        return time, np.asarray(position)


def clock(time: Array) -> rr.TimeColumn:
    """Simulated seconds as exact nanoseconds of the timeline."""
    return rr.TimeColumn(TIMELINE, duration=np.round(time * 1e9).astype("timedelta64[ns]"))


def stages(shows: Sequence[Show], *, ghosts: bool = False, spacing: float = 1.0) -> list[Stage]:
    """Lay shows out: side by side along y, or all but the last as ghosts in the place of the last.

    Raises:
        ConfigError: without a show, or if two have one name.
        FormatError: if a file's model cannot be used.
    """
    names = [show.name for show in shows]
    if not names or len(set(names)) != len(names):
        raise ConfigError(f"shows: expected one or more, each with a name of its own, got {names}")
    if len(shows) == 1:
        return [Stage(shows[0])]
    return [
        Stage(
            show,
            label=label,
            offset=0.0 if ghosts else spacing * i,
            ghost=ghosts and i < len(shows) - 1,
        )
        for i, (show, label) in enumerate(zip(shows, distinctions(names), strict=True))
    ]


def distinctions(names: Sequence[str]) -> list[str]:
    """What is left of different names without the words they all start and end with.

    >>> distinctions(["table-000003-raw", "table-000004-raw"])
    ['000003', '000004']
    """
    words = [name.split("-") for name in names]
    while min(map(len, words)) > 1 and len({each[0] for each in words}) == 1:
        words = [each[1:] for each in words]
    while min(map(len, words)) > 1 and len({each[-1] for each in words}) == 1:
        words = [each[:-1] for each in words]
    return ["-".join(each) for each in words]
