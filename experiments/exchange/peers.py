"""LeRobot and robomimic themselves on sets that `coordlog export` wrote.

Both bring torch, several gigabytes with CUDA, and LeRobot wants Python 3.12: neither is part of the
tests. Make an environment for each and say how its Python is run:

    python3.12 -m venv .peers/lerobot && .peers/lerobot/bin/pip install "lerobot[dataset]==0.6.1"
    python -m experiments.exchange.peers lerobot LOGS --python .peers/lerobot/bin/python

    python -m venv .peers/robomimic
    .peers/robomimic/bin/pip install robomimic==0.3.0 six matplotlib
    python -m experiments.exchange.peers robomimic LOGS --python .peers/robomimic/bin/python

LeRobot loads the set, selects episodes by our own column, deletes, splits, merges, computes its
statistics anew and appends an episode; robovet looks at every set before and after. robomimic reads
ours through SequenceDataset. Both compare what they read with the log, bit for bit.
"""

from __future__ import annotations

import argparse
import os
import shlex
import subprocess
import tempfile
from pathlib import Path

import numpy as np

import coordlog
from coordlog.exchange.blocks import Options, export
from coordlog.exchange.source import entries

LEROBOT = """
import sys
from pathlib import Path

import lerobot
import numpy as np
import torch
from lerobot.datasets.dataset_tools import (
    delete_episodes, merge_datasets, recompute_stats, split_dataset,
)
from lerobot.datasets.lerobot_dataset import LeRobotDataset

work = Path(sys.argv[1])
root = work / "set"
log = np.load(work / "log.npz")
print("lerobot", lerobot.__version__, "torch", torch.__version__, "python", sys.version.split()[0])

def rows(dataset, key):
    return np.stack([np.asarray(dataset[i][key]) for i in range(len(dataset))])

whole = LeRobotDataset("local/ours", root=root)
assert rows(whole, "observation.state").tobytes() == log["state"].tobytes()
assert rows(whole, "action").tobytes() == log["action"].tobytes()
print("loads:", whole.num_episodes, "episodes,", len(whole), "frames, state and action the log's")
chosen = LeRobotDataset(
    "local/ours", root=root, episode_filter=lambda row: row["coordlog/seed"] == int(log["seed"])
)
assert len(chosen) == int(log["length"])
print("selects by coordlog/seed:", len(chosen), "frames")
near = LeRobotDataset("local/ours", root=root, delta_timestamps={"action": [0.0, 1 / whole.fps]})
assert near[0]["action"].shape[0] == 2
print("delta_timestamps:", tuple(near[0]["action"].shape))
less = delete_episodes(whole, episode_indices=[0], output_dir=work / "less", repo_id="local/less")
assert less.num_episodes == whole.num_episodes - 1
print("deletes:", less.num_episodes, "episodes left")
parts = split_dataset(whole, splits={"train": [0], "test": list(range(1, whole.num_episodes))},
                      output_dir=work / "parts")
print("splits:", {name: part.num_episodes for name, part in parts.items()})
again = merge_datasets(list(parts.values()), output_repo_id="local/again", output_dir=work / "again")
assert rows(again, "observation.state").tobytes() == log["state"].tobytes()
print("merges:", again.num_episodes, "episodes, the log's state again")
recompute_stats(again)
print("recomputes statistics")
more = LeRobotDataset.resume("local/ours", root=root)
own = ("timestamp", "frame_index", "episode_index", "index", "task_index")
for i in range(int(log["length"])):
    item = whole.hf_dataset[i]
    frame = {
        key: np.asarray(item[key], feature["dtype"]).reshape(feature["shape"])
        for key, feature in whole.features.items() if key not in own
    }
    more.add_frame(frame | {"task": "again"})
more.save_episode()
more.finalize()
grown = LeRobotDataset("local/ours", root=root)
assert grown.num_episodes == whole.num_episodes + 1
print("resumes:", grown.num_episodes, "episodes")
"""

ROBOMIMIC = """
import sys

import numpy as np
import robomimic
from robomimic.utils.dataset import SequenceDataset

work = sys.argv[1]
log = np.load(work + "/log.npz")
data = SequenceDataset(
    hdf5_path=work + "/set/data.hdf5",
    obs_keys=("state", "qpos", "qvel"),
    dataset_keys=("actions", "rewards", "dones"),
    load_next_obs=True,
    seq_length=4,
    hdf5_cache_mode=None,
)
print("robomimic", robomimic.__version__, "python", sys.version.split()[0])
print("demos", data.n_demos, "sequences", len(data), "item", sorted(data[0]))
assert data[0]["next_obs"]["qpos"].shape[0] == 4
state = np.stack([data[i]["obs"]["state"][0] for i in range(len(data))])
assert state.astype(np.float32).tobytes() == log["state"].tobytes()
actions = np.stack([data[i]["actions"][0] for i in range(len(data))])
assert actions.astype(np.float32).tobytes() == log["action"].tobytes()
print("state and actions the log's")
"""


def main() -> None:
    """Export, and let the peer read."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("peer", choices=["lerobot", "robomimic"])
    parser.add_argument("logs", type=Path, nargs="+")
    parser.add_argument("--python", required=True, help="command that runs the peer's Python")
    parser.add_argument("--work", type=Path, help="parent of the folder to work in")
    given = parser.parse_args()
    chosen, _ = entries(given.logs)
    with tempfile.TemporaryDirectory(dir=given.work) as work:
        folder = Path(work) / "set"
        export(chosen, folder, Options(given.peer))
        episodes = list(coordlog.open([entry.path for entry in chosen]))
        np.savez(
            Path(work) / "log.npz",
            state=np.concatenate([episode.state[:-1] for episode in episodes]),
            action=np.concatenate([episode.action for episode in episodes]),
            seed=chosen[0].row["seed"],
            length=len(episodes[0]),
        )
        # Offline: a file that is missing is to be an error, not a download.
        environment = dict(os.environ, HF_HUB_OFFLINE="1", HF_HOME=f"{work}/home", PYTHONPATH="")
        code = LEROBOT if given.peer == "lerobot" else ROBOMIMIC
        if given.peer == "lerobot":
            _doctor(folder)
        command = [*shlex.split(given.python), "-c", code, work]
        subprocess.run(command, check=True, env=environment, cwd=work)
        if given.peer == "lerobot":
            for name in ("set", "less", "parts/train", "parts/test", "again"):
                _doctor(Path(work) / name)


def _doctor(folder: Path) -> None:
    from robovet.checks import run_doctor
    from robovet.dataset import LeRobotDataset

    print("robovet:", folder.name, dict(run_doctor(LeRobotDataset(folder)).counts), flush=True)


if __name__ == "__main__":
    main()
