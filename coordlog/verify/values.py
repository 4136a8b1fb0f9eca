"""Whether what an episode says is consistent: everything that can be recomputed from the log is
recomputed and compared.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict

import numpy as np

from coordlog.episode import KINDS, Array, Episode
from coordlog.record.tally import Tally, task_here
from coordlog.sim.foreign import TASK
from coordlog.spec import after, names
from coordlog.tasks.registry import follow, is_installed
from coordlog.verify.finding import Problem

DIVERGED = "diverged"
"""An abort for this reason may leave values that are not finite in the last step's outcome."""


def content(episode: Episode) -> Iterator[Problem]:
    """What is not consistent in an episode; at most the first step of each field."""
    yield from _shapes(episode)
    yield from _times(episode)
    yield from _values(episode)
    yield from _task(episode)
    yield from _endings(episode)
    yield from _contacts(episode)
    yield from _path(episode)
    yield from _result(episode)


def _shapes(episode: Episode) -> Iterator[Problem]:
    header, layout = episode.header, episode.header.layout
    counts = {
        "arms": (layout.k, len(header.arms)),
        "action_joints": (layout.n_u, len(header.env.get("action_joints", ()))),
        "state": (layout.n_x, len(header.env.get("state", ()))),
        "goals": (layout.k, len(header.episode.get("goals", ()))),
    }
    if header.task == TASK:  # goals are those of our own tasks
        del counts["goals"]
    for name, (wanted, got) in counts.items():
        if wanted != got:
            yield Problem(None, f"metadata {name}", f"{wanted} entries", f"{got}")


def _times(episode: Episode) -> Iterator[Problem]:
    period = episode.header.episode["control_period"]
    if episode.header.kind != KINDS[0] or episode.header.task == TASK:
        return
    yield from _first("time", np.arange(len(episode) + 1) * period, episode.time)


def _values(episode: Episode) -> Iterator[Problem]:
    """Everything finite; of diverged physics all but the outcome of the last action.

    Simulated actions within [-1, 1].
    """
    diverged = episode.result.aborted.startswith(DIVERGED)
    for name, values in episode.columns.items():
        if values.dtype.kind != "f" or name == "time":
            continue
        if diverged and name != "action":
            values = values[:-1]
        yield from _broken(name, "finite values", values, ~np.isfinite(values))
    if episode.header.task == TASK or episode.header.kind != KINDS[0]:
        return
    yield from _broken("action", "values in [-1, 1]", episode.action, np.abs(episode.action) > 1)


def _task(episode: Episode) -> Iterator[Problem]:
    """What the task makes of what was measured, where it is installed."""
    task, own = task_here(episode.header), names(after(episode.header.task_fields))
    if task is None and is_installed(episode.header.task):
        known = f"constants that the task '{episode.header.task}' knows"
        yield Problem(None, "metadata coordlog.env", known, "others")
    if task is None or not all(map(episode.has, own)):
        return
    wanted = follow(task, {name: episode.columns[name] for name in own})
    for name in (*own, "reward", "terminated"):
        yield from _first(name, wanted[name], episode.columns[name])


def _endings(episode: Episode) -> Iterator[Problem]:
    """The task ends at its first ending, for one reason; an episode that has none was aborted."""
    limit = episode.header.env["config"].get("max_steps", len(episode))
    last = len(episode) - 1
    ended = episode.terminated | episode.truncated
    for step in np.flatnonzero(ended[:-1])[:1].tolist():
        yield Problem(step, "terminated", "no step after the episode ended", f"{last - step} more")
    for step in np.flatnonzero(episode.terminated & episode.truncated)[:1].tolist():
        yield Problem(step, "truncated", "terminated or truncated, not both", "both")
    if not episode.result.aborted and (last < 0 or not ended[last]):
        yield Problem(
            max(last, 0),
            "terminated",
            "an ending at the last step, or a reason why it was aborted",
            "neither",
        )
    if len(episode) > limit:
        yield Problem(limit, "step", f"at most {limit} steps", f"{len(episode)}")


def _contacts(episode: Episode) -> Iterator[Problem]:
    rows, geoms = episode.contacts, len(episode.header.env.get("geoms", ()))
    inside = (rows["step"] >= 0) & (rows["step"] < len(episode))
    for step in rows["step"][~inside][:1].tolist():
        yield Problem(step, "contacts", f"steps 0 to {len(episode) - 1}", f"{step}")
    touching = np.zeros(len(episode), bool)
    touching[rows["step"][inside]] = True
    if episode.has("collision"):
        yield from _first("collision", touching, episode.collision)
    wrong = (
        ~(rows["depth"] >= 0)
        | (rows["substep"] < 0)
        | (rows["geom1"] < 0)
        | (rows["geom1"] >= rows["geom2"])
    )
    wrong |= (rows["geom2"] >= geoms) if geoms else False
    wrong |= ~np.isfinite(np.stack([rows[name] for name in ("depth", "x", "y", "z")], axis=1)).all(
        axis=1
    )
    for row in rows[wrong][:1]:
        yield Problem(
            int(row["step"]), "contacts", f"depth ≥ 0, geom1 < geom2 < {geoms}, finite", f"{row}"
        )


def _path(episode: Episode) -> Iterator[Problem]:
    if episode.path is None:
        return
    for name, values in vars(episode.path).items():
        if name == "knot_weight":
            bad = ~(values > 0)
        elif values.ndim == 1:
            bad = ~np.isfinite(values) | (np.diff(values, prepend=-np.inf) <= 0)
        else:
            bad = ~np.isfinite(values)
        if bad.any():
            yield Problem(
                None,
                f"path {name}",
                "finite, times increasing, weights positive",
                f"{values[bad][0]}",
            )


def _result(episode: Episode) -> Iterator[Problem]:
    tally = Tally(episode.header)
    if len(episode):
        tally.add({name: values[: len(episode)] for name, values in episode.columns.items()})
    tally.add_states({"qpos": episode.qpos[-1:], "qvel": episode.qvel[-1:]})
    wanted, got = asdict(tally.result(episode.result.aborted)), asdict(episode.result)
    for name, value in wanted.items():
        if repr(value) != repr(got[name]):  # repr: NaN equals NaN
            yield Problem(None, f"result {name}", repr(value), repr(got[name]))


def _first(field: str, wanted: Array, got: Array) -> Iterator[Problem]:
    """The first step at which two columns differ; NaN equals NaN."""
    wanted = wanted.astype(got.dtype, copy=False)
    same = wanted == got
    if got.dtype.kind == "f":
        same |= np.isnan(wanted) & np.isnan(got)
    for row in np.argwhere(~same)[:1].tolist():
        yield Problem(row[0], _element(field, row), str(wanted[tuple(row)]), str(got[tuple(row)]))


def _broken(field: str, rule: str, values: Array, bad: Array) -> Iterator[Problem]:
    """The first step at which a column breaks a rule."""
    for row in np.argwhere(bad)[:1].tolist():
        yield Problem(row[0], _element(field, row), rule, str(values[tuple(row)]))


def _element(field: str, row: list[int]) -> str:
    return field if len(row) == 1 else f"{field}[{row[1]}]"
