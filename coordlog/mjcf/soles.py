"""Where the corners of a sole are, for feet of any shape."""

from __future__ import annotations

import mujoco
import numpy as np

from coordlog.episode import Array
from coordlog.errors import ConfigError
from coordlog.robots.robot import Robot

QUARTERS = ((-1, -1), (-1, 1), (1, -1), (1, 1))


def corners(spec: mujoco.MjSpec, robot: Robot) -> dict[str, Array]:
    """The four lower corners of every sole in the frame of its body, by sole, (4, 3) each [m].

    A box that lies in its body as the body lies has its own corners; of any other shape they are
    its lowest points as it stands in the model's first posture, and may coincide.

    Raises:
        ConfigError: if a sole is a plane or a height field, which nothing can stand on.
    """
    found = {}
    model = data = None
    for sole in robot.soles:
        geom = spec.geom(sole)
        if geom.type == mujoco.mjtGeom.mjGEOM_BOX and _level(geom):
            centre, half = np.array(geom.pos), np.array(geom.size)
            signs = np.array([(x, y, -1.0) for x, y in QUARTERS])
            found[sole] = centre + signs * half
            continue
        if model is None or data is None:
            model = spec.compile()
            data = mujoco.MjData(model)
            if model.nkey:
                mujoco.mj_resetDataKeyframe(model, data, 0)
            mujoco.mj_kinematics(model, data)
        found[sole] = _lowest(model, data, int(spec.geom(sole).id), robot)
    return found


def _level(geom: mujoco._specs.MjsGeom) -> bool:
    plain = geom.alt.type == mujoco.mjtOrientation.mjORIENTATION_QUAT
    return bool(plain and np.allclose(geom.quat, (1, 0, 0, 0)) and geom.frame is None)


def _lowest(model: mujoco.MjModel, data: mujoco.MjData, geom: int, robot: Robot) -> Array:
    """A geom's four outermost points among its lowest ones, in the frame of its body."""
    kind, size = int(model.geom_type[geom]), model.geom_size[geom]
    turn, place = data.geom_xmat[geom].reshape(3, 3), data.geom_xpos[geom]
    down = np.array([0.0, 0.0, -1.0])
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        mesh = int(model.geom_dataid[geom])
        first, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
        points = model.mesh_vert[first : first + count] @ turn.T + place
    elif kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        points = (place + size[0] * down)[None]
    elif kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        axis = turn[:, 2] * size[1]
        points = np.stack([place - axis, place + axis]) + size[0] * down
    elif kind in (mujoco.mjtGeom.mjGEOM_PLANE, mujoco.mjtGeom.mjGEOM_HFIELD):
        raise ConfigError(
            f"robot '{robot.name}': its sole '{model.geom(geom).name}' is a plane or a height "
            "field: expected a solid geom"
        )
    else:
        half = model.geom_aabb[geom, 3:]
        signs = np.array([(x, y, z) for x, y in QUARTERS for z in (-1.0, 1.0)])
        points = (model.geom_aabb[geom, :3] + signs * half) @ turn.T + place
    low = points[points[:, 2] < points[:, 2].min() + 0.005]
    outer = np.stack([low[np.argmax(low[:, 0] * x + low[:, 1] * y)] for x, y in QUARTERS])
    body = int(model.geom_bodyid[geom])
    return np.asarray((outer - data.xpos[body]) @ data.xmat[body].reshape(3, 3))
