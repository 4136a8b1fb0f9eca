"""N simulations stepped together, with every contact seen at every physics substep.

A contact counts by what it joins: anything but a sole on the floor, or two things that lie against
one another by design, is a collision if it has no gap, whatever made MuJoCo look at it. A control
step is one call that records counters at every substep. Where the model lets the number of contact
rows tell sole contacts from all others (`Counting`), nothing more is needed to know that nothing
else touches; the contacts themselves are computed again, from the recorded positions, to the same
bits, only where something does or may.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from typing import NamedTuple

import mujoco
import numpy as np

from coordlog.episode import CONTACT, Array
from coordlog.mjcf import silence
from coordlog.tasks.scene import sole_corner

STATE = mujoco.mjtState.mjSTATE_INTEGRATION
CURRENT = mujoco.mjtStage.mjSTAGE_VEL
DIVERGED = 1e10
"""MuJoCo's mjMAXVAL: coordinates beyond it are no physics any more."""
SOLE_DIMENSIONS = 4
"""Dimensions of a sole's contact with the floor (mjcf/compose.py): it resists twisting."""
ROWS = {
    mujoco.mjtCone.mjCONE_PYRAMIDAL: {1: 1, 3: 4, 4: 6, 6: 10},
    mujoco.mjtCone.mjCONE_ELLIPTIC: {1: 1, 3: 3, 4: 4, 6: 6},
}
"""Constraint rows of a contact by its number of dimensions."""
COUNTERS = ("ncon", "nefc", "ne", "nf", "nl")
"""Contacts, constraint rows, and the rows of equalities, dry friction and joint limits among
them."""


