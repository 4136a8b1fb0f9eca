"""Any MuJoCo simulation that somebody else steps: seen while it runs, followed, and run again.

While a simulation is watched, `mujoco.mj_step` and `mujoco.mj_step2` are wrapped: the full state is
read before each call that is made on it. A shadow of the simulation, on the model that is logged,
then takes each step again from what is going to be logged of it: where the shadow ends where the
simulation did, to the bit, the log replays; where the state was set from outside, the log says so;
and where neither explains a step, it is refused, there and then.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import wraps
from typing import Any, NamedTuple

import mujoco
import numpy as np

from coordlog.episode import Array
from coordlog.errors import FormatError, SimulationError
from coordlog.sim.inputs import place

TASK = "environment"
"""What the task of an episode is called that another program's environment has set."""
SUBSTEPS = "substeps"
"""Its field that says how many physics steps a step made."""
STATE = mujoco.mjtState.mjSTATE_INTEGRATION
_MOTION = ("TIME", "QPOS", "QVEL", "ACT")
_CARRIED = (*_MOTION, "HISTORY", "WARMSTART", "PLUGIN")
"""Parts of the state that a physics step brings about; all others are given to it."""
MOST = 0.5
"""A step is refused if more than this share of the coordinates is not what the physics makes."""

STEPPERS = ("mj_step", "mj_step2")
"""Functions of MuJoCo's that move a simulation on; whoever imported one by its own name before is
not seen, and followed by its states alone."""

_watched: dict[int, Watch] = {}
_own = {name: getattr(mujoco, name) for name in STEPPERS}


def _watching(stepper: Callable[..., None]) -> Callable[..., None]:
    @wraps(stepper)
    def step(m: mujoco.MjModel, d: mujoco.MjData, *args: Any, **options: Any) -> None:
        watch = _watched.get(getattr(d, "_address", 0))
        if watch is not None:
            watch.mark()
        stepper(m, d, *args, **options)

    return step


class Watch:
    """Keeps the full state of one simulation before every call that moves it on.

    Example:
        >>> watch = Watch(model, data)                          # doctest: +SKIP
        >>> mujoco.mj_step(model, data, 5)                      # doctest: +SKIP
        >>> len(watch.taken())                                  # doctest: +SKIP
        1
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        self._model, self._data, self._rows = model, data, list[Array]()
        if not _watched:
            for name, stepper in _own.items():
                setattr(mujoco, name, _watching(stepper))
        _watched[data._address] = self

    def mark(self) -> None:
        """Keep the state as it is now."""
        self._rows.append(state_of(self._model, self._data))

    def taken(self) -> list[Array]:
        """The states since the last call."""
        rows, self._rows = self._rows, []
        return rows

    def close(self) -> None:
        """Look no longer."""
        if _watched.pop(self._data._address, None) and not _watched:
            for name, stepper in _own.items():
                setattr(mujoco, name, stepper)


def state_of(model: mujoco.MjModel, data: mujoco.MjData) -> Array:
    """The full mjSTATE_INTEGRATION vector, (n_state,)."""
    row = np.empty(mujoco.mj_stateSize(model, STATE))
    mujoco.mj_getState(model, data, row, STATE)
    return row


class Parts:
    """Where the parts of a model's full state stand, as masks (n_state,)."""

    def __init__(self, model: mujoco.MjModel) -> None:
        self.carried = self._mask(model, _CARRIED)
        self.motion = self._mask(model, _MOTION)
        self.ctrl = place(model, mujoco.mjtState.mjSTATE_CTRL)
        self.qpos = place(model, mujoco.mjtState.mjSTATE_QPOS)

    @staticmethod
    def _mask(model: mujoco.MjModel, names: Iterable[str]) -> Array:
        mask = np.zeros(mujoco.mj_stateSize(model, STATE), dtype=bool)
        for name in names:
            part = getattr(mujoco.mjtState, f"mjSTATE_{name}", None)
            if part is not None:
                mask[place(model, part)] = True
        return mask


class Change(NamedTuple):
    """A state that holds from a substep on; the number of substeps for one that was set after."""

    substep: int
    row: Array  # (n_state,)


class Followed(NamedTuple):
    """What must be logged of a step besides its controls, so that it can be taken again."""

    substeps: int
    changes: list[Change]
    outside: bool = False
    """Whether the state was set from outside, and not only the inputs."""


