"""Minari data sets in HDF5, written with h5py alone: T actions through T + 1 observations.

`observations` is the policy's state with the final one as its last row. `infos` have T + 1 rows, as
Minari's come with the observation they were returned with: positions, velocities and time as they
are; what an action led to from row 1 on, and nothing (NaN, false) in row 0, which no action led to.
`rewards` is the sum over the arms; each arm's stands in `infos/reward`. An episode's origin is in
the attributes of its group, `coordlog.…`.

The folder is a Minari root: `MINARI_DATASETS_PATH=OUT`, data set `coordlog/NAME-v0`.

Source: minari 0.5.4, dataset/_storages/hdf5_storage.py.
"""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from coordlog.episode import Array, Json
from coordlog.exchange import hdf5
from coordlog.exchange.blocks import Block, Options
from coordlog.exchange.columns import columns
from coordlog.exchange.source import Loaded

VERSION = "0.5.4"
"""Of Minari, whose layout this is."""
NAMESPACE = "coordlog"


def write_block(block: Block) -> Json:
    """One HDF5 file with the groups of a block's episodes."""
    groups, steps = [], 0
    about: Json = {}
    with hdf5.created(hdf5.part(block.folder, block.number)) as file:
        for number, loaded in enumerate(block.loaded(), block.first_episode):
            name = f"episode_{number}"
            group = file.create_group(name, track_order=True)
            episode = loaded.episode
            known = columns(episode)
            state = known["state"] if "state" in known else known["qpos"]
            action = known["action"].values if "action" in known else np.zeros((len(episode), 0))
            reward = known["reward"].values.sum(axis=1) if "reward" in known else None
            values = {
                "observations": state.values,
                "actions": action,
                "rewards": np.zeros(len(episode)) if reward is None else reward,
                "terminations": known["terminated"].values,
                "truncations": known["truncated"].values,
            }
            hdf5.put(group, values | _infos(loaded))
            attributes: Json = {"id": number, "total_steps": len(episode)}
            if loaded.provenance["seed"] >= 0:
                attributes["seed"] = loaded.provenance["seed"]
            attributes |= loaded.named()
            hdf5.describe(group, attributes)
            groups.append(name)
            steps += len(episode)
            about = about or _about(loaded, state.values, action)
    return {"number": block.number, "groups": groups, "steps": steps, "about": about}


def assemble(folder: Path, journals: Sequence[Json], options: Options) -> None:
    """Gather the groups in main_data.hdf5; write the metadata of data set and namespace."""
    about = journals[0]["about"]
    name = f"{NAMESPACE}/{about['name']}-v0"
    data = folder / name / "data"
    with hdf5.created(data / "main_data.hdf5") as whole:
        hdf5.gather(folder, journals, whole)
    size = (data / "main_data.hdf5").stat().st_size
    metadata = {
        "total_episodes": sum(len(journal["groups"]) for journal in journals),
        "total_steps": sum(journal["steps"] for journal in journals),
        "data_format": "hdf5",
        "jpeg_encoding": False,
        "observation_space": about["observation_space"],
        "action_space": about["action_space"],
        "dataset_id": name,
        "algorithm_name": about["policy"],
        "author": ["coordlog"],
        "description": about["description"],
        "requirements": [f"mujoco=={about['mujoco_version']}"] if about["mujoco_version"] else [],
        "minari_version": VERSION,
        "dataset_size": round(size / 1e6, 1),
    }
    (data / "metadata.json").write_text(json.dumps(metadata) + "\n", "utf-8")
    (folder / NAMESPACE / "namespace_metadata.json").write_text("{}\n", "utf-8")


def _infos(loaded: Loaded) -> dict[str, Array]:
    found = {}
    for item in columns(loaded.episode).values():
        if item.name in ("state", "action", "terminated", "truncated"):
            continue
        values = item.values
        if not item.before:
            blank = np.nan if values.dtype.kind == "f" else 0
            first = np.full((1, *values.shape[1:]), blank).astype(values.dtype)
            values = np.concatenate([first, values])
        found[f"infos/{item.name}"] = values
    return found


def _about(loaded: Loaded, state: Array, action: Array) -> Json:
    origin = loaded.provenance
    what = origin["scene"] or origin["robot"] or "logs"
    return {
        "name": re.sub(r"[^a-z0-9]+", "-", what.lower()).strip("-") or "logs",
        "observation_space": _box(state, None),
        "action_space": _box(action, (-1.0, 1.0) if origin["kind"] == "simulated" else None),
        "policy": origin["policy"] or "unknown",
        "mujoco_version": origin["mujoco_version"],
        "description": (
            f"Episodes of {origin['robot']} in {origin['scene']}, exported by coordlog "
            f"{origin['coordlog_version']}. rewards = sum over the arms; row 0 of what an action "
            "led to (infos) is blank."
        ),
    }


def _box(values: Array, limits: tuple[float, float] | None) -> str:
    """A Gymnasium Box as Minari's JSON text."""
    low, high = limits or (-np.inf, np.inf)
    width = values.shape[1]
    space = {
        "type": "Box",
        "dtype": str(values.dtype),
        "shape": [width],
        "low": [low] * width,
        "high": [high] * width,
    }
    return json.dumps(space)
