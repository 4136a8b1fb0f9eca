"""Check files at a level: structure, values, physics; each level takes in those before it."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from coordlog.config import build
from coordlog.episode import Array, Json
from coordlog.errors import StorageError
from coordlog.record.recording import Recording
from coordlog.verify.finding import Finding

LEVELS = ("file", "content", "replay")


class Checked(NamedTuple):
    """What was found in some files.

    Example:
        >>> check_files([Path("logs/a.mcap")], level="replay").findings    # doctest: +SKIP
        []
    """

    findings: list[Finding]
    inexact: dict[str, str]
    """Files whose physics could only be compared within tolerances, and why."""
    files: int
    steps: int
    """Steps that were simulated again."""
    notes: tuple[str, ...] = ()
    """What else is worth knowing: files that another program has written anew."""


def check_files(paths: list[Path], *, level: str) -> Checked:
    """Check some files at a level; runs in a process of its own.

    Args:
        paths: Episode files.
        level: "file": structure and checksums. "content": and values. "replay": and the physics,
            bit for bit.
    """
    from coordlog.verify.file import check as check_one
    from coordlog.verify.file import rewritten
    from coordlog.verify.observed import judged

    findings: list[Finding] = []
    notes: list[str] = []
    observed: dict[str, str] = {}
    for path in paths:
        recording = Recording(path)
        try:
            found = check_one(
                recording, level="file" if level == "file" else "content", rewards=logged_rewards
            )
            findings += found
            if not found and (note := rewritten(recording)):
                notes.append(f"{path}: {note}")
            if not found and level != "replay" and recording.observed:
                observed[str(path)] = judged(recording)
        except StorageError as error:  # it could be read a moment ago
            said = str(error).removeprefix(f"{path}: ")
            findings.append(Finding(str(path), "file", None, "file", "a readable file", said))
    if level != "replay":
        return Checked(findings, observed, len(paths), 0, tuple(notes))
    from coordlog.verify.physics import check_replay
    from coordlog.verify.trial import runnable

    damaged = {item.path for item in findings if item.level == "file"}
    tried = runnable([path for path in paths if str(path) not in damaged])
    findings += tried
    damaged |= {item.path for item in tried}
    replays = check_replay([path for path in paths if str(path) not in damaged])
    findings += replays.findings
    return Checked(findings, replays.inexact, len(paths), replays.steps, tuple(notes))


def logged_rewards(
    distance: Array,
    boundary: Array,
    goal: Array,
    collision: Array,
    instability: Array,
    constants: Json,
) -> Array:
    """The reward equation with the constants of a log, (T, k)."""
    from coordlog.tasks.config import RewardConfig
    from coordlog.tasks.reach.reward import Flags, rewards

    flags = Flags(boundary, goal, collision, instability)
    return rewards(distance, flags, build(RewardConfig, constants))
