"""A smoothed path executed: driven through the simulation from the episode's own first state, and
judged by what happened there.

What the servos follow is the path plus the smoothed difference between the servo targets of the raw
run and the angles it reached. The smoother is linear: the same operator on the difference keeps the
sag under gravity compensated as it was. Targets become actions by inverting the command filter;
what an action in [-1, 1] cannot do is caught up with at the next one.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from coordlog.episode import Array, Episode
from coordlog.path import Path
from coordlog.sim.replay import Log, bound_task
from coordlog.sim.tracking import Drive, Run, run, targets, torques
from coordlog.smooth.blending import grid_for
from coordlog.smooth.metrics import torque_peak, torque_rate
from coordlog.smooth.result import FALLBACK, RAW_INFEASIBLE, Result

DEEPER = 1e-4
"""Contacts of the raw run may be deeper by this much [m] in the smoothed one and still count as the
same."""
TRIM = 0.3
"""Share of the remaining error by which the servo targets are moved at each step, once the path has
come to its end."""
COAST = 10
"""Steps over which the log's last motion is then added, if it ended at its goal and this run has
not: the log arrived moving, and with a base that swayed as its own did, so the same angles at rest
can be a fraction of a millimetre short."""


class Torques(NamedTuple):
    """How hard the servos of the action joints work."""

    rate: float
    """Root mean square over time of |Δτ| / Δt between control steps [Nm/s]."""
    peak: float
    """Largest |τ| of any action joint [Nm]."""

    @classmethod
    def of(cls, torque: Array, period: float) -> Torques:
        """Of torques (T, n_u) at the end of each control step; a single step has no rate."""
        return cls(torque_rate(torque, period) if len(torque) > 1 else 0.0, torque_peak(torque))


class Execution(NamedTuple):
    """Result of executing the smoothed path."""

    status: str
    """As of `Result`; kept_raw where the execution was worse than the raw run."""
    reason: str
    run: Run | None
    """The execution; None where the raw run stands."""
    raw: Torques
    smoothed: Torques | None
    """None where nothing was executed."""
    away: float
    """Largest distance of an executed angle from the path at the same time [rad].

    0 where nothing was executed.
    """


def execute(log: Log, result: Result, episode: Episode) -> Execution:
    """Drive a smoothed path through the simulation and decide whether it or the raw run stands.

    Args:
        log: Model, first state and actions of the episode.
        result: What smoothing its measured joint angles gave.
        episode: The raw run.

    Raises:
        FormatError: if the log's first state does not fit its model.
    """
    task, wanted = bound_task(log), targets(log)
    period = task.config.control_period
    raw = Torques.of(logged_torques(log, episode, wanted), period)
    if result.status == FALLBACK or not result.lam.any():
        return Execution(result.status, result.reason, None, raw, None, 0.0)
    angles = episode.qpos[:, task.qpos_index]
    ran = follow(log, result, angles, wanted=wanted, arrives=episode.result.success)
    smoothed = Torques.of(ran.torque, period)
    away = _away(ran, result.spline, task.qpos_index)
    failure = worse(ran, episode)
    if not failure:
        return Execution(result.status, result.reason, ran, raw, smoothed, away)
    status = RAW_INFEASIBLE if result.status == RAW_INFEASIBLE else FALLBACK
    return Execution(status, f"the smoothed path, executed, {failure}", None, raw, smoothed, away)


def logged_torques(log: Log, episode: Episode, wanted: Array) -> Array:
    """Torques of the action joints at the end of each logged step, (T, n_u) [Nm].

    A file of version 1 has none: there its physics is stepped through once more.

    Args:
        log: Model and first state.
        episode: The log, with a `torque` of every actuator or without.
        wanted: Servo targets before each action and after the last, (T + 1, n_u) [rad].
    """
    logged = getattr(episode, "torque", None)
    if logged is None or not np.size(logged):
        return torques(log, wanted)
    return np.asarray(logged[:, bound_task(log).servos], dtype=np.float64)


def follow(
    log: Log, result: Result, angles: Array, *, arrives: bool, wanted: Array | None = None
) -> Run:
    """Execute a path, whatever comes of it.

    Args:
        log: The episode it was smoothed from.
        result: The path.
        angles: Reference angles of the action joints, (T + 1, n_u) [rad].
        arrives: Whether the raw run ended at its goal.
        wanted: Servo targets of the raw run, (T + 1, n_u), if they are known already; their lead
            over the angles is kept.

    Raises:
        FormatError: if the log's first state does not fit its model.
    """
    task, wanted = bound_task(log), targets(log) if wanted is None else wanted
    period, last = task.config.control_period, result.spline.time[-1]
    lead = _lead(result, np.arange(len(angles)) * period, wanted - angles)
    low, high = task.limits.T
    trim = np.zeros(len(low))
    coast = (angles[-1] - angles[-2]) * arrives
    time = np.minimum((np.arange(len(angles)) + 1) * period, last)
    path = result.spline(time)
    ahead, at_rest = np.clip(path + lead(time), low, high), path[-1] + lead(last)

    def act(step: int, drive: Drive) -> Array:
        nonlocal trim
        now = min(step, len(time) - 1)
        if step * period < last:
            return drive.action_to(ahead[now])
        # Friction, and what the raw run's motion added to its lead, would stay as an error.
        share = min((step - len(angles) + 2) / COAST, 1.0)
        trim = trim + TRIM * (path[-1] + share * coast - drive.angles)
        return drive.action_to(np.clip(at_rest + trim, low, high))

    return run(log, act)


def worse(ran: Run, episode: Episode) -> str:
    """In which way an execution is worse than the raw run, as the rest of a sentence.

    "" if in none.
    """
    columns = ran.columns
    if ran.diverged:
        return "makes the physics diverge"
    if columns["instability"].any() and not episode.instability.any():
        return (
            f"loses its balance at {columns['time'][int(columns['instability'].argmax())]:.2f} s, "
            "which the log does not"
        )
    if columns["collision"].any():
        step, names = int(columns["collision"].argmax()), episode.header.env["geoms"]
        deepest = ran.contacts[ran.contacts["depth"].argmax()]
        pair = f"{names[deepest['geom1']]} and {names[deepest['geom2']]}"
        if not episode.collision.any():
            return (
                f"collides at {columns['time'][step]:.2f} s ({pair}, {deepest['depth'] * 1e3:.1f} "
                "mm deep), which the log does not"
            )
        if (
            deepest["depth"] > episode.contacts["depth"].max() + DEEPER
            or columns["collision"].sum() > episode.collision.sum()
        ):
            return f"collides more than the log does ({pair}, {deepest['depth'] * 1e3:.1f} mm deep)"
    if episode.result.success and not columns["goal"][-1].all():
        nearest = columns["distance"][-1].max()
        return (
            f"no longer reaches the goal, which the log does (a palm ends {nearest * 1e3:.1f} mm "
            "from it)"
        )
    return ""


def _lead(result: Result, time: Array, ahead: Array) -> Path:
    """How far the targets are ahead of the angles, (T + 1, n_u) at `time`, smoothed as the path
    was.
    """
    knots = result.knots
    at_knots = np.stack([np.interp(knots.time, time, column) for column in ahead.T], axis=1)
    ends = np.zeros((2, ahead.shape[1])) if result.config.clamped else None
    return grid_for(knots.time, result.config, blend=result.blend).fit_each(
        at_knots, lam=result.lam, weight=result.weight, velocity=ends
    )


def _away(ran: Run, path: Path, places: Array) -> float:
    time = ran.columns["time"]
    return float(
        np.abs(
            ran.columns["qpos"][:, places] - path(np.clip(time, path.time[0], path.time[-1]))
        ).max()
    )
