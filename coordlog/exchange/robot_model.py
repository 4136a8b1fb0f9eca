"""The model that an imported motion is of: a file of the user's, or a scene of ours."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np

from coordlog.episode import Array
from coordlog.errors import ConfigError, FormatError
from coordlog.mjcf import Looks, compose, load_attached, pack_source, robot_looks
from coordlog.mjcf.printing import Source, printed
from coordlog.mjcf.source import whole
from coordlog.robots.card import read_tables, robot_of
from coordlog.robots.robot import Arm, Robot
from coordlog.tasks.config import EnvConfig
from coordlog.tasks.scene import SCENES, find


class RobotModel(NamedTuple):
    """A compiled model, and what a log carries of it."""

    name: str
    model: mujoco.MjModel
    attachments: Mapping[str, bytes]
    looks: Looks = Looks()
    """What it wears in pictures: part of the attachments, and files for the folder of the logs."""

    @property
    def rest(self) -> Array:
        """Where the model is if nothing says otherwise: its first key frame, or its zero."""
        return np.array(self.model.key_qpos[0] if self.model.nkey else self.model.qpos0)

    @property
    def geoms(self) -> list[str]:
        """Names of the geoms by id; numbered where they have none."""
        return [self.model.geom(i).name or f"geom_{i}" for i in range(self.model.ngeom)]

    def spec(self, joints: Sequence[str]) -> dict[str, Any]:
        """The robot as a header names it, its arm made of the joints that were observed.

        A bare model says nothing of hands: the hand is where its last observed joint leads.
        """
        name = self.hand(joints)
        arm = Arm("arm", palm=name, joints=tuple(joints))
        own = Robot(self.name, "", (arm,), poses={"stand": {}})
        middle = self.model.stat.center.tolist()
        return own.to_json() | {"centre": middle, "reach": float(self.model.stat.extent)}

    def hand(self, joints: Sequence[str]) -> str:
        """The site that stands for the hand: the last one on the last body that joints move."""
        moved = [int(self.model.jnt_bodyid[self.model.joint(name).id]) for name in joints]
        below = [
            i
            for i in range(self.model.nsite)
            if _carries(self.model, max(moved), int(self.model.site_bodyid[i]))
        ]
        return str(self.model.site(below[-1]).name) if below else ""


def read_model(given: str) -> RobotModel:
    """The model of a MJCF or URDF file, of a robot's card, or of one of our scenes.

    Raises:
        ConfigError: if there is no such file or scene, or it does not compile.
    """
    path = Path(given)
    if not path.exists() and given in SCENES:
        scene = find(given)
        robot, source = scene.robot, compose(scene, EnvConfig())
    elif path.is_file():
        robot = _robot(path)
        source = _with_hands(whole(robot))
    else:
        raise ConfigError(
            f"--robot {given}: expected a MJCF or URDF file, a robot's card, or a scene: "
            f"{', '.join(sorted(SCENES))}"
        )
    looks = robot_looks(robot)
    attachments = {**pack_source(source), **looks.attached}
    try:
        model = load_attached(attachments)  # what the log carries, loaded as it will be
    except FormatError as error:
        raise ConfigError(f"--robot {given}: {error}") from error
    return RobotModel(robot.name, model, attachments, looks)


def _with_hands(source: Source) -> Source:
    """The model with a site on every body that ends a chain, where a hand may be."""
    spec = mujoco.MjSpec.from_string(source.text)
    spec.assets = dict(source.assets)
    for i, body in enumerate(spec.bodies):
        if body.parent is not None and not body.bodies and not body.sites:
            body.add_site(name=f"end_{body.name or i}")
    spec.compile()
    return Source(printed(spec), source.assets)


def _carries(model: mujoco.MjModel, body: int, other: int) -> bool:
    """Whether a body is another one or moves it."""
    while other and other != body:
        other = int(model.body_parentid[other])
    return other == body


def _robot(path: Path) -> Robot:
    """The robot of a card, or of a bare model whose arms nobody needs to know here."""
    if path.suffix == ".toml":
        return robot_of(read_tables(path), path.parent)
    arm = Arm("all", palm="", joints=())
    return Robot(path.stem, path, (arm,), poses={"stand": {}})
