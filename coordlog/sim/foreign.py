"""Any MuJoCo simulation that somebody else steps: seen while it runs, followed, and run again.

A simulation is watched (sim/watch.py): its full state is known before each call that moved it on,
and after every step. A shadow of the simulation, on the model that is logged, then takes the steps
again, a run of them at a time, from what is going to be logged of them: where the shadow ends where
the simulation did, to the bit, the log replays; where the state was set from outside, the log says
so; and where neither explains a step, that step is refused.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import mujoco
import numpy as np

from coordlog.episode import Array, Json
from coordlog.errors import FormatError, SimulationError, SpecError
from coordlog.sim.inputs import place
from coordlog.sim.watch import STATE, STEP, state_of

TASK = "environment"
"""What the task of an episode is called that another program's environment has set."""
SUBSTEPS = "substeps"
"""Its field that says how many physics steps a step made."""
_MOTION = ("TIME", "QPOS", "QVEL", "ACT")
"""Compared to the bit; a full state begins with them."""
_CARRIED = (*_MOTION, "HISTORY", "WARMSTART", "PLUGIN", "PLASTIC")
"""Parts of the state that a physics step brings about; all others are given to it."""
AHEAD = 256
"""Most steps of a run; a simulation that its environment sets itself is followed step by step."""
MOST = 0.5
"""A step is refused if more than this share of the coordinates is not what the physics makes."""


def of_environment(env: Json) -> bool:
    """Whether a `coordlog.env` record is of an environment that is not ours."""
    return bool(env.get("task", {}).get("name") == TASK)


def flat(value: Any) -> Array:
    """An observation, action or reward as one row of numbers; parts of a mapping in the order of
    their names.

    Raises:
        SpecError: if there is anything but numbers in it.
    """
    if isinstance(value, Mapping):
        return np.concatenate([flat(value[key]) for key in sorted(value)])
    if isinstance(value, tuple):
        return np.concatenate([flat(each) for each in value])
    array = np.asarray(value)
    if array.dtype.kind not in "fiub":
        raise SpecError(
            f"expected numbers in observation, action and reward, got {type(value).__name__}"
        )
    return np.atleast_1d(array).ravel()


class Parts:
    """Where the parts of a model's full state, (n_state,), stand."""

    def __init__(self, model: mujoco.MjModel) -> None:
        at = {
            name: place(model, getattr(mujoco.mjtState, f"mjSTATE_{name}"))
            for name in (*_CARRIED, "CTRL")
            if hasattr(mujoco.mjtState, f"mjSTATE_{name}")
        }
        self.qpos, self.qvel, self.ctrl = at["QPOS"], at["QVEL"], at["CTRL"]
        self.motion = slice(0, at["ACT"].stop)
        self.carried = np.zeros(mujoco.mj_stateSize(model, STATE), dtype=bool)
        for name in at.keys() & set(_CARRIED):
            self.carried[at[name]] = True
        given = ~self.carried
        given[self.ctrl] = False
        self.given = np.flatnonzero(given)
        """What the physics is given besides controls."""

    def held(self, before: Array, states: Array) -> dict[int, Array]:
        """The steps for which something else was given than in the one before, if what stands there
        after a step was there during all of it: the state that holds from their start on.

        Args:
            before: Full state before the first, with what was given until then, (n_state,).
            states: Full states, (n + 1, n_state).
        """
        given = states[:, self.given]
        given[0] = before[self.given]
        (found,) = (given[1:] != given[:-1]).any(axis=1).nonzero()
        rows = np.where(self.carried, states[found], states[found + 1])
        if len(found) and not found[0]:
            rows[0] = np.where(self.carried, before, states[1])
        return dict(zip(found.tolist(), rows, strict=True))


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