class Shadow:
    """A second simulation that takes every step again from what is logged of it."""

    def __init__(self, model: mujoco.MjModel, start: Array) -> None:
        """Begin in a full state, (n_state,).

        Raises:
            FormatError: if the state is not one of this model.
        """
        size = mujoco.mj_stateSize(model, STATE)
        if start.shape != (size,):
            raise FormatError(
                f"initial state: expected {size} numbers for this model, got {start.size}"
            )
        self._model, self._data, self._parts = model, mujoco.MjData(model), Parts(model)
        self._set(start)
        mujoco.mj_forward(model, self._data)  # what a state does not hold, such as sensors
        self._set(start)

    @property
    def row(self) -> Array:
        """Its full state, (n_state,)."""
        return state_of(self._model, self._data)

    def _set(self, row: Array) -> None:
        mujoco.mj_setState(self._model, self._data, row, STATE)

    def take(self, ctrl: Array, substeps: int, changes: Mapping[int, Array]) -> Array:
        """One step from what is logged: controls (n_c,), and states from substeps on.

        Returns:
            The full state after it, (n_state,).
        """
        self._data.ctrl[:] = ctrl
        for substep in range(substeps):
            if substep in changes:
                self._set(changes[substep])
            _own["mj_step"](self._model, self._data)
        if substeps in changes:
            self._set(changes[substeps])
        return self.row

    def follow(self, seen: list[Array], end: Array) -> Followed:
        """Find out what explains a step, and take it.

        Args:
            seen: Full states before the calls that moved it on, as watched.
            end: Full state after it.

        Raises:
            SimulationError: if nothing explains it; the message says what differs.
        """
        now, motion = self.row, self._parts.motion
        if end[0] < now[0]:
            raise SimulationError(
                f"time went back from {now[0]:g} s to {end[0]:g} s within an episode: expected an "
                "environment that is reset "
                "by reset() alone"
            )
        if end[0] == now[0]:
            raise SimulationError("no physics step was made: expected time to go on")
        at = [row for row in seen if row[0] == now[0]]
        start = now
        if at and (at[-1][self._parts.carried] != now[self._parts.carried]).any():
            start = at[-1]
        best: tuple[float, Followed] = (0.0, Followed(0, []))
        for given in (self._constant(end), self._each(seen)):
            found = self._try(start, given, end, moved=start is not now)
            reached = self.row
            if (reached[motion] == end[motion]).all():
                return found
            share = float((reached[motion] == end[motion]).mean())
            best = max(best, (share, found), key=lambda item: item[0])
        return self._set_after(now, end, best)

    def _try(
        self, start: Array, given: Callable[[Array], Array], end: Array, *, moved: bool
    ) -> Followed:
        """Take the step with inputs from `given`, a full state for the present one."""
        self._set(start)
        self._data.ctrl[:] = end[self._parts.ctrl]
        changes, substeps = [], 0
        half = 0.5 * self._model.opt.timestep
        while self._data.time < end[0] - half:
            own = self.row
            wanted = np.where(self._parts.carried, own, given(own))
            if (wanted != own).any() or (moved and not substeps):
                self._set(wanted)
                changes.append(Change(substeps, wanted))
            _own["mj_step"](self._model, self._data)
            substeps += 1
        return Followed(substeps, changes, outside=moved)

    def _set_after(self, now: Array, end: Array, best: tuple[float, Followed]) -> Followed:
        """A step after which the environment set part of the state itself."""
        share, found = best
        if share < MOST:
            where = self._parts.motion & (self.row != end)
            first = int(np.flatnonzero(where)[0])
            raise SimulationError(
                f"{1 - share:.0%} of the state after it is not what the physics makes of the state "
                f"before it (entry {first}: "
                f"{self.row[first]:.9g} simulated again, {end[first]:.9g} there): something else "
                "moves this simulation, or its model "
                "is not as it was when the recording began"
            )
        changes = [change for change in found.changes if change.substep < found.substeps]
        self._set(end)
        last = Change(found.substeps, end)
        return Followed(found.substeps, [*changes, last], outside=True)

    @staticmethod
    def _constant(end: Array) -> Callable[[Array], Array]:
        """What stands there after the step was there during all of it."""
        return lambda own: end

    @staticmethod
    def _each(seen: list[Array]) -> Callable[[Array], Array]:
        """What was seen before each call, until the next."""
        rows = {float(row[0]): row for row in seen}
        return lambda own: rows.get(float(own[0]), own)


def changes_by_step(inputs: Mapping[str, Array]) -> dict[int, dict[int, Array]]:
    """The states of an episode's inputs by step and substep."""
    found: dict[int, dict[int, Array]] = {}
    for step, substep, row in _rows(inputs):
        found.setdefault(step, {})[substep] = row
    return found


def _rows(inputs: Mapping[str, Array]) -> Iterator[tuple[int, int, Array]]:
    if inputs:
        yield from zip(
            inputs["step"].tolist(), inputs["substep"].tolist(), inputs["state"], strict=True
        )


def retrace(
    model: mujoco.MjModel,
    start: Array,
    ctrl: Array,
    substeps: Array,
    inputs: Mapping[str, Array],
) -> dict[str, Array]:
    """Take the steps of an episode again: `time` (T + 1,), `qpos` (T + 1, n_q), `qvel`
    (T + 1, n_v).

    Args:
        model: The log's.
        start: Its first full state, (n_state,).
        ctrl: Controls of each step, (T, n_c).
        substeps: Physics steps of each, (T,).
        inputs: Columns of `spec.INPUTS`.

    Raises:
        FormatError: if the first state is not one of the model.
    """
    shadow, changes = Shadow(model, start), changes_by_step(inputs)
    rows = [shadow.row]
    for step, (control, count) in enumerate(zip(ctrl, substeps.tolist(), strict=True)):
        rows.append(shadow.take(control, count, changes.get(step, {})))
    states = np.stack(rows)
    qvel = place(model, mujoco.mjtState.mjSTATE_QVEL)
    return {
        "time": states[:, 0] - start[0],
        "qpos": states[:, place(model, mujoco.mjtState.mjSTATE_QPOS)],
        "qvel": states[:, qvel],
    }
