"""What the physics is given besides servo targets, read off full state vectors: applied forces,
which equality constraints are active, and where mocap bodies are.
"""

from __future__ import annotations

import mujoco
import numpy as np

from coordlog.episode import Array
from coordlog.spec import INPUTS

_STATE = mujoco.mjtState.mjSTATE_INTEGRATION
_PARTS = {
    "qfrc_applied": mujoco.mjtState.mjSTATE_QFRC_APPLIED,
    "xfrc_applied": mujoco.mjtState.mjSTATE_XFRC_APPLIED,
    "eq_active": mujoco.mjtState.mjSTATE_EQ_ACTIVE,
    "mocap_pos": mujoco.mjtState.mjSTATE_MOCAP_POS,
    "mocap_quat": mujoco.mjtState.mjSTATE_MOCAP_QUAT,
}
"""In the order in which a state vector holds them, one after the other."""


def place(model: mujoco.MjModel, part: mujoco.mjtState) -> slice:
    """Where a part stands in a full integration state of this model."""
    bits = (1 << i for i in range(int(part).bit_length() - 1))
    start = sum(mujoco.mj_stateSize(model, bit) for bit in bits if bit & int(_STATE))
    return slice(start, start + mujoco.mj_stateSize(model, int(part)))


class Inputs:
    """Notices when the inputs of simulations change.

    Example:
        >>> inputs = Inputs(model, n=16)                        # doctest: +SKIP
        >>> inputs.begin(ids, physics.rows)                     # doctest: +SKIP
        >>> changed = inputs.changed(ids, physics.rows)         # doctest: +SKIP
    """

    def __init__(self, model: mujoco.MjModel, *, n: int) -> None:
        places = {name: place(model, part) for name, part in _PARTS.items()}
        first = min(at.start for at in places.values())
        self._all = slice(first, max(at.stop for at in places.values()))
        self._at = {name: slice(at.start - first, at.stop - first) for name, at in places.items()}
        self._held: Array = np.zeros((n, self._all.stop - self._all.start))

    def begin(self, ids: Array, rows: Array) -> None:
        """Episodes start with the inputs that stand in their states, (N, n_state)."""
        self._held[ids] = rows[ids, self._all]

    def changed(self, ids: Array, rows: Array) -> Array:
        """Which of the simulations have other inputs than before, (len(ids),) bool."""
        now = rows[ids, self._all]
        changed = np.asarray((now != self._held[ids]).any(axis=1))
        if changed.any():
            self._held[ids[changed]] = now[changed]
        return changed

    def message(self, sim: int, step: int) -> dict[str, Array]:
        """A row of `spec.INPUTS`: the inputs of a simulation from a step on."""
        none = np.zeros((1, 0))
        return self._columns(self._held[sim][None], np.array([step]), np.zeros(1, np.int32), none)

    def messages(self, steps: Array, substeps: Array, rows: Array) -> dict[str, Array]:
        """Rows of `spec.INPUTS`: what full states (n, n_state), set at some steps and substeps,
        give the physics.
        """
        return self._columns(rows[:, self._all], steps, substeps.astype(np.int32), rows)

    def _columns(
        self, held: Array, steps: Array, substeps: Array, states: Array
    ) -> dict[str, Array]:
        columns = {name: held[:, at].copy() for name, at in self._at.items()}
        columns["eq_active"] = columns["eq_active"].astype(bool)
        columns |= {"step": steps, "substep": substeps, "state": states}
        return {item.name: columns[item.name] for item in INPUTS.fields}
