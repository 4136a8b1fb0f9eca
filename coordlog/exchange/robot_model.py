"""The model that an imported motion is of: a file of the user's, or a scene of ours."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np

from coordlog.episode import Array
from coordlog.errors import ConfigError, FormatError
from coordlog.mjcf import compose, load_attached, model_alone, pack_source
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
    """The model of a MJCF or URDF file, or of one of our scenes.

    Raises:
        ConfigError: if there is no such file or scene, or it does not compile.
    """
    path = Path(given)
    if not path.exists() and given in SCENES:
        scene = find(given)
        attached = pack_source(compose(scene, EnvConfig()))
        return RobotModel(scene.robot.name, load_attached(attached), attached)
    if not path.is_file():
        raise ConfigError(
            f"--robot {given}: expected a MJCF or URDF file, or a scene: {', '.join(sorted(SCENES))}"
        )
    try:
        attached = pack_source(model_alone(path))
        model = load_attached(attached)  # what the log carries, loaded as it will be
    except (ConfigError, FormatError) as error:
        raise ConfigError(f"--robot {given}: {error}") from error
    return RobotModel(path.stem, model, attached)
