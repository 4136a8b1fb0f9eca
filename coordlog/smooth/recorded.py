"""One recorded episode smoothed: its checker, limits, execution, lineage and figures.

The file's bytes, its model and its task come in ready and are used as they are: nothing here opens
a file, compiles a model or builds a task again.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, cast

import numpy as np

from coordlog.episode import Array, Episode, Json
from coordlog.kinematics.base_motion import require_fit
from coordlog.kinematics.clearance import NEAR, SceneChecker
from coordlog.record.recording import Recording
from coordlog.sim.replay import Log, bound_task, resting_of
from coordlog.smooth.execute import Execution, execute
from coordlog.smooth.limits import Limits
from coordlog.smooth.lineage import FASTER, common, derived, fastest_of, number
from coordlog.smooth.metrics import PathLoad
from coordlog.smooth.result import Result
from coordlog.smooth.smoother import smooth

if TYPE_CHECKING:
    from coordlog.smooth.feasibility import DistanceChecker


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
    ends = "natural" if settings["method"] == "paper" else "soft"
    result, checker = smooth_motion(log, episode.time, episode.qpos, ends=ends, settings=settings)
    execution = execute(log, result, episode)
    parameters = _parameters(episode, result, execution, settings, checker)
    return _episode(recording, result, execution, parameters), parameters


def smooth_motion(
    log: Log, time: Array, qpos: Array, *, ends: str, settings: Json
) -> tuple[Result, SceneChecker]:
    """Smooth how the action joints moved in one scene, with all that else moved as it did.

    Args:
        log: Model, task and first state; its actions are not looked at.
        time: Times, (n,) [s].
        qpos: The whole configuration at each, (n, n_q).
        ends: How the path ends (`coordlog.smooth.config.Config`).
        settings: Other options of `coordlog.smooth.smooth`.

    Raises:
        FormatError: if the model lacks what the task names.
        SpecError: if the motion cannot be smoothed as it is.
    """
    task = bound_task(log)
    checker = SceneChecker(
        log.model,
        task.robot,
        task.config,
        time=time,
        qpos=qpos,
        initial=log.start,
        resting=resting_of(log.header),
    )
    angles = qpos[:, task.qpos_index]
    fastest = fastest_of(time, angles, ends=ends)
    limits = Limits(
        task.limits[:, 0],
        task.limits[:, 1],
        speed=FASTER * np.maximum(task.speeds, fastest),
        nominal_speed=task.speeds,
    )
    # The checker is one by its methods: kinematics knows nothing of smoothing.
    result = smooth(
        time,
        angles,
        cast("DistanceChecker", checker),
        limits=limits,
        continuous=checker.continuous,
        joints=task.robot.action_joints,
        units=checker.units,
        ends=ends,
        **settings,
    )
    return result, checker


def _episode(
    recording: Recording, result: Result, execution: Execution, parameters: Json
) -> Episode:
    """The execution as an episode, or the log's own steps; either way with its lineage."""
    raw, header = recording.episode, derived(recording, parameters)
    if execution.run is None:
        return replace(raw, header=header, path=None)
    columns = execution.run.columns
    returns = tuple(columns["reward"].sum(axis=0).tolist())
    ended = replace(raw.result, length=len(columns["action"]), returns=returns)
    return Episode(
        header,
        ended,  # the writer computes it anew
        contacts=execution.run.contacts,
        path=result.path(),
        inputs=raw.inputs,
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
    ran, joints = execution.run, raw.header.env["action_joints"]
    length = len(raw) if ran is None else len(ran.columns["action"])
    before, after = (
        PathLoad.of(path, checker.inverse, knots.unit)._asdict()
        for path in (result.reference, result.spline)
    )
    margin = {"before": number(before.pop("balance")), "after": number(after.pop("balance"))}
    torques = {
        "before": execution.raw._asdict(),
        "after": execution.smoothed._asdict() if execution.smoothed else None,
    }
    return common(result, settings, joints=joints) | {
        "status": execution.status,
        "reason": execution.reason,
        "steps_of": "log" if ran is None else "execution",
        "certified": bool(result.certified) and ran is not None,
        "clearance": {
            "before": number(apart[0]),
            "after": number(apart[1]),
            "measured_up_to": NEAR,
        },
        "torque": torques,
        "path_torque": {"before": before, "after": after},
        "zero_moment_margin": margin,
        "tracking_error": execution.away,
        "steps": {"before": len(raw), "after": length},
    }
