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
from coordlog.mjcf import actuator_label
from coordlog.sim.env import hinges
from coordlog.sim.foreign import SUBSTEPS, TASK
from coordlog.spec import SCHEMA_VERSION
from coordlog.version import __version__


def flat(value: Any) -> Array:
    """An observation, action or reward as one row of numbers; parts of a mapping in the order of
    their names.

    Raises:
        SpecError: if there is anything but numbers in it.
    """
    if isinstance(value, Mapping):
        return np.concatenate([flat(value[key]) for key in sorted(value)])
    if isinstance(value, tuple):
        return np.concatenate([flat(each) for each in value])
    array = np.asarray(value)
    if array.dtype.kind not in "fiub":
        raise SpecError(
            f"expected numbers in observation, action and reward, got {type(value).__name__}"
        )
    return np.atleast_1d(array).ravel()


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


def count(like: tuple[Any, tuple[int, ...]] | None) -> str:
    """How many values there are in what had a type and a shape, in words."""
    size = 0 if like is None else int(np.prod(like[1]))
    return f"{size} value" + "s" * (size != 1)


def header_of(model: mujoco.MjModel, row: Mapping[str, Array], about: Json) -> Header:
    """What a file says of itself.

    Args:
        model: What is simulated.
        row: The first step.
        about: What is known of the episode (`EpisodeLog`).
    """
    widths = {name: row[name].size for name in ("state", "action", "reward")}
    heads = list(about.get("heads") or ("reward",))
    if len(heads) != widths["reward"]:
        heads = [f"reward_{i}" for i in range(widths["reward"])]
    period = int(row[SUBSTEPS]) * float(model.opt.timestep) or float(model.opt.timestep)
    fields = [_field(SUBSTEPS, "int32", "", "physics steps that the step made", "after")]
    if "observation" in row:
        fields.insert(
            0, _field("observation", "float64", str(row["observation"].size), "", "before")
        )
    for name, value in row.items():
        if name.startswith("info_"):
            kind = {"f": "float64", "b": "bool", "i": "int64"}[value.dtype.kind]
            fields.append(_field(name, kind, str(value.size) if value.ndim else "", "", "after"))
    env = {
        "coordlog_version": __version__,
        "mujoco_version": mujoco.__version__,
        "architecture": platform.machine(),
        "task": {**about.get("task", {}), "name": TASK, "fields": fields},
        "reward": {},
        "config": {},
        "robot": {"name": about["episode"]["robot"]},
        "joints": hinges(model),
        "actuators": [actuator_label(model, i) for i in range(model.nu)],
        "geoms": [model.geom(i).name or f"geom {i}" for i in range(model.ngeom)],
        "arms": {head: list(range(widths["action"])) for head in heads},
        "action_joints": [f"action_{i}" for i in range(widths["action"])],
        "state": [f"state_{i}" for i in range(widths["state"])],
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


def _field(name: str, kind: str, size: str, unit: str, when: str) -> Json:
    return {
        "name": name,
        "type": kind,
        "size": size,
        "unit": unit if len(unit) < 8 else "",
        "when": when,
    }