class Counting(NamedTuple):
    """How many contacts are others than sole on floor, by counting rows of constraints.

    A sole's contact with the floor has four dimensions; where all others have one number of
    dimensions that is not four, the rows of all together tell how many they are. With no soles they
    are all of them.
    """

    exact: bool
    """Whether the count is right; else it is too high, and 0 is all it can prove."""
    sole: int
    """Rows of a sole's contact; 0 where there are no soles, or nothing can be told apart."""
    other: int
    """Rows of any other."""

    @classmethod
    def of(cls, model: mujoco.MjModel, *, resting: bool) -> Counting:
        """What a model lets be counted."""
        soles = sole_pairs(model)
        own = ~soles[model.pair_geom1, model.pair_geom2]
        solid = (model.geom_contype | model.geom_conaffinity) > 0
        dims = set(model.geom_condim[solid].tolist()) | set(model.pair_dim[own].tolist())
        slack = np.concatenate(
            [model.geom_margin, model.geom_gap, model.pair_margin, model.pair_gap]
        ).any()
        exact = not (resting or slack or model.nflex)
        if not soles.any() or model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_CONSTRAINT:
            return cls(exact and not soles.any(), 0, 0)
        if len(dims) > 1 or SOLE_DIMENSIONS in dims or not (model.pair_dim[~own] == 4).all():
            return cls(False, 0, 0)
        rows = ROWS[mujoco.mjtCone(model.opt.cone)]
        if slack or model.nflex:  # rows and contacts are not counted of the same things
            return cls(False, 0, 0)
        return cls(exact, rows[SOLE_DIMENSIONS], rows[dims.pop() if dims else 3])

    def foreign(
        self, contacts: Array, rows: Array, equality: Array, friction: Array, limits: Array
    ) -> Array:
        """Contacts that are no sole on the floor, from the counters."""
        if not self.sole:
            return np.asarray(contacts)
        rows = rows - equality - friction - limits
        return np.asarray((self.sole * contacts - rows) // (self.sole - self.other))


def sole_pairs(model: mujoco.MjModel) -> Array:
    """Which pairs of geoms are a sole and the floor, (n_geom, n_geom) bool, symmetric."""
    found = np.zeros((model.ngeom, model.ngeom), dtype=bool)
    floor = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_GEOM, "floor")
    for pair in zip(model.pair_geom1.tolist(), model.pair_geom2.tolist(), strict=True):
        sole = pair[0] if pair[1] == floor else pair[1]
        corner = sole_corner(model.geom(sole).name, 0)
        if floor in pair and mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, corner) >= 0:
            found[pair] = found[pair[::-1]] = True
    return found


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
        resting: Sequence[tuple[int, int]] = (),
    ) -> None:
        """Make the batch and bind what every step reads.

        Args:
            model: What every simulation runs on.
            n: Number of simulations.
            threads: Threads to step on; 0 for all cores.
            models: Models of the same layout, one per simulation, that differ in constants (a log's
                own); None for `model`.
            resting: Pairs of geoms whose contacts are none, because they lie against one another.
        """
        # Loaded late: with it MuJoCo forgets the model that it compiled last, and with that the
        # text
        # of an environment that is about to be recorded.
        from mujoco.batch import Batch, SimulationError

        silence()
        self._refused = SimulationError
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
        # Not bound: what a batch binds besides the state is of the thread that looked last.
        self.torque: Array = np.zeros((n, model.nu))  # N·m, during the last physics step
        self._time = self._batch.bind("time")
        self._counts = tuple(self._batch.bind(name) for name in COUNTERS)
        self._counting = Counting.of(model, resting=bool(resting))
        self._let_be = sole_pairs(model)  # (n_geom, n_geom) bool: contacts that are none
        for one, other in resting:
            self._let_be[one, other] = self._let_be[other, one] = True
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
        """Contacts that count in the present state, a number per simulation, (len(ids),)."""
        found = self._counting.foreign(*(count[ids] for count in self._counts))
        if self._counting.exact:
            return found
        qpos, suspect = self.qpos[ids][:, None], (found > 0)[:, None]
        return np.array([len(rows) for rows in self._touched(ids, qpos, suspect)], dtype=np.int64)

    def advance(
        self, ids: Array, before: Array, after: Array, *, substeps: int
    ) -> tuple[Array, list[Array]]:
        """One control step: servo targets move linearly from `before` to `after`, (len(ids),
        n_servos) each.

        Returns:
            collision: (len(ids),) bool, any contact that counts at any substep.
            contacts: per simulation CONTACT rows (step 0), the deepest of each geom pair over the
                substeps.
        """
        records = self._run(ids, before, after, substeps)
        # A record made after a substep counts the contacts of the state before it: the first is
        # last step's, the last is missing.
        touching = np.empty((len(ids), substeps), dtype=np.int64)
        foreign = self._counting.foreign
        touching[:, :-1] = foreign(*(records[name][:, 1:] for name in COUNTERS))
        touching[:, -1] = foreign(*(count[ids] for count in self._counts))
        touching[self.diverged(ids)] = 0
        contacts = self._touched(ids, records["qpos"], touching > 0)
        return np.array([len(rows) > 0 for rows in contacts]), contacts

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
        except (
            self._refused
        ) as error:  # those simulations kept their state; the others were stepped
            self._failed[error.ids] = True
        self._failed[ids] |= ~(self._time[ids] > end)  # MuJoCo gave up under way
        self.torque[ids] = records["actuator_force"][:, -1]
        self._look(ids)
        return records

    def _look(self, ids: Array) -> None:
        try:
            self._batch.forward(ids, stage=CURRENT)
        except self._refused as error:
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
            "actuator_force": np.zeros((n, substeps, model.nu)),
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
        distance = np.concatenate(distances)
        keep = np.flatnonzero(~self._let_be[first, second] & (first >= 0) & (distance <= 0.0))
        contacts = np.zeros(len(keep), dtype=CONTACT)
        contacts["step"], contacts["substep"] = (
            np.repeat(each, counts)[keep] for each in (rows, substeps)
        )
        contacts["geom1"], contacts["geom2"] = first[keep], second[keep]
        contacts["depth"] = -distance[keep]
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
