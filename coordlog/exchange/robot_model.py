"""The model that an imported motion is of: a file of the user's, or a scene of ours."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np

from coordlog.episode import Array
from coordlog.errors import ConfigError, FormatError
from coordlog.mjcf import compose, load_attached, pack_source
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

    @property
    def rest(self) -> Array:
        """Where the model is if nothing says otherwise: its first key frame, or its zero."""
        return np.array(self.model.key_qpos[0] if self.model.nkey else self.model.qpos0)

    @property
    def geoms(self) -> list[str]:
        """Names of the geoms by id; numbered where they have none."""
        return [self.model.geom(i).name or f"geom_{i}" for i in range(self.model.ngeom)]


def read_model(given: str) -> RobotModel:
    """The model of a MJCF or URDF file, of a robot's card, or of one of our scenes.

    Raises:
        ConfigError: if there is no such file or scene, or it does not compile.
    """
    path = Path(given)
    if not path.exists() and given in SCENES:
        scene = find(given)
        name, source = scene.robot.name, compose(scene, EnvConfig())
    elif path.is_file():
        robot = _robot(path)
        name, source = robot.name, whole(robot)
    else:
        raise ConfigError(
            f"--robot {given}: expected a MJCF or URDF file, a robot's card, or a scene: {', '.join(sorted(SCENES))}"
        )
    attachments = pack_source(source)
    try:
        model = load_attached(attachments)  # what the log carries, loaded as it will be
    except FormatError as error:
        raise ConfigError(f"--robot {given}: {error}") from error
    return RobotModel(name, model, attachments)


def _robot(path: Path) -> Robot:
    """The robot of a card, or of a bare model whose arms nobody needs to know here."""
    if path.suffix == ".toml":
        return robot_of(read_tables(path), path.parent)
    arm = Arm("all", palm="", joints=())
    return Robot(path.stem, path, (arm,), poses={"stand": {}})
