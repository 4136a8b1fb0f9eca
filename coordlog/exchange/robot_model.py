"""The model that an imported motion is of: a file of the user's, or a scene of ours."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
import zstandard

from coordlog.episode import MODEL_XML, Array
from coordlog.errors import ConfigError, FormatError
from coordlog.mjcf import compose, load_model
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
        frame = _frame(compose(scene, EnvConfig()))
        return RobotModel(scene.robot.name, load_model(frame, None), {MODEL_XML: frame})
    if not path.is_file():
        raise ConfigError(
            f"--robot {given}: expected a MJCF or URDF file, or a scene: {', '.join(sorted(SCENES))}"
        )
    try:
        spec = mujoco.MjSpec.from_file(str(path))
        spec.compile()
        frame = _frame(spec.to_xml())
        model = load_model(frame, None)  # what the log carries, loaded as it will be
    except (ValueError, FormatError) as error:
        raise ConfigError(f"--robot {given}: {str(error).splitlines()[0]}") from error
    return RobotModel(path.stem, model, {MODEL_XML: frame})


def _frame(text: str) -> bytes:
    return zstandard.ZstdCompressor(level=19).compress(text.encode())
