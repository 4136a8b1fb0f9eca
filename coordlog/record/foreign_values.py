"""Numbers of other people's environments: observations, actions, rewards and what else they say, as
rows; and the records that say what these rows are.
"""

from __future__ import annotations

import platform
import re
from collections.abc import Mapping
from typing import Any

import mujoco
import numpy as np

from coordlog.episode import Array, Header, Json
from coordlog.errors import SpecError
from coordlog.record.foreign_env import Subject
from coordlog.sim.foreign import SUBSTEPS, TASK, flat
from coordlog.spec import SCHEMA_VERSION
from coordlog.version import __version__

_FLOATS = frozenset({float, np.float64, np.float32})


def numbers(info: Mapping[str, Any]) -> dict[str, Array]:
    """The numbers of an info: scalars and short vectors, by name."""
    found = {}
    for said, value in info.items():
        key = re.sub(r"\W", "_", str(said), flags=re.ASCII)  # what a column may be called
        if not key or key in found:
            continue
        if isinstance(value, bool | np.bool_):
            found[key] = np.array(bool(value))
        elif isinstance(value, int | float | np.number):
            found[key] = np.array(float(value))
        elif isinstance(value, np.ndarray) and value.dtype.kind in "fiu" and value.ndim == 1:
            found[key] = value.astype(np.float64)
    return found


class Rows:
    """What some steps in a row saw, did, got and said, written in place."""

    def __init__(self, size: int, observation: Any) -> None:
        """Make room.

        Args:
            size: Steps.
            observation: What the policy sees before the first; None if it sees nothing.

        Raises:
            SpecError: if there is anything but numbers in it.
        """
        self._size = size
        self._seen: Array | None = None
        self._made: dict[str, Array] = {}
        self._said: list[tuple[Any, str, Array]] = []
        if observation is not None:
            first = flat(observation)
            self._seen = np.empty((size + 1, *first.shape), first.dtype)
            self._seen[0] = first

    def put(
        self, row: int, action: Any, reward: Any, observation: Any, info: Mapping[str, Any]
    ) -> None:
        """Write a step.

        Raises:
            SpecError: for values of another kind or number than before.
        """
        if not self._made:
            self._begin(action, reward, info)
        _put("action", self._made["action"], row, action)
        _put("reward", self._made["reward"], row, reward)
        if self._seen is not None:
            _put("state", self._seen, row + 1, observation)
        elif observation is not None:
            raise SpecError("observation: expected none, as before the first step, got one")
        for said, name, column in self._said:
            value = info.get(said)
            if type(value) in _FLOATS and column.ndim == 1 and column.dtype == np.float64:
                column[row] = value
            else:
                self._say(name, column, row, numbers({said: value}))

    def sound(self, first: int, stop: int) -> bool:
        """Whether all that some steps did, got, said and saw after them are numbers."""
        seen = self.seen(first + 1, stop + 1).get("state")
        values = [column[first:stop] for column in self._made.values()]
        return all(bool(np.isfinite(each).all()) for each in (*values, seen) if each is not None)

    def columns(self, first: int, stop: int) -> dict[str, Array]:
        """What holds after each of some steps."""
        return {name: column[first:stop] for name, column in self._made.items()}

    def seen(self, first: int, stop: int) -> dict[str, Array]:
        """What was seen before each of some steps; nothing, if nothing was."""
        if self._seen is None:
            return {}
        values = self._seen[first:stop]
        with np.errstate(over="ignore"):
            found = {"state": values.astype(np.float32)}
        return found | ({"observation": values} if values.dtype == np.float64 else {})

    def again(self, last: int) -> None:
        """Begin anew with what was seen after some steps."""
        if self._seen is not None:
            self._seen[0] = self._seen[last]

    def _begin(self, action: Any, reward: Any, info: Mapping[str, Any]) -> None:
        columns: dict[str, Array] = {
            "action": flat(action).astype(np.float32),
            "reward": flat(reward).astype(np.float64),
        }
        for said in info:
            for key, value in numbers({said: info[said]}).items():
                if f"info_{key}" not in columns:
                    columns[f"info_{key}"] = value
                    self._said.append((said, f"info_{key}", value))
        self._made = {
            name: np.empty((self._size, *value.shape), value.dtype)
            for name, value in columns.items()
        }
        self._said = [(said, name, self._made[name]) for said, name, _ in self._said]

    @staticmethod
    def _say(name: str, column: Array, row: int, said: Mapping[str, Array]) -> None:
        if not said:
            raise SpecError(
                f"info: expected the numbers of the first step, {name.removeprefix('info_')} is "
                "missing"
            )
        (value,) = said.values()
        lost = column.dtype == bool and (value.astype(bool) != value).any()
        if value.shape != column.shape[1:] or lost:
            raise _unlike(name, column, value)
        column[row] = value


