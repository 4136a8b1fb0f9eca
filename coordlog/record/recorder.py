"""An environment that records: the same `problem`, `reset` and `step`, and every episode becomes a
file.

The loop that runs it does not know. Steps are collected per simulation and handed to one writing
thread a block at a time, so encoding, compression and fsync overlap with the physics. Whatever ends
the run, no step that was handed over is lost.
"""

from __future__ import annotations

import hashlib
import time
import uuid
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from coordlog.contracts import Outcome, Problem
from coordlog.episode import CONTACT, FIELD_KEYS, KINDS, Array, Header, Json, Result
from coordlog.errors import CoordlogError, StorageError
from coordlog.record.display import Shown
from coordlog.record.storage import PART
from coordlog.record.writer import BLOCK, EpisodeWriter
from coordlog.sim.description import Description
from coordlog.sim.env import BatchEnv
from coordlog.sim.inputs import Inputs
from coordlog.spec import INPUTS, SCHEMA_VERSION
from coordlog.tasks.scene import sphere_geom

BRANCH = "branch"
"""The lineage's name for an episode that begins in the middle of another."""
BACKLOG = 512
"""Blocks that may wait for the writing thread; then the physics waits, so memory stays flat."""


class Finished(NamedTuple):
    """One episode that has become a file."""

    path: Path
    header: Header
    result: Result


