"""The feet of a robot along one episode: which corners of its soles the log had on the floor, and
what is over them.
"""

from __future__ import annotations

import mujoco
import numpy as np

from coordlog.episode import Array
from coordlog.errors import FormatError
from coordlog.kinematics.balance import CONTACT_HEIGHT, support_margin
from coordlog.kinematics.base_motion import Logged
from coordlog.robots.robot import Robot
from coordlog.tasks.scene import sole_corner

FALLING = -0.1
"""Margin of balance [m] where there is no support at all.

What is less than no margin is not a distance anyway.
"""


class Footing:
    """The support polygon of one episode: a corner counts if it is on the floor at both logged
    configurations around a time.

    So what counts changes at logged times only. A robot without soles has no corners.
    """

    def __init__(self, model: mujoco.MjModel, robot: Robot, logged: Logged) -> None:
        """Look at the logged configurations.

        Raises:
            FormatError: if the model lacks a sole that the robot names.
        """
        try:
            self.corners: list[int] = [
                model.site(sole_corner(sole, i)).id for sole in robot.soles for i in range(4)
            ]
            """Ids of the sites at the corners of the soles."""
        except KeyError as error:
            raise FormatError(
                f"the attached model lacks what robot '{robot.name}' names: "
                f"{str(error).splitlines()[0]}"
            ) from error
        self._time = logged.time
        self.standing: Array = np.zeros((len(logged.qpos), len(self.corners)), dtype=bool)
        """Which corners are on the floor at each logged configuration, (T, C)."""
        data = mujoco.MjData(model)
        for i, row in enumerate(logged.qpos if self.corners else ()):
            data.qpos[:] = row
            mujoco.mj_kinematics(model, data)
            self.standing[i] = data.site_xpos[self.corners, 2] < CONTACT_HEIGHT

    def margin(self, time: Array, point: Array, corners: Array) -> Array:
        """Signed distance of ground points (n, 2) to the edge of the support polygon of `corners`
        (n, C, 3) at `time` (n,), (n,) [m].
        """
        before = np.clip(
            np.searchsorted(self._time, time, side="right") - 1, 0, len(self._time) - 1
        )
        after = np.minimum(before + 1, len(self._time) - 1)
        standing = corners.copy()
        standing[..., 2] = np.where(self.standing[before] & self.standing[after], 0.0, 1.0)
        return np.asarray(support_margin(point, standing))
