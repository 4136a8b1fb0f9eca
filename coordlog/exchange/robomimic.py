"""robomimic HDF5: one file `data.hdf5`, a group `data/demo_i` per episode.

T rows each: `obs/…` before the action, `next_obs/…` after it, so that the final state is the last
row of `next_obs`. `states` is MuJoCo's time, qpos and qvel before the action, as robosuite flattens
them; the final one is the attribute `final_state`. `rewards` is the sum over the arms; what else an
action led to stands under its own name. `mask/SPLIT` lists the demos of each split.

Source: robomimic 0.3.0, utils/dataset.py.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from coordlog.episode import Array, Json
from coordlog.exchange import cameras, hdf5
from coordlog.exchange.blocks import Block, Options
from coordlog.exchange.columns import Column, columns
from coordlog.exchange.source import Loaded

_GYM = 2
"""robomimic's number for "a Gym environment": the kind that promises least."""


def write_block(block: Block) -> Json:
    """One HDF5 file with the demos of a block."""
    groups, splits, steps = [], [], 0
    env: Json = {}
    with hdf5.created(hdf5.part(block.folder, block.number)) as file:
        for number, loaded in enumerate(block.loaded(), block.first_episode):
            name = f"demo_{number}"
            demo = file.create_group(name, track_order=True)
            hdf5.put(demo, _datasets(loaded, block.options))
            last = _states(columns(loaded.episode))[-1]
            attributes: Json = {"num_samples": len(loaded.episode), "final_state": last}
            attributes["model_file"] = loaded.model_text
            attributes |= loaded.named()
            hdf5.describe(demo, attributes)
            groups.append(name)
            splits.append(loaded.provenance["split"])
            steps += len(loaded.episode)
            env = env or _env(loaded)
    return {
        "number": block.number,
        "groups": groups,
        "steps": steps,
        "env": env,
        "splits": splits,
    }


def assemble(folder: Path, journals: Sequence[Json], options: Options) -> None:
    """Gather the demos below `data` and list the splits below `mask`."""
    with hdf5.created(folder / "data.hdf5") as whole:
        data = whole.create_group("data", track_order=True)
        hdf5.gather(folder, journals, data)
        hdf5.describe(
            data,
            {
                "total": sum(journal["steps"] for journal in journals),
                "env_args": json.dumps(journals[0]["env"]),
            },
        )
        masks: dict[str, list[str]] = {}
        for journal in journals:
            for name, split in zip(journal["groups"], journal["splits"], strict=True):
                masks.setdefault(split or "all", []).append(name)
        for split, names in sorted(masks.items()):
            hdf5.put(whole, {f"mask/{split}": np.array(names, dtype="S")})


def _datasets(loaded: Loaded, options: Options) -> dict[str, Array]:
    known = columns(loaded.episode)
    length = len(loaded.episode)
    found: dict[str, Array] = {"states": _states(known)[:-1]}
    found["actions"] = known["action"].values if "action" in known else np.zeros((length, 0))
    reward = known["reward"].values.sum(axis=1) if "reward" in known else np.zeros(length)
    found["rewards"] = reward
    found["dones"] = known["terminated"].values | known["truncated"].values
    observed = {name: item.values for name, item in known.items() if item.before and name != "time"}
    if options.cameras:
        images = list(cameras.frames(loaded, options))
        for camera in options.cameras:
            shown = cameras.split(camera)[1]
            key = f"{cameras.label(camera)}_image" if shown == "rgb" else cameras.label(camera)
            observed[key] = np.stack([each[camera] for each in images])
    for name, values in observed.items():
        found[f"obs/{name}"], found[f"next_obs/{name}"] = values[:-1], values[1:]
    for name, item in known.items():
        if not item.before and name != "action":
            found["reward_of_each_arm" if name == "reward" else name] = item.values
    return found


def _states(known: dict[str, Column]) -> Array:
    parts = [known[name].values for name in ("time", "qpos", "qvel") if name in known]
    return np.concatenate([part.reshape(len(part), -1) for part in parts], axis=1)


def _env(loaded: Loaded) -> Json:
    """Robomimic wants to know an environment; ours is rebuilt from the log, not by name."""
    origin = loaded.provenance
    return {
        "env_name": f"coordlog-{origin['scene'] or origin['robot']}",
        "type": _GYM,
        "env_version": origin["coordlog_version"],
        "env_kwargs": {},
    }