class Recorder:
    """Records every episode of an environment into a folder, one file each.

    A context manager: leaving it closes the files. Episodes under way are closed as aborted, with
    all their steps.
    """

    def __init__(
        self,
        env: BatchEnv,
        folder: Path,
        *,
        policy: Json,
        display: bool = True,
        epoch: int | None = None,
        run: str = "",
        finished: Callable[[Finished], None] | None = None,
    ) -> None:
        """Make the folder; files appear as episodes start.

        Args:
            env: What to record.
            folder: Where; made if missing. Files that are there stay as they are.
            policy: The `coordlog.policy` record: kind, name, checkpoint_sha256, noise.
            display: Also write the topics that viewers plot by name.
            epoch: Start time of every episode [ns since 1970]; None for the wall clock. With it,
                equal runs write equal bytes.
            run: Name of a run to go on with: its finished episodes are not written again, its part
                files are. "" for a new run.
            finished: Called on the writing thread with every finished file.

        Raises:
            StorageError: if the folder cannot be made.
        """
        self._env, self._folder, self._policy, self._display = env, folder, policy, display
        self._epoch, self._finished = epoch, finished
        self._describe = _described(env)
        self._shown = Description(env.task.model) if display else None
        self._inputs = Inputs(env.task.model, n=env.n)
        self._resumed = bool(run)
        self.run = run or _run_id(self._describe, policy, env.start, epoch)
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise StorageError(f"{folder}: cannot make the folder: {error.strerror}") from error
        self._writers: list[EpisodeWriter | None] = [None] * env.n
        self._filled = np.zeros(env.n, dtype=np.int64)
        self._contacts: list[list[Array]] = [[] for _ in range(env.n)]
        self._changes: list[list[dict[str, Array]]] = [[] for _ in range(env.n)]
        self._sent = np.zeros(env.n, dtype=np.int64)
        self._rows = self._buffers()
        self._stepping = False
        self.seconds = 0.0
        """Time that recording has cost so far: on the caller's thread, and processor time of the
        writing thread [s]."""
        self._thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix="coordlog-writer")
        self._pending: deque[Future[Any]] = deque()

    @property
    def n(self) -> int:
        """Number of simulations."""
        return self._env.n

    @property
    def state(self) -> Array:
        """Present policy state of every simulation, (N, n_x) float32."""
        return self._env.state

    def problem(self, *, seed: int, split: str, index: int) -> Problem:
        """The problem of one episode."""
        return self._env.problem(seed=seed, split=split, index=index)

    def reset(self, ids: Array, problems: list[Problem]) -> None:
        """Start episodes, and a file for each.

        Raises:
            StorageError: if a file cannot be created.
        """
        self._env.reset(ids, problems)
        for slot, problem in zip(ids, problems, strict=True):
            header, attachments = self._header(problem), self._env.attachments(int(slot))
            self._filled[slot] = self._sent[slot] = 0
            self._writers[slot] = self._open(header, attachments, self._show(int(slot)))
        self._inputs.begin(ids, self._env.physics.rows)

    def step(self, action: Array, ids: Array) -> Outcome:
        """Step the environment, and record what was and what it led to.

        Raises:
            StorageError: if an earlier block could not be written.
        """
        began = time.perf_counter()
        at = self._filled[ids]
        self._stepping = True
        self._rows["action"][ids, at] = action
        for name, values in self._env.present(ids).items():
            self._rows[name][ids, at] = values
        self._watch(ids)
        stepped = time.perf_counter()
        outcome = self._env.step(action, ids)
        back = time.perf_counter()
        for name, values in outcome.columns.items():
            self._rows[name][ids, at] = values
        self._collect(ids, outcome)
        self._filled[ids] += ~outcome.diverged
        self._stepping = False
        self._after(ids, outcome)
        self.seconds += stepped - began + time.perf_counter() - back
        return outcome

    def close(self, reason: str = "interrupted") -> None:
        """Close episodes under way as aborted, wait for the writing thread, and let go of every
        file.

        Raises:
            StorageError: if something could not be written; the part files that stay are named in
                it.
        """
        try:
            for slot, writer in enumerate(self._writers):
                if writer is not None:
                    self._end(slot, aborted=reason)
            self._drain(0)
        finally:
            self._thread.shutdown(wait=True)
            for writer in self._writers:
                if writer is not None:
                    writer.close()

    def __enter__(self) -> Recorder:
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        try:
            self.close(
                "interrupted"
                if error is None or isinstance(error, KeyboardInterrupt)
                else f"failed: {type(error).__name__}"
            )
        except CoordlogError:
            if error is None:
                raise

    def _buffers(self) -> dict[str, Array]:
        header = Header({"schema_version": SCHEMA_VERSION}, self._describe, self._policy)
        layout = header.layout
        return {
            item.name: np.zeros((self.n, *layout.shape(item, BLOCK)), dtype=item.type)
            for item in header.fields
        }

    def _show(self, slot: int) -> Shown | None:
        """What viewers see of the episode that starts in a slot."""
        if self._shown is None:
            return None
        radii = self._env.simulation.radii[slot]
        spheres = {sphere_geom(i): float(radius) for i, radius in enumerate(radii)}
        return Shown(self._shown, self._env.physics.rows[slot].copy(), spheres)

    def _watch(self, ids: Array) -> None:
        """Keep what else the physics is given in this step, where that has changed."""
        for row in np.flatnonzero(self._inputs.changed(ids, self._env.physics.rows)):
            slot = int(ids[row])
            step = int(self._env.simulation.steps[slot])
            self._changes[slot].append(self._inputs.message(slot, step))

    def _collect(self, ids: Array, outcome: Outcome) -> None:
        """Keep the contacts of this step."""
        touched = np.array([len(rows) for rows in outcome.contacts])
        for row in np.flatnonzero((touched > 0) & ~outcome.diverged):
            rows = outcome.contacts[row].copy()
            rows["step"] = self._env.simulation.steps[ids[row]] - 1
            self._contacts[ids[row]].append(rows)

    def _after(self, ids: Array, outcome: Outcome) -> None:
        for row in np.flatnonzero(
            (self._filled[ids] == BLOCK) | outcome.terminated | outcome.truncated | outcome.diverged
        ):
            slot = int(ids[row])
            if outcome.diverged[row]:
                self._end(
                    slot,
                    aborted=(
                        "diverged: the state is no number after step "
                        f"{self._env.simulation.steps[slot] - 1}"
                    ),
                    before=True,
                )
            elif outcome.terminated[row] or outcome.truncated[row]:
                self._end(slot, aborted="")
            else:
                self._flush(slot)

    def _flush(self, slot: int) -> None:
        """Hand the collected steps of a slot to the writing thread."""
        writer, n = self._writers[slot], int(self._filled[slot])
        if writer is None:
            self._contacts[slot], self._changes[slot], self._filled[slot] = [], [], 0
        elif n:
            columns = {name: values[slot, :n].copy() for name, values in self._rows.items()}
            contacts = (
                np.concatenate(self._contacts[slot])
                if self._contacts[slot]
                else np.zeros(0, dtype=CONTACT)
            )
            self._sent[slot] += n
            inputs = _stacked(self._changes[slot], int(self._sent[slot]))
            self._contacts[slot], self._changes[slot] = [], []
            self._filled[slot] = 0
            self._submit(_write, writer, columns, contacts, inputs)

    def _end(self, slot: int, *, aborted: str, before: bool = False) -> None:
        """Finish a slot's file.

        `before` for a final state that is the one before the step under way.
        """
        writer = self._writers[slot]
        at = int(self._filled[slot])
        if before or self._stepping:
            states = self._env.present(np.array([slot]))
            final = {name: self._rows[name][slot, at].copy() for name in states}
        else:
            final = {
                name: np.array(values[0])
                for name, values in self._env.present(np.array([slot])).items()
            }
        self._flush(slot)
        self._writers[slot] = None
        if writer is not None:
            self._submit(self._finish, writer, final, aborted)

    def _finish(self, writer: EpisodeWriter, final: dict[str, Array], aborted: str) -> None:
        if not writer.length:  # nothing happened: there is no episode to keep
            writer.discard()
            return
        result = writer.finish(final, aborted=aborted)
        if self._finished:
            self._finished(Finished(writer.path, writer.header, result))

    def _submit(self, job: Callable[..., None], *args: Any) -> None:
        self._pending.append(self._thread.submit(self._timed, job, *args))
        self._drain(BACKLOG)

    def _timed(self, job: Callable[..., None], *args: Any) -> None:
        began = time.thread_time()
        job(*args)
        self.seconds += time.thread_time() - began

    def _drain(self, leave: int) -> None:
        """Raise what failed on the writing thread.

        Wait until no more than `leave` jobs are left.
        """
        while self._pending and (len(self._pending) > leave or self._pending[0].done()):
            self._pending.popleft().result()

    def _header(self, problem: Problem) -> Header:
        env, start = self._env, time.time_ns() if self._epoch is None else self._epoch
        name, branch = (
            f"{env.scene.name}/{problem.split}/{problem.seed}/{problem.index}",
            problem.branch,
        )
        if branch is not None:
            name += f"/{branch.parent}/{len(branch.actions)}"
        episode = {
            "schema_version": SCHEMA_VERSION,
            "kind": KINDS[0],
            "id": hashlib.sha256(f"{self.run}/{name}".encode()).hexdigest()[:16],
            "run": self.run,
            "robot": env.scene.robot.name,
            "scene": env.scene.name,
            "split": problem.split,
            "seed": problem.seed,
            "index": problem.index,
            "start": env.start,
            "control_period": env.task.config.control_period,
            "start_time": start,
            "goals": problem.goals.tolist(),
            "obstacles": problem.spheres.tolist(),
        }
        if branch is None:
            return Header(episode, self._describe, self._policy)
        lineage = {
            "parents": [branch.parent],
            "transform": BRANCH,
            "parameters": {"step": len(branch.actions)},
        }
        return Header(episode, self._describe, self._policy, lineage)

    def _open(
        self, header: Header, attachments: dict[str, bytes], shown: Shown | None
    ) -> EpisodeWriter | None:
        """A writer under the first free name: what another run has written is never in the way and
        never replaced.

        None for an episode that a resumed run had finished before it was stopped.
        """
        episode = header.episode
        scene = episode["scene"].replace("/", "_").replace("\\", "_")
        stem = f"{scene}-{episode['split']}-s{episode['seed']}-{episode['index']:06d}-{self.run}"
        attempt = 1
        if self._resumed and (self._folder / f"{stem}.mcap").exists():
            return None
        if self._resumed:  # its steps are taken again, the same ones, and more
            (self._folder / f"{stem}.mcap{PART}").unlink(missing_ok=True)
        while True:
            path = self._folder / (f"{stem}.mcap" if attempt == 1 else f"{stem}-{attempt}.mcap")
            try:
                return EpisodeWriter(
                    path, header, attachments=attachments, display=self._display, shown=shown
                )
            except StorageError:
                if not path.exists() and not path.with_name(path.name + PART).exists():
                    raise
                attempt += 1


def _described(env: BatchEnv) -> Json:
    """The `coordlog.env` record, with the fields that the task declares."""
    said = env.describe()
    fields = [{key: getattr(item, key) for key in FIELD_KEYS} for item in env.fields]
    return said | {"task": said["task"] | {"fields": fields}}


def _stacked(rows: list[dict[str, Array]], stop: int) -> dict[str, Array] | None:
    """Changes of inputs before a step as columns; None without any."""
    rows = [row for row in rows if row["step"][0] < stop]
    if not rows:
        return None
    return {item.name: np.concatenate([row[item.name] for row in rows]) for item in INPUTS.fields}


def _write(
    writer: EpisodeWriter,
    columns: dict[str, Array],
    contacts: Array,
    inputs: dict[str, Array] | None,
) -> None:
    writer.write_steps(writer.length, columns, contacts=contacts, inputs=inputs)


def _run_id(describe: Json, policy: Json, start: str, epoch: int | None) -> str:
    """Eight characters: random, or with a fixed epoch a digest of the settings, so that equal runs
    have equal names.
    """
    if epoch is None:
        return uuid.uuid4().hex[:8]
    return hashlib.sha256(repr((describe, policy, start, epoch)).encode()).hexdigest()[:8]
