"""One episode of a simulation that its owner steps: each step followed, and logged as it was."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any

import mujoco
import numpy as np

from coordlog.episode import INITIAL_STATE, Array, Json
from coordlog.errors import SimulationError, SpecError
from coordlog.mjcf import load_attached
from coordlog.record.foreign_values import count, flat, header_of, numbers
from coordlog.record.writer import BLOCK, EpisodeWriter
from coordlog.sim.foreign import SUBSTEPS, Followed, Shadow, Watch, state_of
from coordlog.sim.inputs import Inputs
from coordlog.spec import INPUTS


class EpisodeLog:
    """One episode of a simulation that its owner steps.

    `step` is called after every step, with what the owner did and got. Leaving the context without
    an ending closes the episode as aborted, with all its steps.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        path: Path,
        *,
        attached: Mapping[str, bytes],
        about: Json,
        observation: Any = None,
        verify: bool = True,
    ) -> None:
        """Begin in the present state.

        Args:
            model: What is simulated.
            data: Its state.
            path: Name of the file, once it is finished.
            attached: The model as attachments (`attachments_of`).
            about: What is known of the episode: "episode" and "policy" records, in part, the names
                of "heads", and the "task" record.
            observation: What the policy sees first; without one the state is qpos and qvel.
            verify: Take each step again while recording.
        """
        self._model, self._data, self._path, self._about = model, data, path, about
        self._attached = {**attached, INITIAL_STATE: state_of(model, data).tobytes()}
        self._watch = Watch(model, data) if verify else None
        logged = load_attached(attached) if verify else model
        self._shadow = Shadow(logged, state_of(model, data)) if verify else None
        self._inputs = Inputs(model, n=1)
        self._start, self._before = float(data.time), state_of(model, data)
        self._writer: EpisodeWriter | None = None
        self._rows: list[dict[str, Array]] = []
        self._changes: list[tuple[int, int, Array]] = []
        self._seen = self._present(observation)
        self._like: dict[str, tuple[Any, tuple[int, ...]]] | None = None
        self._closed = False
        self.length = 0
        """Steps so far."""
        self.set_from_outside = 0
        """Steps in which the state was set from outside."""

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
            SimulationError: if the step cannot be taken again from what is logged; what came before
                stays in the file, which is closed as aborted.
            SpecError: for a NaN, or another number of values than before.
        """
        if self._closed:
            raise SimulationError("step: the episode has ended; begin another")
        try:
            followed = self._follow(state_of(self._model, self._data))
        except SimulationError as error:
            self.close(aborted=f"not replayable at step {self.length}: {error}")
            raise SimulationError(f"step {self.length} cannot be replayed: {error}") from None
        try:
            row, seen = self._row(action, reward, observation=observation, info=info or {})
        except SpecError as error:
            self.close(aborted=f"step {self.length}: {error}")
            raise SpecError(f"step {self.length}: {error}") from None
        row["terminated"] = np.array(bool(terminated))
        row["truncated"] = np.array(bool(truncated) and not terminated)
        row[SUBSTEPS] = np.array(followed.substeps, dtype=np.int32)
        for change in followed.changes:
            self._changes.append((self.length, change.substep, change.row))
        self.set_from_outside += followed.outside
        self._rows.append(row)
        self._seen = seen
        self.length += 1
        if len(self._rows) == BLOCK or terminated or truncated:
            self._flush()
        if terminated or truncated:
            self.close(aborted="")

    def _row(
        self, action: Any, reward: Any, *, observation: Any, info: Mapping[str, Any]
    ) -> tuple[dict[str, Array], dict[str, Array]]:
        """The values of a step, and those that hold after it.

        Raises:
            SpecError: for a NaN, or for values of another kind or number than before.
        """
        seen = self._present(observation)
        row = dict(self._seen)
        row["action"] = flat(action).astype(np.float32)
        row["reward"] = flat(reward).astype(np.float64)
        row["ctrl"], row["torque"] = self._data.ctrl.copy(), self._data.actuator_force.copy()
        said = {f"info_{key}": value for key, value in numbers(info).items()}
        if self._like is None:
            self._like = {name: (v.dtype, v.shape) for name, v in (row | said).items()}
        wanted = [name for name in self._like if name.startswith("info_")]
        if missing := [name for name in wanted if name not in said]:
            raise SpecError(
                f"info: expected the numbers of the first step, {missing[0].removeprefix('info_')} "
                "is missing"
            )
        row |= {name: said[name].astype(self._like[name][0]) for name in wanted}
        for values in (row, seen):
            for name, value in values.items():
                if value.shape != self._like.get(name, (None, None))[1]:
                    raise SpecError(
                        f"{name}: expected {count(self._like.get(name))} as before, got "
                        f"{value.size}"
                    )
                if value.dtype.kind == "f" and not np.isfinite(value).all():
                    raise SpecError(f"{name}: expected numbers, got NaN or infinity")
        for name in wanted:
            if (row[name] != said[name]).any():
                raise SpecError(
                    f"{name}: expected {self._like[name][0]} as in the first step, got {said[name]}"
                )
        return row, seen

    def close(self, aborted: str = "interrupted") -> None:
        """Finish the file; an episode without steps leaves none."""
        self._closed = True
        if self._watch is not None:
            self._watch.close()
        if self._rows:
            self._flush()
        writer, self._writer = self._writer, None
        if writer is not None:
            writer.finish(self._seen, aborted=aborted)

    def __enter__(self) -> EpisodeLog:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        stopped = error is None or isinstance(error, KeyboardInterrupt)
        self.close("interrupted" if stopped else f"failed: {type(error).__name__}")

    def mark(self) -> None:
        """Keep the state as it is now: an owner that steps in halves sets its controls between."""
        if self._watch is not None:
            self._watch.mark()

    def _follow(self, end: Array) -> Followed:
        before, self._before = self._before, end
        if self._shadow is None or self._watch is None:
            return Followed(round((end[0] - before[0]) / self._model.opt.timestep), [])
        return self._shadow.follow(self._watch.taken(), end)

    def _present(self, observation: Any) -> dict[str, Array]:
        """The fields that hold before an action."""
        data = self._data
        values = (
            np.concatenate([data.qpos, data.qvel]) if observation is None else flat(observation)
        )
        found = {
            "time": np.array(data.time - self._start),
            "qpos": data.qpos.copy(),
            "qvel": data.qvel.copy(),
            "state": values.astype(np.float32),
        }
        if observation is not None and values.dtype == np.float64:
            found["observation"] = values
        return found

    def _flush(self) -> None:
        """Write what has been collected, opening the file with the first of it."""
        if self._writer is None:
            header = header_of(self._model, self._rows[0], self._about)
            self._path.parent.mkdir(parents=True, exist_ok=True)
            self._writer = EpisodeWriter(
                self._path, header, attachments=self._attached, display=True
            )
        names = list(self._rows[0])
        columns = {name: np.stack([row[name] for row in self._rows]) for name in names}
        inputs = self._messages()
        first = self.length - len(self._rows)
        self._rows = []
        self._writer.write_steps(first, columns, inputs=inputs)

    def _messages(self) -> dict[str, Array] | None:
        changes, self._changes = self._changes, []
        if not changes:
            return None
        columns: dict[str, list[Array]] = {item.name: [] for item in INPUTS.fields}
        for step, substep, row in changes:
            self._inputs.begin(np.array([0]), row[None])
            message = self._inputs.message(0, step)
            message["substep"], message["state"] = np.array([substep], np.int32), row[None]
            for name, value in message.items():
                columns[name].append(value)
        return {name: np.concatenate(values) for name, values in columns.items()}
