"""One recorded episode smoothed: its checker, limits, execution, lineage and figures.

The file's bytes, its model and its task come in ready and are used as they are: nothing here opens
a file, compiles a model or builds a task again.
"""

from __future__ import annotations

import hashlib
import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from coordlog.episode import Array, Episode, Json
from coordlog.kinematics.base_motion import require_fit
from coordlog.kinematics.clearance import NEAR, SceneChecker
from coordlog.record.recording import Recording
from coordlog.sim.replay import Log, resting_of, task_of
from coordlog.smooth.blending import grid_for
from coordlog.smooth.config import Config
from coordlog.smooth.execute import Execution, execute
from coordlog.smooth.limits import Limits
from coordlog.smooth.metrics import PathLoad
from coordlog.smooth.result import Result
from coordlog.smooth.smoother import smooth

if TYPE_CHECKING:
    from coordlog.smooth.feasibility import DistanceChecker

TRANSFORM = "smooth"
"""The lineage's name for what is done here."""
FASTER = 1.02
"""A path may be faster by this factor than the servo targets may move, or than the log's own
interpolant, whichever is faster: what the servos then lack they catch up with."""


def smooth_episode(recording: Recording, settings: Json) -> tuple[Episode, Json]:
    """Smooth a logged episode and execute the path.

    Args:
        recording: The log.
        settings: Options of `coordlog.smooth.smooth`.

    Returns:
        The episode that takes the log's place, and the parameters that its lineage holds.

    Raises:
        FormatError: if the model or the first state is missing, damaged, or not the episode's.
        SpecError: if the log cannot be smoothed as it is; the message says why.
    """
    episode = recording.episode
    require_fit(recording.model, recording.initial_state, episode)
    log = Log.of(episode, recording.model, recording.initial_state)
    task = task_of(log)
    checker = SceneChecker(
        log.model,
        task.robot,
        task.config,
        time=episode.time,
        qpos=episode.qpos,
        initial=log.start,
        resting=resting_of(episode.header),
    )
    angles = episode.qpos[:, task.qpos_index]
    ends = "natural" if settings["method"] == "paper" else "soft"
    fastest = fastest_of(episode.time, angles, ends=ends)
    limits = Limits(
        task.limits[:, 0],
        task.limits[:, 1],
        speed=FASTER * np.maximum(task.speeds, fastest),
        nominal_speed=task.speeds,
    )
    # The checker is one by its methods: kinematics knows nothing of smoothing.
    result = smooth(
        episode.time,
        angles,
        cast("DistanceChecker", checker),
        limits=limits,
        continuous=checker.continuous,
        joints=task.robot.action_joints,
        units=checker.units,
        ends=ends,
        **settings,
    )
    execution = execute(log, result, episode)
    parameters = _parameters(episode, result, execution, settings, checker)
    return _episode(recording, result, execution, parameters), parameters


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


def _episode(
    recording: Recording, result: Result, execution: Execution, parameters: Json
) -> Episode:
    """The execution as an episode, or the log's own steps; either way with its lineage."""
    raw, digest = recording.episode, recording.digest
    lineage = {"parents": [digest], "transform": TRANSFORM, "parameters": parameters}
    name = hashlib.sha256(f"{digest}/{TRANSFORM}/{parameters}".encode()).hexdigest()[:16]
    header = replace(raw.header, episode=raw.header.episode | {"id": name}, lineage=lineage)
    if execution.run is None:
        return replace(raw, header=header, path=None)
    policy = raw.header.policy | {"kind": f"{raw.header.policy['kind']}, smoothed"}
    columns = execution.run.columns
    ended = replace(
        raw.result,
        length=len(columns["action"]),
        returns=tuple(columns["reward"].sum(axis=0).tolist()),
    )
    return replace(
        raw,
        header=replace(header, policy=policy),
        result=ended,  # the writer computes it anew
        contacts=execution.run.contacts,
        path=result.path(),
        columns={**raw.columns, **columns},
    )


def _parameters(
    raw: Episode, result: Result, execution: Execution, settings: Json, checker: SceneChecker
) -> Json:
    """All that is worth knowing about one smoothing, JSON-able and the same at every run."""
    samples = np.linspace(raw.time[0], raw.time[-1], 2 * len(raw.time))
    knots = result.knots
    logged = np.stack([np.interp(samples, knots.time, q) for q in knots.position.T], axis=1)
    apart = [checker.nearest(samples, logged), checker.nearest(samples, result.spline(samples))]
    joints = raw.header.env["action_joints"]
    rows = zip(joints, result.p.tolist(), result.lam.tolist(), result.cutoff.tolist(), strict=True)
    ran, violation = execution.run, result.violation
    length = len(raw) if ran is None else len(ran.columns["action"])
    before, after = (
        PathLoad.of(path, checker.inverse, knots.unit)._asdict()
        for path in (result.reference, result.spline)
    )
    margin = {"before": _number(before.pop("balance")), "after": _number(after.pop("balance"))}
    torques = {
        "before": execution.raw._asdict(),
        "after": execution.smoothed._asdict() if execution.smoothed else None,
    }
    return {
        "settings": settings,
        "status": execution.status,
        "reason": execution.reason,
        "steps_of": "log" if ran is None else "execution",
        "certified": bool(result.certified) and ran is not None,
        "violation": None
        if violation is None
        else {name: _number(value) for name, value in violation._asdict().items()},
        "joints": [
            {"name": name, "p": p, "lam": lam, "cutoff_hz": _number(hz)}
            for name, p, lam, hz in rows
        ],
        "before": {name: _number(value) for name, value in result.before._asdict().items()},
        "after": {name: _number(value) for name, value in result.after._asdict().items()},
        "clearance": {
            "before": _number(apart[0]),
            "after": _number(apart[1]),
            "measured_up_to": NEAR,
        },
        "torque": torques,
        "path_torque": {"before": before, "after": after},
        "zero_moment_margin": margin,
        "tracking_error": execution.away,
        "steps": {"before": len(raw), "after": length},
        "checks": result.checks,
        "slacks": result.slacks,
    }


def _number(value: Any) -> Any:
    """JSON has no infinity and no NaN: None stands for both."""
    return None if isinstance(value, float) and not math.isfinite(value) else value
