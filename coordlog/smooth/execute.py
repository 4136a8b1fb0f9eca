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
from coordlog.sim.replay import Log, task_of
from coordlog.sim.tracking import Drive, Run, run, targets
from coordlog.smooth.ease import grid_for
from coordlog.smooth.metrics import torque_peak, torque_rate
from coordlog.smooth.result import KEPT_RAW, RAW_INFEASIBLE, Result

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
    """Largest |τ| [Nm]."""

    @classmethod
    def of(cls, ran: Run, period: float) -> Torques:
        """Of a run with this control period [s]; a single step has no rate."""
        return cls(
            torque_rate(ran.torque, period) if len(ran.torque) > 1 else 0.0, torque_peak(ran.torque)
        )


class Execution(NamedTuple):
    """What stands after the path was tried."""

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
    task, period = task_of(log), task_of(log).config.control_period
    again = run(log, lambda step, _: log.action[step], steps=len(log.action))
    raw = Torques.of(again, period)
    if result.status == KEPT_RAW or not result.lam.any():
        return Execution(result.status, result.reason, None, raw, None, 0.0)
    ran = follow(log, result, episode.qpos[:, task.qpos_index], arrives=episode.result.success)
    smoothed, away = Torques.of(ran, period), _away(ran, result.spline, task.qpos_index)
    failure = worse(ran, episode)
    if not failure:
        return Execution(result.status, result.reason, ran, raw, smoothed, away)
    status = RAW_INFEASIBLE if result.status == RAW_INFEASIBLE else KEPT_RAW
    return Execution(status, f"the smoothed path, executed, {failure}", None, raw, smoothed, away)


def follow(log: Log, result: Result, angles: Array, *, arrives: bool) -> Run:
    """Execute a path without judging it.

    Args:
        log: The episode it was smoothed from; its actions tell the servo targets of the raw run.
        result: The path.
        angles: Raw angles of the action joints, (T + 1, n_u) [rad].
        arrives: Whether the raw run ended at its goal.

    Raises:
        FormatError: if the log's first state does not fit its model.
    """
    task = task_of(log)
    period, last = task.config.control_period, result.spline.time[-1]
    lead = _lead(result, np.arange(len(angles)) * period, targets(log) - angles)
    low, high = task.limits.T
    trim = np.zeros(len(low))
    coast = (angles[-1] - angles[-2]) * arrives

    def act(step: int, drive: Drive) -> Array:
        nonlocal trim
        at = min((step + 1) * period, last)
        if (
            step * period >= last
        ):  # friction, and what the raw run's motion added to its lead, would stay as an error
            share = min((step - len(angles) + 2) / COAST, 1.0)
            trim = trim + TRIM * (result.spline(last) + share * coast - drive.angles)
        return drive.action_to(np.clip(result.spline(at) + lead(at) + trim, low, high))

    return run(log, act)


def worse(ran: Run, episode: Episode) -> str:
    """In which way an execution is worse than the raw run, as the rest of a sentence.

    "" if in none.
    """
    columns = ran.columns
    if ran.diverged:
        return "makes the physics diverge"
    if columns["instability"].any() and not episode.instability.any():
        return f"loses its balance at {columns['time'][int(columns['instability'].argmax())]:.2f} s, which the log does not"
    if columns["collision"].any():
        step, names = int(columns["collision"].argmax()), episode.header.env["geoms"]
        deepest = ran.contacts[ran.contacts["depth"].argmax()]
        pair = f"{names[deepest['geom1']]} and {names[deepest['geom2']]}"
        if not episode.collision.any():
            return f"collides at {columns['time'][step]:.2f} s ({pair}, {deepest['depth'] * 1e3:.1f} mm deep), which the log does not"
        if (
            deepest["depth"] > episode.contacts["depth"].max() + DEEPER
            or columns["collision"].sum() > episode.collision.sum()
        ):
            return f"collides more than the log does ({pair}, {deepest['depth'] * 1e3:.1f} mm deep)"
    if episode.result.success and not columns["goal"][-1].all():
        nearest = columns["distance"][-1].max()
        return f"no longer reaches the goal, which the log does (a palm ends {nearest * 1e3:.1f} mm from it)"
    return ""


def _lead(result: Result, time: Array, ahead: Array) -> Path:
    """How far the targets are ahead of the angles, (T + 1, n_u) at `time`, smoothed as the path
    was.
    """
    knots = result.knots
    at_knots = np.stack([np.interp(knots.time, time, column) for column in ahead.T], axis=1)
    ends = np.zeros((2, ahead.shape[1])) if result.config.clamped else None
    return grid_for(knots.time, result.config, ease=result.ease).fit_each(
        at_knots, lam=result.lam, weight=result.weight, velocity=ends
    )


def _away(ran: Run, path: Path, places: Array) -> float:
    time = ran.columns["time"]
    return float(
        np.abs(
            ran.columns["qpos"][:, places] - path(np.clip(time, path.time[0], path.time[-1]))
        ).max()
    )
