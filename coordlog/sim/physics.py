"""N simulations stepped together, with every contact seen at every physics substep.

A control step is one call that records counters at every substep. Whether anything but a sole on
the floor touches is read off them: sole contacts have four dimensions and all others three
(tasks/scene.py), so the number of contact rows tells them apart. Only where something touches are
the contacts themselves computed again, from the recorded positions, to the same bits.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy

import mujoco
import numpy as np
from mujoco.batch import Batch
from mujoco.batch import SimulationError as BatchError

from coordlog.episode import CONTACT, Array
from coordlog.mjcf import silence

STATE = mujoco.mjtState.mjSTATE_INTEGRATION
CURRENT = mujoco.mjtStage.mjSTAGE_VEL
CONTACT_ROWS = {mujoco.mjtCone.mjCONE_PYRAMIDAL: (6, 4), mujoco.mjtCone.mjCONE_ELLIPTIC: (4, 3)}
"""Constraint rows of a contact of four and of three dimensions."""
DIVERGED = 1e10
"""MuJoCo's mjMAXVAL: coordinates beyond it are no physics any more."""
COUNTERS = ("ncon", "nefc", "ne", "nf", "nl")
"""Contacts, constraint rows, and the rows of equalities, dry friction and joint limits among
them."""


class Physics:
    """N simulations of one model on a thread pool.

    Bit-identical to a plain loop at any number of threads.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        *,
        n: int,
        threads: int = 0,
        models: Sequence[mujoco.MjModel] | None = None,
    ) -> None:
        """Make the batch and bind what every step reads.

        Args:
            model: What every simulation runs on.
            n: Number of simulations.
            threads: Threads to step on; 0 for all cores.
            models: Models of the same layout, one per simulation, that differ in constants (a log's
                own); None for `model`.
        """
        silence()
        self.model = model
        self._batch = Batch(model, n, threads)
        self._own = models is not None
        if models is not None:
            self._batch.set_models(list(models))
        self.qpos: Array = self._batch.bind("qpos")  # (n, n_q)
        self.qvel: Array = self._batch.bind("qvel")  # (n, n_v)
        self.mocap_pos: Array = self._batch.bind("mocap_pos")  # (n, n_mocap, 3)
        self.sensors: Array = self._batch.bind(
            "sensordata"
        )  # (n, n_sensordata), of the present state
        self.ctrl: Array = self._batch.bind("ctrl")  # (n, n_servos)
        self.torque: Array = self._batch.bind(
            "actuator_force"
        )  # (n, n_c) N·m, during the last physics step
        self._time = self._batch.bind("time")
        self._counts = tuple(self._batch.bind(name) for name in COUNTERS)
        self._sole_rows, self._other_rows = CONTACT_ROWS[mujoco.mjtCone(model.opt.cone)]
        self._soles = np.zeros(
            (model.ngeom, model.ngeom), dtype=bool
        )  # pairs of geoms that are a sole and the floor
        for pair in (model.pair_geom1, model.pair_geom2), (model.pair_geom2, model.pair_geom1):
            self._soles[pair] = True
        self._scratch = mujoco.MjData(model)
        self._scratch_model = copy(model)
        self._records = self._buffers(1)
        self._failed = np.zeros(n, dtype=bool)

    @property
    def rows(self) -> Array:
        """Full mjSTATE_INTEGRATION vectors, (n, n_state): a write is the simulation's state at its
        next call.
        """
        return np.asarray(self._batch.state)

    def resize(self, ids: Array, geoms: Sequence[int], radii: Array) -> None:
        """Give sphere geoms new radii in some simulations, (len(ids), len(geoms)) [m].

        Writing the size alone would leave the bounding volumes stale and silently drop contacts:
        set_const follows.
        """
        sizes = self._batch.expand("geom_size")
        sizes[np.asarray(ids)[:, None], list(geoms), 0] = radii
        self._batch.set_const(ids)
        self._own = True

    def refresh(self, ids: Array) -> None:
        """Make sensors and contacts those of the states that stand in `rows[ids]`."""
        self._failed[ids] = False
        self._look(ids)

    def touching(self, ids: Array) -> Array:
        """Contacts other than sole on floor in the present state, a count per simulation."""
        return self._others(*(count[ids] for count in self._counts))

    def _others(
        self, contacts: Array, rows: Array, equality: Array, friction: Array, limits: Array
    ) -> Array:
        rows = rows - equality - friction - limits
        return np.asarray(
            (self._sole_rows * contacts - rows) // (self._sole_rows - self._other_rows)
        )

    def advance(
        self, ids: Array, before: Array, after: Array, *, substeps: int
    ) -> tuple[Array, list[Array]]:
        """One control step: servo targets move linearly from `before` to `after`, (len(ids),
        n_servos) each.

        Returns:
            collision: (len(ids),) bool, any contact other than sole on floor at any substep.
            contacts: per simulation CONTACT rows (step 0), the deepest of each geom pair over the
                substeps.
        """
        records = self._run(ids, before, after, substeps)
        # A record made after a substep counts the contacts of the state before it: the first is last step's, the last is missing.
        touching = np.empty((len(ids), substeps), dtype=np.int64)
        touching[:, :-1] = self._others(*(records[name][:, 1:] for name in COUNTERS))
        touching[:, -1] = self.touching(ids)
        touching[self.diverged(ids)] = 0
        return np.asarray(touching.any(axis=1)), self._touched(ids, records["qpos"], touching > 0)

    def _run(self, ids: Array, before: Array, after: Array, substeps: int) -> dict[str, Array]:
        """Step with servo targets from `before` to `after`.

        Counters and qpos after every substep, (len(ids), substeps, …).
        """
        if self._records["qpos"].shape[1] != substeps:
            self._records = self._buffers(substeps)
        records = {name: buffer[: len(ids)] for name, buffer in self._records.items()}
        ctrl = records.pop("ctrl")
        share = (np.arange(substeps) + 1.0) / substeps
        np.multiply((after - before)[:, None], share[:, None], out=ctrl)
        ctrl += before[:, None]
        end = self._time[ids] + (substeps - 0.5) * self.model.opt.timestep
        try:
            self._batch.rollout(substeps, control=ctrl, record=tuple(records), ids=ids, out=records)
        except BatchError as error:  # those simulations kept their state; the others were stepped
            self._failed[error.ids] = True
        self._failed[ids] |= ~(self._time[ids] > end)  # MuJoCo gave up under way
        self._look(ids)
        return records

    def _look(self, ids: Array) -> None:
        try:
            self._batch.forward(ids, stage=CURRENT)
        except BatchError as error:
            self._failed[error.ids] = True
        fine = (np.abs(self.qpos[ids]) < DIVERGED).all(axis=1) & (
            np.abs(self.qvel[ids]) < DIVERGED
        ).all(axis=1)
        self._failed[ids] |= ~fine

    def _buffers(self, substeps: int) -> dict[str, Array]:
        """What goes into a control step and is recorded in it.

        Allocated once, because fresh pages cost more than the arithmetic.
        """
        n, model = len(self.qpos), self.model
        counters: dict[str, Array] = {
            name: np.zeros((n, substeps), dtype=np.int32) for name in COUNTERS
        }
        return {
            **counters,
            "qpos": np.zeros((n, substeps, model.nq)),
            "ctrl": np.zeros((n, substeps, model.nu)),
        }

    def _touched(self, ids: Array, qpos: Array, touching: Array) -> list[Array]:
        """Contacts of each simulation, the deepest of each pair over the substeps at which it is
        `touching` (len(ids), substeps).
        """
        data, found = self._scratch, []
        for i in np.flatnonzero(touching.any(axis=1)):
            model = (
                self._batch.get_model(int(ids[i]), self._scratch_model) if self._own else self.model
            )
            mujoco.mj_setState(model, data, self.rows[ids[i]], STATE)
            for substep in np.flatnonzero(touching[i]):
                data.qpos[:] = qpos[i, substep]
                mujoco.mj_kinematics(model, data)
                mujoco.mj_collision(model, data)
                contact = data.contact
                found.append(
                    (
                        data.ncon,
                        i,
                        substep,
                        contact.geom.copy(),
                        contact.dist.copy(),
                        contact.pos.copy(),
                    )
                )
        if not found:
            return [NONE] * len(ids)
        counts, rows, substeps, geoms, distances, places = zip(*found, strict=True)
        every = np.concatenate(geoms)
        first, second = every.min(axis=1), every.max(axis=1)
        keep = np.flatnonzero(~self._soles[first, second])
        contacts = np.zeros(len(keep), dtype=CONTACT)
        contacts["step"], contacts["substep"] = (
            np.repeat(each, counts)[keep] for each in (rows, substeps)
        )
        contacts["geom1"], contacts["geom2"] = first[keep], second[keep]
        contacts["depth"] = -np.concatenate(distances)[keep]
        contacts["x"], contacts["y"], contacts["z"] = np.concatenate(places)[keep].T
        contacts = deepest(contacts)
        ends = np.searchsorted(contacts["step"], np.arange(1, len(ids)))
        contacts["step"] = 0
        return np.split(contacts, ends)

    def diverged(self, ids: Array) -> Array:
        """Simulations whose last call left no number, one beyond all bounds, or an error of
        MuJoCo's, (len(ids),) bool.
        """
        return np.asarray(self._failed[ids])

    def model_of(self, sim: int) -> mujoco.MjModel:
        """The model one simulation runs on, its own sphere sizes included."""
        return self._batch.get_model(sim)


NONE: Array = np.zeros(0, dtype=CONTACT)


def deepest(rows: Array) -> Array:
    """Of all contacts of a step, per geom pair the deepest (the first of equals), by step and geom
    ids; CONTACT rows in and out.
    """
    rows = rows[
        np.lexsort((rows["substep"], -rows["depth"], rows["geom2"], rows["geom1"], rows["step"]))
    ]
    another = np.ones(len(rows), dtype=bool)
    another[1:] = np.logical_or.reduce(
        [rows[name][1:] != rows[name][:-1] for name in ("step", "geom1", "geom2")]
    )
    return np.asarray(rows[another])