def _put(name: str, column: Array, row: int, value: Any) -> None:
    if type(value) in _FLOATS and column.shape[1:] == (1,):
        column[row, 0] = value
        return
    if type(value) is not np.ndarray or value.shape != column.shape[1:]:
        value = flat(value)
        if value.shape != column.shape[1:]:
            raise _unlike(name, column, value)
    elif value.dtype.kind not in "fiub":
        flat(value)  # says so
    column[row] = value


def _unlike(name: str, column: Array, value: Any) -> SpecError:
    if np.shape(value) != column.shape[1:]:
        size = int(np.prod(column.shape[1:]))
        wanted = f"{size} value" + "s" * (size != 1)
        return SpecError(f"{name}: expected {wanted} as before, got {np.size(value)}")
    return SpecError(f"{name}: expected {column.dtype} as in the first step, got {value}")


def odd(columns: Mapping[str, Array]) -> tuple[int, SpecError] | None:
    """The first step at which something is no number, and what is to be said of it."""
    found: tuple[int, SpecError] | None = None
    for name, values in columns.items():
        if values.dtype.kind != "f" or np.isfinite(values).all():
            continue
        bad = ~np.isfinite(values).reshape(len(values), -1).all(axis=1)
        step = int(np.flatnonzero(bad)[0])
        if found is None or step < found[0]:
            found = step, SpecError(f"{name}: expected numbers, got NaN or infinity")
    return found


def header_of(subject: Subject, first: Mapping[str, Array], about: Json) -> Header:
    """What a file says of itself.

    Args:
        subject: What is simulated.
        first: Columns of the first steps.
        about: What is known of the episode (`EpisodeLog`).
    """
    row = {name: values[0] for name, values in first.items()}
    model = subject.model
    widths = {name: row[name].size for name in ("state", "action", "reward")}
    heads = list(about.get("heads") or ("reward",))
    if len(heads) != widths["reward"]:
        heads = [f"reward_{i}" for i in range(widths["reward"])]
    period = int(row[SUBSTEPS]) * float(model.opt.timestep) or float(model.opt.timestep)
    fields = [_field(SUBSTEPS, "int32", "", "after")]
    if "observation" in row:
        fields.insert(0, _field("observation", "float64", str(row["observation"].size), "before"))
    for name, value in row.items():
        if name.startswith("info_"):
            kind = {"f": "float64", "b": "bool", "i": "int64"}[value.dtype.kind]
            fields.append(_field(name, kind, str(value.size) if value.ndim else "", "after"))
    env = {
        "coordlog_version": __version__,
        "mujoco_version": mujoco.__version__,
        "architecture": platform.machine(),
        "task": {**about.get("task", {}), "name": TASK, "fields": fields},
        "reward": {},
        "config": {},
        "robot": {"name": about["episode"]["robot"]},
        **subject.names,
        "arms": {head: list(range(widths["action"])) for head in heads},
        "action_joints": [f"action_{i}" for i in range(widths["action"])],
        "state": [f"state_{i}" for i in range(widths["state"])],
        **_range(about, widths["action"]),
        "layout": {
            "n_q": model.nq,
            "n_v": model.nv,
            "n_x": widths["state"],
            "n_u": widths["action"],
            "k": widths["reward"],
            "n_c": model.nu,
        },
    }
    episode = {
        "schema_version": SCHEMA_VERSION,
        "kind": "simulated",
        "split": "",
        "seed": None,
        "index": 0,
        "start": "",
        "control_period": period,
        "goals": [],
        "obstacles": [],
        **about["episode"],
    }
    policy = {"kind": "", "name": "", "checkpoint_sha256": "", "noise": {}}
    return Header(episode, env, {**policy, **about.get("policy", {})})


def _range(about: Json, n_u: int) -> Json:
    """Least and greatest of each action, where the environment says them."""
    low, high = about.get("actions") or ((), ())
    if not len(low) == len(high) == n_u:
        return {}
    return {"action_low": list(low), "action_high": list(high)}


def _field(name: str, kind: str, size: str, when: str) -> Json:
    return {"name": name, "type": kind, "size": size, "unit": "", "when": when}
