"""Lineage of a smoothed episode: the header it gets, and the figures that are kept in it."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from coordlog.episode import Array, Header, Json
from coordlog.record.recording import Recording
from coordlog.smooth.blending import grid_for
from coordlog.smooth.config import Config

if TYPE_CHECKING:
    from coordlog.smooth.result import Result

TRANSFORM = "smooth"
"""The lineage's name for smoothing."""
FASTER = 1.02
"""A path may be faster by this factor than the servo targets may move, or than the log's own
interpolant, whichever is faster: what the servos then lack they catch up with."""


def derived(recording: Recording, parameters: Json) -> Header:
    """The header of what is made of a log: its own, with an id and a lineage that follow from the
    log's bytes and the parameters.
    """
    raw, digest = recording.header, recording.digest
    lineage = {"parents": [digest], "transform": TRANSFORM, "parameters": parameters}
    name = hashlib.sha256(f"{digest}/{TRANSFORM}/{parameters}".encode()).hexdigest()[:16]
    header = replace(raw, episode=raw.episode | {"id": name}, lineage=lineage)
    if parameters["steps_of"] == "log":
        return header
    policy = raw.policy | {"kind": f"{raw.policy['kind']}, smoothed"}
    return replace(header, policy=policy)


def common(result: Result, settings: Json, *, joints: Sequence[str]) -> Json:
    """Figures of a path that need no simulation, JSON-able."""
    rows = zip(joints, result.p.tolist(), result.lam.tolist(), result.cutoff.tolist(), strict=True)
    violation = result.violation
    return {
        "settings": settings,
        "violation": None
        if violation is None
        else {name: number(value) for name, value in violation._asdict().items()},
        "joints": [
            {"name": name, "p": p, "lam": lam, "cutoff_hz": number(hz)} for name, p, lam, hz in rows
        ],
        "before": {name: number(value) for name, value in result.before._asdict().items()},
        "after": {name: number(value) for name, value in result.after._asdict().items()},
        "checks": result.checks,
        "slacks": result.slacks,
    }


def fastest_of(time: Array, angles: Array, *, ends: str = "soft") -> Array:
    """Largest speed of each joint along the interpolant of a log with these ends (`Config.ends`),
    (n_u,) [rad/s].
    """
    config, weight = Config(ends=ends), np.ones(len(time))
    weight[[0, -1]] = np.inf
    still = np.zeros((2, angles.shape[1])) if config.clamped else None
    through = grid_for(time, config).fit(angles, lam=0.0, weight=weight, velocity=still)
    samples = np.linspace(time[0], time[-1], 8 * len(time))
    return np.asarray(np.abs(through(samples, 1)).max(axis=0))


def number(value: Any) -> Any:
    """JSON has no infinity and no NaN: None stands for both."""
    return None if isinstance(value, float) and not math.isfinite(value) else value
