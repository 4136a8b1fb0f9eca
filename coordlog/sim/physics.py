"""N simulations stepped together, with every contact seen at every physics substep.

The batch is persistent: after a substep with `stage=VEL`, contacts and sensors describe the state just reached and the next substep
goes on from them, so looking costs nothing. Whether anything but a sole on the floor touches is read off two counters: sole contacts
have four dimensions and all others three (sim/scene.py), so the number of contact rows tells them apart.
"""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
from mujoco.batch import Batch
from mujoco.batch import SimulationError as BatchError

from coordlog.episode import CONTACT, Array
from coordlog.errors import ConfigError, SimulationError

STATE = mujoco.mjtState.mjSTATE_INTEGRATION
CURRENT = mujoco.mjtStage.mjSTAGE_VEL
CONTACT_ROWS = {mujoco.mjtCone.mjCONE_PYRAMIDAL: (6, 4), mujoco.mjtCone.mjCONE_ELLIPTIC: (4, 3)}
"""Constraint rows of a contact of four and of three dimensions."""
DIVERGED = 1e10
"""MuJoCo's mjMAXVAL: coordinates beyond it are no physics any more."""


def compile_model(xml: str) -> mujoco.MjModel:
    """Compile MJCF text whose contacts can be told apart (module docstring).

    Raises:
        SimulationError: if MuJoCo refuses the text, with MuJoCo's reason.
        ConfigError: if a geom's condim is not 3.
    """
    try:
        model = mujoco.MjModel.from_xml_string(xml)
    except ValueError as error:
        raise SimulationError(f"model: expected MJCF that compiles; MuJoCo says: {str(error).splitlines()[0]}") from error
    if (model.geom_condim != 3).any():
        name = model.geom(int(np.flatnonzero(model.geom_condim != 3)[0])).name
        raise ConfigError(f"geom '{name}': expected condim 3 (only soles get 4, by their pair with the floor), got another")
    return model


class Physics:
    """N simulations of one model on a thread pool; bit-identical to a plain loop at any number of threads."""

    def __init__(self, model: mujoco.MjModel, *, n: int, threads: int = 0, models: Sequence[mujoco.MjModel] | None = None) -> None:
        """Make the batch and bind what every step reads.

        Args:
            model: What every simulation runs on.
            n: Number of simulations.
            threads: Threads to step on; 0 for all cores.
            models: Models of the same layout, one per simulation, that differ in constants (a log's own); None for `model`.
        """
        self.model = model
        self._batch = Batch(model, n, threads, persistent=True)
        if models is not None:
            self._batch.set_models(list(models))
        self.qpos: Array = self._batch.bind("qpos")  # (n, n_q)
        self.qvel: Array = self._batch.bind("qvel")  # (n, n_v)
        self.mocap_pos: Array = self._batch.bind("mocap_pos")  # (n, n_mocap, 3)
        self.sensors: Array = self._batch.bind("sensordata")  # (n, n_sensordata), of the present state
        self.ctrl: Array = self._batch.bind("ctrl")  # (n, n_servos)
        self._counts = tuple(self._batch.bind(name) for name in ("ncon", "nefc", "ne", "nf", "nl"))
        self._sole_rows, self._other_rows = CONTACT_ROWS[mujoco.mjtCone(model.opt.cone)]
        self._pairs = [{int(a), int(b)} for a, b in zip(model.pair_geom1, model.pair_geom2, strict=True)]
        self._scratch = mujoco.MjData(model)
        self._failed = np.zeros(n, dtype=bool)

    @property
    def rows(self) -> Array:
        """Full mjSTATE_INTEGRATION vectors, (n, n_state): a write is the simulation's state at its next call."""
        return np.asarray(self._batch.state)

    def resize(self, ids: Array, geoms: Sequence[int], radii: Array) -> None:
        """Give sphere geoms new radii in some simulations, (len(ids), len(geoms)) [m].

        Writing the size alone would leave the bounding volumes stale and silently drop contacts: set_const follows.
        """
        sizes = self._batch.expand("geom_size")
        sizes[np.asarray(ids)[:, None], list(geoms), 0] = radii
        self._batch.set_const(ids)

    def refresh(self, ids: Array) -> None:
        """Make sensors and contacts those of the states that stand in `rows[ids]`."""
        self._batch.forward(ids, stage=CURRENT)
        self._failed[ids] = False

    def touching(self, ids: Array) -> Array:
        """Contacts other than sole on floor in the present state, a count per simulation."""
        contacts, rows, equality, friction, limits = (count[ids] for count in self._counts)
        rows = rows - equality - friction - limits
        return np.asarray((self._sole_rows * contacts - rows) // (self._sole_rows - self._other_rows))

    def advance(self, ids: Array, before: Array, after: Array, *, substeps: int) -> tuple[Array, list[Array]]:
        """One control step: servo targets move linearly from `before` to `after`, (len(ids), n_u each).

        Returns:
            collision: (len(ids),) bool, any contact other than sole on floor at any substep.
            contacts: per simulation CONTACT rows (step 0), the deepest of each geom pair over the substeps.
        """
        collision = np.zeros(len(ids), dtype=bool)
        seen: list[list[Array]] = [[] for _ in range(len(ids))]
        for substep in range(substeps):
            self.ctrl[ids] = before + (after - before) * ((substep + 1) / substeps)
            self._step(ids)
            touching = self.touching(ids) > 0
            if touching.any():
                collision |= touching
                for i in np.flatnonzero(touching):
                    seen[i].append(self.contacts(int(ids[i]), substep=substep))
        return collision, [deepest(rows) for rows in seen]

    def _step(self, ids: Array) -> None:
        try:
            self._batch.step(ids, stage=CURRENT)
        except BatchError as error:  # those simulations kept their state; the others were stepped
            self._failed[error.ids] = True

    def contacts(self, sim: int, *, substep: int = 0) -> Array:
        """Present contacts of one simulation other than sole on floor, as CONTACT rows."""
        data = self._batch.get_data(sim, self._scratch)
        pairs = np.sort(data.contact.geom, axis=1)
        keep = [i for i, pair in enumerate(pairs) if {int(pair[0]), int(pair[1])} not in self._pairs]
        rows = np.zeros(len(keep), dtype=CONTACT)
        rows["substep"] = substep
        rows["geom1"], rows["geom2"] = pairs[keep, 0], pairs[keep, 1]
        rows["depth"] = -data.contact.dist[keep]
        rows["x"], rows["y"], rows["z"] = data.contact.pos[keep].T
        return rows

    def diverged(self, ids: Array) -> Array:
        """Simulations whose state is no number, or beyond all bounds, (len(ids),) bool."""
        fine = (np.abs(self.qpos[ids]) < DIVERGED).all(axis=1) & (np.abs(self.qvel[ids]) < DIVERGED).all(axis=1)
        return np.asarray(~fine | self._failed[ids])

    def model_of(self, sim: int) -> mujoco.MjModel:
        """The model one simulation runs on, its own sphere sizes included."""
        return self._batch.get_model(sim)


def deepest(rows: Sequence[Array]) -> Array:
    """Of all contacts of a control step, per geom pair the deepest (the first of equals), by geom ids."""
    if not rows:
        return np.zeros(0, dtype=CONTACT)
    every = np.concatenate(rows)
    order = np.lexsort((every["substep"], -every["depth"], every["geom2"], every["geom1"]))
    every = every[order]
    first = np.ones(len(every), dtype=bool)
    first[1:] = (every["geom1"][1:] != every["geom1"][:-1]) | (every["geom2"][1:] != every["geom2"][:-1])
    return np.asarray(every[first])
