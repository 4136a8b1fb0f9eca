"""The policy's state: which numbers, in which order, scaled how.

Written into every log, so a reader can undo it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from coordlog.episode import Array
from coordlog.errors import SpecError
from coordlog.robots.robot import Robot
from coordlog.tasks.config import EnvConfig

COM_SCALE = 0.1
RADIUS_SCALE = 0.1
SPEED_SCALE = 1.0
NEAR = 0.2
"""A sphere is near within this distance of its surface [m]."""
TIP = 1.2
"""An arm's last link reaches from its joint to its palm, and this much of that way in all."""


@dataclass(frozen=True, eq=False)
class StateView:
    """Names, scales and places of the n_x entries of the policy state.

    Entry = (raw - offset) / scale, as float32.
    """

    names: tuple[str, ...]
    offset: Array  # (n_x,)
    scale: Array  # (n_x,)
    places: Mapping[str, slice]
    """Entries of each part: "angles", "palms", "goals", and where present "spheres", "difference",
    "com", "nearness", "velocity"."""

    def __len__(self) -> int:
        return len(self.names)

    def scaled(self, parts: Mapping[str, Array]) -> Array:
        """Parts in physical units, each (..., width), to the state, (..., n_x) float32."""
        raw = np.concatenate([parts[name] for name in self.places], axis=-1)
        return np.asarray((raw - self.offset) / self.scale, dtype=np.float32)

    def physical(self, state: Array, part: str) -> Array:
        """One part of a state in physical units, (..., width) float64: the inverse of `scaled` up
        to float32.
        """
        place = self.places[part]
        return state[..., place].astype(np.float64) * self.scale[place] + self.offset[place]

    def to_json(self) -> dict[str, Any]:
        """What a log carries: names, offsets, scales and places."""
        places = {name: [place.start, place.stop] for name, place in self.places.items()}
        return {
            "state": list(self.names),
            "state_offset": self.offset.tolist(),
            "state_scale": self.scale.tolist(),
            "state_places": places,
        }

    @classmethod
    def from_json(cls, env: Mapping[str, Any]) -> StateView:
        """The view a log carries in its `coordlog.env` record.

        Raises:
            SpecError: if it says nothing of the state's parts.
        """
        if "state_places" not in env:
            raise SpecError(
                "state: expected the places of its parts (state_places), got none: "
                "no task of coordlog's made this episode"
            )
        places = {name: slice(start, stop) for name, (start, stop) in env["state_places"].items()}
        return cls(
            tuple(env["state"]), np.array(env["state_offset"]), np.array(env["state_scale"]), places
        )


def state_view(robot: Robot, limits: Array, *, spheres: int, config: EnvConfig) -> StateView:
    """The state of the paper (angles, palms, goals, and spheres if there are any), then the extras
    the config asks for.

    Args:
        robot: Names and workspace.
        limits: Ranges of the action joints, shape (n_u, 2) [rad].
        spheres: Number of sphere obstacles in the state.
        config: `state_extras`.
    """
    names: list[str] = []
    offset: list[float] = []
    scale: list[float] = []
    places: dict[str, slice] = {}

    def part(name: str, entries: list[str], offsets: list[float], scales: list[float]) -> None:
        places[name] = slice(len(names), len(names) + len(entries))
        names.extend(entries)
        offset.extend(offsets)
        scale.extend(scales)

    def points(prefix: str, labels: list[str]) -> list[str]:
        return [f"{prefix}_{label}_{axis}" for label in labels for axis in "xyz"]

    arms = [arm.name for arm in robot.arms]
    middle, reach = list(robot.centre), [robot.reach] * 3
    part(
        "angles",
        list(robot.action_joints),
        limits.mean(axis=1).tolist(),
        ((limits[:, 1] - limits[:, 0]) / 2).tolist(),
    )
    part("palms", points("palm", arms), middle * len(arms), reach * len(arms))
    part("goals", points("goal", arms), middle * len(arms), reach * len(arms))
    if spheres:
        entries = [
            f"sphere_{i}_{what}" for i in range(spheres) for what in ("x", "y", "z", "radius")
        ]
        part("spheres", entries, [*middle, 0.0] * spheres, [*reach, RADIUS_SCALE] * spheres)
    if "difference" in config.state_extras:
        part(
            "difference",
            points("difference", arms),
            [0.0] * 3 * len(arms),
            [robot.reach / 2] * 3 * len(arms),
        )
    if "com" in config.state_extras and robot.soles:
        part("com", ["com_x", "com_y"], [0.0, 0.0], [COM_SCALE] * 2)
    if "nearness" in config.state_extras and spheres:
        entries = [
            f"near_{i}_{arm}_{axis}" for i in range(spheres) for arm in arms for axis in "xyz"
        ]
        part("nearness", entries, [0.0] * len(entries), [1.0] * len(entries))
    if "velocity" in config.state_extras:
        joints = [f"{name}_velocity" for name in robot.action_joints]
        part("velocity", joints, [0.0] * len(joints), [SPEED_SCALE] * len(joints))
    return StateView(tuple(names), np.array(offset), np.array(scale), places)


def nearness(links: Array, palms: Array, spheres: Array) -> Array:
    """How near each sphere is to the last link of each arm, and which way: (n, spheres, k, 3).

    The direction from the nearest point of the link to the sphere's centre, as long as 1 where its
    surface is touched and shrinking to 0 where it is `NEAR` away.

    Args:
        links: Where the links begin, (n, k, 3) [m].
        palms: (n, k, 3) [m].
        spheres: x, y, z and radius, (n, spheres, 4) [m].
    """
    along, centre = (
        TIP * (palms - links)[:, None],
        spheres[:, :, None, :3],
    )  # (n, 1, k, 3), (n, s, 1, 3)
    from_link = centre - links[:, None]
    share = _dot(from_link, along) / np.maximum(_dot(along, along), 1e-12)
    away = from_link - np.clip(share, 0.0, 1.0)[..., None] * along
    distance = np.sqrt(_dot(away, away))
    near = np.clip(1.0 - (distance - spheres[:, :, None, 3]) / NEAR, 0.0, None)
    return np.asarray(away * (near / np.maximum(distance, 1e-12))[..., None])


def _dot(a: Array, b: Array) -> Array:
    """Scalar products over the last axis, each computed alike however many there are."""
    product = a * b
    return np.asarray(product[..., 0] + product[..., 1] + product[..., 2])
