"""An observed episode smoothed: somebody else's joint motion, with the model they gave, or none.

Nothing is executed: the path itself, at the log's own times, takes the place of the joint columns,
and the lineage says so. Without a model nothing could touch anything, and nothing is certified.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple, cast

import numpy as np

from coordlog.episode import MODEL_XML, Array, Episode, Json
from coordlog.kinematics.base_motion import require_fit
from coordlog.kinematics.clearance import NEAR, SceneChecker
from coordlog.record.recording import Recording
from coordlog.robots.robot import Arm, Robot
from coordlog.smooth.feasibility import Unobstructed
from coordlog.smooth.limits import Limits
from coordlog.smooth.lineage import FASTER, common, derived, fastest_of, number
from coordlog.smooth.result import FALLBACK, PARTLY, SMOOTHED, Result
from coordlog.smooth.smoother import smooth
from coordlog.tasks.config import EnvConfig

if TYPE_CHECKING:
    from coordlog.smooth.feasibility import Checker

STEPS = "path"
"""Whose steps the output carries: those of the path, which nothing executed."""
NO_MODEL = "the log carries no model, so contacts and limits could not be checked"


class _Moved(NamedTuple):
    """Where the joints of an observed episode stand, and what is known of them."""

    names: list[str]
    qpos: Array  # (n_j,) places in qpos
    qvel: Array  # (n_j,) places in qvel
    checker: SceneChecker | None


def smooth_observed(recording: Recording, settings: Json) -> tuple[Episode, Json]:
    """Smooth an observed episode.

    Args:
        recording: The episode.
        settings: Options of `coordlog.smooth.smooth`.

    Returns:
        The episode that takes its place, and the parameters that its lineage holds.

    Raises:
        FormatError: if its model is damaged or not the episode's.
        SpecError: if it cannot be smoothed as it is; the message says why.
    """
    episode, moved = recording.episode, _moved(recording)
    checker, angles = moved.checker, episode.qpos[:, moved.qpos]
    ends = "natural" if settings["method"] == "paper" else "soft"
    fastest = FASTER * fastest_of(episode.time, angles, ends=ends)
    low, high = (-np.inf, np.inf) if checker is None else checker.limits.T
    result = smooth(
        episode.time,
        angles,
        cast("Checker", checker or Unobstructed(len(moved.names))),
        limits=Limits(low, high, speed=np.where(fastest > 0.0, fastest, np.inf)),
        continuous=() if checker is None else checker.continuous,
        joints=moved.names,
        units=() if checker is None else checker.units,
        ends=ends,
        **settings,
    )
    parameters = _parameters(episode, result, settings, moved)
    header = derived(recording, parameters)
    if parameters["steps_of"] == "log":
        return replace(episode, header=header, path=None), parameters
    return _episode(episode, header, result, moved), parameters


def _moved(recording: Recording) -> _Moved:
    episode = recording.episode
    env = episode.header.env
    names = list(env["action_joints"])
    places = {joint["name"]: joint for joint in env["joints"]}
    qpos, qvel = (np.array([places[name][key] for name in names]) for key in ("qpos", "qvel"))
    if MODEL_XML not in recording.attachments:
        return _Moved(names, qpos, qvel, None)
    require_fit(recording.model, recording.initial_state, episode)
    arms = (Arm("joints", "", tuple(names)),)
    checker = SceneChecker(
        recording.model,
        Robot(str(env["robot"]["name"]), "", arms, poses={"stand": {}}),
        EnvConfig(),
        time=episode.time,
        qpos=episode.qpos,
        initial=recording.initial_state,
    )
    return _Moved(names, qpos, qvel, checker)


def _episode(raw: Episode, header: object, result: Result, moved: _Moved) -> Episode:
    """The path at the log's own times; what was not a joint of it stays."""
    path, columns = result.spline(raw.time), dict(raw.columns)
    columns["qpos"], columns["qvel"] = raw.qpos.copy(), raw.qvel.copy()
    columns["qpos"][:, moved.qpos] = path
    columns["qvel"][:, moved.qvel] = result.spline(raw.time, 1)
    columns["state"], columns["action"] = path.astype("<f4"), path[1:].astype("<f4")
    return Episode(
        header,  # type: ignore[arg-type]
        raw.result,  # the writer computes it anew
        contacts=raw.contacts,
        path=result.path(),
        inputs=raw.inputs,
        columns=columns,
    )


def _parameters(raw: Episode, result: Result, settings: Json, moved: _Moved) -> Json:
    checker, status, reason = moved.checker, result.status, result.reason
    kept = status == FALLBACK or not result.lam.any()
    if checker is None:
        status = PARTLY if status == SMOOTHED else status
        reason = "; ".join(filter(None, (reason, NO_MODEL)))
    deviation = result.deviation.tolist()
    found = common(result, settings, joints=moved.names) | {
        "status": status,
        "reason": reason,
        "steps_of": "log" if kept else STEPS,
        "certified": bool(result.certified) and checker is not None and not kept,
        "deviation": dict(zip(moved.names, deviation, strict=True)),
        "steps": {"before": len(raw), "after": len(raw)},
    }
    if checker is not None:
        samples = np.linspace(raw.time[0], raw.time[-1], 2 * len(raw.time))
        apart = [
            checker.nearest(samples, path(samples)) for path in (result.reference, result.spline)
        ]
        found["clearance"] = {
            "before": number(apart[0]),
            "after": number(apart[1]),
            "measured_up_to": NEAR,
        }
    return found
