"""One episode of a simulation that somebody else steps, as it becomes a file.

    log = EpisodeLog(subject, data, path, about=…)
    mujoco.mj_step(subject.model, data)             the owner's step, whatever it is
    log.step(action, reward)                        logged, and soon taken again

A step costs its owner little: its values are written in place, and some steps later all of them are
taken again together, from what is going to be logged (sim/foreign.py). The first step that cannot
be is refused: what came before it is the file. States that the owner set are noticed and logged as
such.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from coordlog.episode import INITIAL_STATE, Array, Json
from coordlog.errors import CoordlogError, SimulationError, SpecError
from coordlog.record.beside import keep
from coordlog.record.foreign_env import Subject
from coordlog.record.foreign_values import Rows, header_of, odd
from coordlog.record.writer import BLOCK, EpisodeWriter
from coordlog.sim.foreign import SUBSTEPS, Change, Steps
from coordlog.sim.watch import STATE, Watch, state_of

MOST_STEPS, MOST_BYTES = 512, 1 << 23
"""Room for the steps of a chunk: fewer where a step is large."""
SECONDS = 1.0
"""A chunk is written no later than this after the one before, if it has `BLOCK` steps: so much may
a crash cost."""
OFTEN = 0.1
"""Steps are taken again in runs that grow while they last less than this [s]."""


class EpisodeLog:
    """One episode of a simulation that its owner steps.

    `step` is called after every step, with what the owner did and got. Leaving the context without
    an ending closes the episode as aborted, with all its steps.
    """

    def __init__(
        self,
        subject: Subject,
        data: mujoco.MjData,
        path: Path,
        *,
        about: Json,
        observation: Any = None,
        verify: bool = True,
    ) -> None:
        """Begin in the present state.

        Args:
            subject: What is simulated.
            data: Its state.
            path: Name of the file, once it is finished.
            about: What is known of the episode: "episode" and "policy" records, in part, the names
                of "heads", the "task" record, and least and greatest "actions".
            observation: What the policy sees first; without one the state is qpos and qvel.
            verify: Take the steps again while recording.
        """
        self._subject, self._model, self._data = subject, subject.model, data
        self._path, self._about = path, about
        self._start = state_of(self._model, data)
        self._shadow = subject.shadow(self._start) if verify else None
        self._parts = subject.parts
        width = self._start.size + np.size(observation)
        room = min(max(MOST_BYTES // (8 * width), BLOCK), MOST_STEPS)
        self._states = np.empty((room + 1, self._start.size))
        self._states[0] = self._start
        self._force = data.actuator_force
        self._torque = np.empty((room, self._model.nu))
        self._rows = Rows(room, observation)
        self._watch = Watch(self._model, data) if verify else None
        self._seen: list[list[Array]] = []
        self._run, self._paused = BLOCK // 2, time.monotonic()
        self._next = 1  # what cannot be taken again mostly shows at once
        self._count = 0
        self._begin_block()
        self._writer: EpisodeWriter | None = None
        self._closed = False
        self.length = 0
        """Steps so far."""
        self.set_from_outside = 0
        """Steps in which the state was set from outside, of those that were taken again."""

    def step(
        self,
        action: Any,
        reward: Any = 0.0,
        *,
        observation: Any = None,
        terminated: bool = False,
        truncated: bool = False,
        info: Mapping[str, Any] | None = None,
    ) -> None:
        """Log the step that was just made.

        Args:
            action: What the policy asked for.
            reward: One number, or one for each head.
            observation: What the policy sees now.
            terminated: The task ended here.
            truncated: The episode was cut off here.
            info: Its numbers are logged, under the names they have at the first step.

        Raises:
            SimulationError: if this step, or one before it of the same run, cannot be taken again
                from what is logged; what came before that one stays in the file, which is closed as
                aborted.
            SpecError: for a NaN, or another number of values than before; likewise.
        """
        if self._closed:
            raise SimulationError("step: the episode has ended; begin another")
        at = self._count
        state = self._states[at + 1]
        mujoco.mj_getState(self._model, self._data, state, STATE)
        try:
            if not state[0] > self._states[at, 0]:
                raise _no_step(self._states[at, 0], state[0])
            self._rows.put(at, action, reward, observation, info or {})
        except CoordlogError as error:
            self._examine()
            raise self._refused(error) from None
        self._torque[at] = self._force
        if self._watch is not None:
            self._seen.append(self._watch.taken())
        self._count = at + 1
        self.length += 1
        if terminated or truncated:
            self._ending = bool(terminated), not terminated
            self.close(aborted="")
        elif self._count == self._next:
            self._pause()

    def close(self, aborted: str = "interrupted") -> None:
        """Finish the file; an episode without steps leaves none.

        Raises:
            SimulationError: if one of the last steps cannot be taken again, as `step`.
            SpecError: as `step`.
        """
        if self._closed:
            return
        self._examine()
        self._finish(aborted)

    def __enter__(self) -> EpisodeLog:
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        stopped = error is None or isinstance(error, KeyboardInterrupt)
        try:
            self.close("interrupted" if stopped else f"failed: {type(error).__name__}")
        except CoordlogError:
            if error is None:
                raise

    def _pause(self) -> None:
        """Take the steps again that are there, and write them when it is time."""
        self._examine()
        room = len(self._torque)
        now = time.monotonic()
        if self._count == room or (self._count >= BLOCK and now > self._due):
            self._flush()
        self._run = min(2 * self._run, room) if now - self._paused < OFTEN else BLOCK
        self._paused, self._next = now, min(self._count + self._run, room)

    def _begin_block(self) -> None:
        self._count = self._examined = 0
        self._substeps: list[int] = []
        self._changes: list[tuple[int, Change]] = []
        self._ending = False, False
        self._due = time.monotonic() + SECONDS

    def _examine(self) -> None:
        """Take the steps again that have not been.

        Raises:
            SimulationError: at the first that cannot be; the file ends before it.
            SpecError: at the first with a NaN; the file ends before it.
        """
        first, stop = self._examined, self._count
        if first == stop:
            return
        seen, self._seen = self._seen, []
        wrong = None
        taken = self._states[first + 1 : stop + 1], self._torque[first:stop]
        if not (all(np.isfinite(each).all() for each in taken) and self._rows.sound(first, stop)):
            wrong = odd(self._columns(first, stop) | self._present(first + 1, stop + 1))
        good = stop if wrong is None else first + wrong[0]
        found = self._follow(self._states[first : good + 1], seen[: good - first])
        self._examined = first + len(found.substeps)
        self._substeps += found.substeps
        self._changes += [(first + step, change) for step, change in found.changes]
        self.set_from_outside += found.outside
        error = found.error or (None if wrong is None else wrong[1])
        if error is not None:
            self.length -= stop - self._examined
            self._count = self._examined
            self._ending = False, False
            raise self._refused(error) from None

    def _refused(self, error: CoordlogError) -> CoordlogError:
        """Close the file before the step that cannot be logged; what is to be said of it."""
        at, said = self.length, str(error)
        if isinstance(error, SpecError):
            self._finish(aborted=f"step {at}: {said}")
            return SpecError(f"step {at}: {said}")
        self._finish(aborted=f"not replayable at step {at}: {said}")
        return SimulationError(f"step {at} cannot be replayed: {said}")

    def _follow(self, states: Array, seen: list[list[Array]]) -> Steps:
        if self._shadow is not None:
            return self._shadow.follow(states, seen)
        counts = np.rint(np.diff(states[:, 0]) / self._model.opt.timestep).astype(int).tolist()
        rows = self._parts.held(states[0], states)
        return Steps(counts, [(step, Change(0, row)) for step, row in rows.items()])

    def _present(self, first: int, stop: int) -> dict[str, Array]:
        """The fields that hold before each of some steps."""
        states, parts = self._states[first:stop], self._parts
        qpos, qvel = states[:, parts.qpos], states[:, parts.qvel]
        found = {"time": states[:, 0] - self._start[0], "qpos": qpos, "qvel": qvel}
        found |= self._rows.seen(first, stop)
        if "state" not in found:
            found["state"] = np.concatenate([qpos, qvel], axis=1).astype(np.float32)
        return found

    def _columns(self, first: int, stop: int) -> dict[str, Array]:
        """The other fields of some steps."""
        ctrl = self._states[first + 1 : stop + 1, self._parts.ctrl]
        taken = {"ctrl": ctrl, "torque": self._torque[first:stop]}
        return self._rows.columns(first, stop) | taken

    def _flush(self) -> None:
        """Write what has been taken again, opening the file with the first of it."""
        n = self._count
        columns = self._present(0, n) | self._columns(0, n)
        columns[SUBSTEPS] = np.array(self._substeps, dtype=np.int32)
        for name, ending in zip(("terminated", "truncated"), self._ending, strict=True):
            columns[name] = np.zeros(n, dtype=bool)
            columns[name][-1] = ending
        if self._writer is None:
            header = header_of(self._subject, columns, self._about)
            self._path.parent.mkdir(parents=True, exist_ok=True)
            looks = self._subject.looks
            keep(self._path.parent, looks.meshes)
            state = {INITIAL_STATE: self._start.tobytes()}
            self._writer = EpisodeWriter(
                self._path,
                header,
                attachments={**self._subject.attached, **looks.attached, **state},
                display=True,
                shown=self._subject.shown(self._start),
            )
        first = self._writer.length
        self._writer.write_steps(first, columns, inputs=self._messages(first))
        self._states[0] = self._states[n]
        self._rows.again(n)
        self._begin_block()

    def _finish(self, aborted: str) -> None:
        self._closed = True
        if self._watch is not None:
            self._watch.close()
        if self._count:
            self._flush()
        writer, self._writer = self._writer, None
        if writer is not None:
            final = {name: values[0] for name, values in self._present(0, 1).items()}
            writer.finish(final, aborted=aborted)

    def _messages(self, first: int) -> dict[str, Array] | None:
        if not self._changes:
            return None
        steps, changes = zip(*self._changes, strict=True)
        substeps, rows = zip(*changes, strict=True)
        return self._subject.inputs.messages(
            first + np.array(steps), np.array(substeps), np.stack(rows)
        )


def _no_step(before: float, after: float) -> SimulationError:
    if after < before:
        return SimulationError(
            f"time went back from {before:g} s to {after:g} s within an episode: expected an "
            "environment that is reset by reset() alone"
        )
    return SimulationError("no physics step was made: expected time to go on")
