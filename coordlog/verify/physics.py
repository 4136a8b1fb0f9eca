"""`coordlog check` with the physics: simulate logs again, each from its own file alone, and compare
every number bit for bit.

On another MuJoCo version or architecture bits may differ; there positions, velocities and distances
must agree within tolerances, flags and rewards are not compared, and the caller is told why.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import mujoco
import numpy as np

from coordlog.episode import CONTACT, INITIAL_STATE, Array, Episode
from coordlog.errors import CoordlogError
from coordlog.record.opening import File
from coordlog.record.recording import Recording
from coordlog.sim.replay import Log, exact_here, replay
from coordlog.sim.traced import Trace
from coordlog.verify.finding import Finding
from coordlog.verify.observed import judged

TOLERANCES = {"qpos": 1e-3, "qvel": 5e-2, "distance": 1e-3}
"""Largest differences accepted where the same bits cannot be expected [m, rad, and per second].

Our choice.
"""


class Replays(NamedTuple):
    """What replaying some files showed."""

    findings: list[Finding]
    inexact: dict[str, str]
    """Why bits were not compared, by path; of an observed episode, what was looked at."""
    steps: int
    """Control steps that were simulated."""


def check_replay(paths: Sequence[File], *, threads: int = 1) -> Replays:
    """Replay finished episodes together and compare them with what is logged.

    Args:
        paths: Files that passed the content check.
        threads: Threads to simulate on.
    """
    findings: list[Finding] = []
    inexact: dict[str, str] = {}
    names: list[str] = []
    episodes: list[Episode] = []
    logs: list[Log] = []
    models = _Models()
    for path in paths:
        recording = Recording(path)
        name = recording.source
        try:
            if said := judged(recording):
                inexact[name] = said
                continue
            episode = recording.episode
            log = Log.of(episode, models.of(recording), recording.initial_state)
        except CoordlogError as error:
            findings.append(
                Finding(name, "replay", None, "model", "one that can be simulated", str(error))
            )
            continue
        names.append(name)
        episodes.append(episode)
        logs.append(log)
        reason = exact_here(episode.header)
        if reason:
            inexact[name] = reason
    traces = _replay_each(names, logs, findings, threads)
    for name, episode, trace in zip(names, episodes, traces, strict=True):
        if trace is not None:
            compare = _compare_nearly if name in inexact else _compare_bits
            findings += [
                Finding(name, "replay", *difference) for difference in compare(episode, trace)
            ]
    return Replays(findings, inexact, sum(len(log.action) for log in logs))


class _Models:
    """Compiled models of files, one for those whose attachments are the same as the last one's."""

    def __init__(self) -> None:
        self._last: tuple[dict[str, bytes], mujoco.MjModel] | None = None

    def of(self, recording: Recording) -> mujoco.MjModel:
        """A file's model; errors as of `Recording.model`."""
        said = {name: data for name, data in recording.attachments.items() if name != INITIAL_STATE}
        if self._last is None or self._last[0] != said:
            self._last = said, recording.model
        return self._last[1]


def _replay_each(
    names: list[str], logs: list[Log], findings: list[Finding], threads: int
) -> list[Trace | None]:
    """Replay all together; if one spoils that, one by one, so that the rest is still compared."""
    try:
        return list(replay(logs, threads=threads))
    except (CoordlogError, KeyError, IndexError, ValueError):
        traces: list[Trace | None] = []
        for name, log in zip(names, logs, strict=True):
            try:
                traces += replay([log], threads=threads)
            except (CoordlogError, KeyError, IndexError, ValueError) as error:
                findings.append(
                    Finding(
                        name,
                        "replay",
                        None,
                        "model",
                        "one that its header describes",
                        f"{type(error).__name__}: {error}",
                    )
                )
                traces.append(None)
        return traces


Difference = tuple[int | None, str, str, str]


def _compare_bits(episode: Episode, trace: Trace) -> list[Difference]:
    """The first step at which any column differs, and the first column that does.

    Nothing if all bits are equal.
    """
    found = [
        (step, name)
        for name, column in trace.columns.items()
        if episode.has(name)
        for step in _unequal(getattr(episode, name), column)[:1]
    ]
    if found:
        step, name = min(found, key=lambda item: item[0])
        return [_difference(step, name, getattr(episode, name)[step], trace.columns[name][step])]
    if episode.contacts.tobytes() != trace.contacts.tobytes():
        return [_contacts(episode.contacts, trace.contacts)]
    return []


def _compare_nearly(episode: Episode, trace: Trace) -> list[Difference]:
    """The first step at which a column differs by more than its tolerance."""
    found = []
    for name, tolerance in TOLERANCES.items():
        if name not in trace.columns or not episode.has(name):
            continue
        logged, again = getattr(episode, name), trace.columns[name]
        away = ~(np.abs(logged - again) <= tolerance)
        steps = np.flatnonzero(away.any(axis=tuple(range(1, away.ndim))))
        found += [(int(step), name) for step in steps[:1]]
    if not found:
        return []
    step, name = min(found)
    return [
        _difference(
            step,
            f"{name} (tolerance {TOLERANCES[name]:g})",
            getattr(episode, name)[step],
            trace.columns[name][step],
        )
    ]


def _unequal(logged: Array, again: Array) -> list[int]:
    """Steps whose bytes differ."""
    a = np.ascontiguousarray(logged).view(np.uint8).reshape(len(logged), -1)
    b = np.ascontiguousarray(again).view(np.uint8).reshape(len(again), -1)
    return [int(step) for step in np.flatnonzero((a != b).any(axis=1))]


def _difference(step: int, name: str, logged: Array, again: Array) -> Difference:
    """The entry of a row that differs most, as logged and as simulated again."""
    a, b = np.atleast_1d(logged), np.atleast_1d(again)
    if a.dtype.kind == "f":
        gap = np.abs(a.astype(np.float64) - b)
        entry = int(np.argmax(np.where(np.isfinite(gap), gap, np.inf)))
    else:
        entry = int(np.argmax(a != b))
    label = name if len(a) == 1 else f"{name}[{entry}]"
    return step, label, f"{_digits(b[entry])} (simulated again)", f"{_digits(a[entry])} (logged)"


def _digits(value: np.generic) -> str:
    return repr(value.item())


def _contacts(logged: Array, again: Array) -> Difference:
    for row in range(max(len(logged), len(again))):
        a = logged[row] if row < len(logged) else None
        b = again[row] if row < len(again) else None
        if a is None or b is None or a.tobytes() != b.tobytes():
            step = int((a if a is not None else b)["step"])  # type: ignore[index]
            return step, "contacts", _contact_text(b), _contact_text(a)
    return None, "contacts", "equal rows", "rows that differ"


def _contact_text(row: np.void | None) -> str:
    return (
        "none"
        if row is None
        else ", ".join(f"{name} {row[name].item()!r}" for name in CONTACT.names or ())
    )