class Steps(NamedTuple):
    """What must be logged of some steps, up to the first that nothing explains."""

    substeps: list[int]
    changes: list[tuple[int, Change]]
    """By step."""
    outside: int = 0
    """Steps in which the state was set from outside."""
    error: SimulationError | None = None
    """Why the step after these cannot be taken again."""


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
        self._model, self._data, self.parts = model, mujoco.MjData(model), Parts(model)
        self._ahead = 1
        self.begin(start)

    def begin(self, start: Array) -> None:
        """Begin anew, in another full state, (n_state,)."""
        mujoco.mj_resetData(self._model, self._data)
        self._set(start)
        mujoco.mj_forward(self._model, self._data)  # what a state does not hold, such as sensors
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
        stops = sorted({0, substeps, *(at for at in changes if 0 <= at <= substeps)})
        for at, until in zip(stops, [*stops[1:], substeps], strict=True):
            if at in changes:
                self._set(changes[at])
            if until > at:
                STEP(self._model, self._data, until - at)
        return self.row

    def follow(self, states: Array, seen: Sequence[list[Array]]) -> Steps:
        """Find out what explains some steps, and take them.

        Args:
            states: Full states before and after them, (n + 1, n_state).
            seen: For each step full states before the calls that moved it on, as watched.
        """
        found = Steps([], [])
        at, n = 0, len(seen)
        while at < n:
            tried = min(self._ahead, n - at)
            done = self._run(states[at : at + tried + 1], at, found)
            at += done
            if done and done == tried:
                self._ahead = min(max(self._ahead, 2 * done), AHEAD)
                continue
            self._ahead = done
            try:
                step = self._step(seen[at], states[at + 1])
            except SimulationError as error:
                return found._replace(error=error)
            found.substeps.append(step.substeps)
            found.changes.extend((at, change) for change in step.changes)
            found = found._replace(outside=found.outside + step.outside)
            plain = not step.outside and all(change.substep == 0 for change in step.changes)
            self._ahead = max(self._ahead, int(plain))
            at += 1
        return found

    def _run(self, states: Array, at: int, found: Steps) -> int:
        """Take steps during all of which the physics was given what stands there after them; how
        many there are before one that this does not explain. None is tried of a simulation whose
        last step was another.
        """
        n, data, parts = len(states) - 1, self._data, self.parts
        if not n:
            return 0
        before, reached = self.row, np.empty((n, states.shape[1]))
        changes = parts.held(before, states)
        counts = np.rint(np.diff(states[:, 0]) / self._model.opt.timestep).astype(int).tolist()
        controls, ctrl = states[1:, parts.ctrl], data.ctrl
        for k, (count, row) in enumerate(zip(counts, reached, strict=True)):
            if k in changes:
                self._set(changes[k])
            ctrl[:] = controls[k]
            STEP(self._model, data, count)
            mujoco.mj_getState(self._model, data, row, STATE)
        motion = parts.motion
        (other,) = (reached[:, motion] != states[1:, motion]).any(axis=1).nonzero()
        done = int(other[0]) if len(other) else n
        if done < n:
            self._set(reached[done - 1] if done else before)
        found.substeps.extend(counts[:done])
        found.changes.extend((at + k, Change(0, row)) for k, row in changes.items() if k < done)
        return done

    def _step(self, seen: list[Array], end: Array) -> Followed:
        """Find out what explains a step, and take it.

        Args:
            seen: Full states before the calls that moved it on, as watched.
            end: Full state after it.

        Raises:
            SimulationError: if nothing explains it; the message says what differs.
        """
        now, motion, given = self.row, self.parts.motion, ~self.parts.carried
        at = [row for row in seen if row[0] == now[0]]
        start = now
        if at and (at[-1][self.parts.carried] != now[self.parts.carried]).any():
            start = at[-1]
        best: tuple[float, Followed] = (0.0, Followed(0, []))
        # what stands there after it was there during all of it; or what was seen before each call
        ways: list[Callable[[Array], Array]] = [lambda own: end]
        if any((row[given] != end[given]).any() for row in seen):
            by_time = {float(row[0]): row for row in seen}
            ways.append(lambda own: by_time.get(float(own[0]), own))
        for way in ways:
            found = self._try(start, way, end, moved=start is not now)
            reached = self.row
            if (reached[motion] == end[motion]).all():
                return found
            share = float((reached[motion] == end[motion]).mean())
            best = max(best, (share, found), key=lambda item: item[0])
        return self._set_after(end, best)

    def _try(
        self, start: Array, given: Callable[[Array], Array], end: Array, *, moved: bool
    ) -> Followed:
        """Take the step with inputs from `given`, a full state for the present one."""
        self._set(start)
        self._data.ctrl[:] = end[self.parts.ctrl]
        changes, substeps = [], 0
        half = 0.5 * self._model.opt.timestep
        while self._data.time < end[0] - half:
            own = self.row
            wanted = np.where(self.parts.carried, own, given(own))
            if (wanted != own).any() or (moved and not substeps):
                self._set(wanted)
                changes.append(Change(substeps, wanted))
            STEP(self._model, self._data)
            substeps += 1
        return Followed(substeps, changes, outside=moved)

    def _set_after(self, end: Array, best: tuple[float, Followed]) -> Followed:
        """A step after which the environment set part of the state itself."""
        share, found = best
        if share < MOST:
            first = int(np.flatnonzero((self.row != end)[self.parts.motion])[0])
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


def changes_by_step(inputs: Mapping[str, Array]) -> dict[int, dict[int, Array]]:
    """The states of an episode's inputs by step and substep."""
    found: dict[int, dict[int, Array]] = {}
    columns = (inputs[name] for name in ("step", "substep", "state")) if inputs else ((), (), ())
    for step, substep, row in zip(*columns, strict=True):
        found.setdefault(int(step), {})[int(substep)] = row
    return found


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
    return {
        "time": states[:, 0] - start[0],
        "qpos": states[:, shadow.parts.qpos],
        "qvel": states[:, shadow.parts.qvel],
    }
