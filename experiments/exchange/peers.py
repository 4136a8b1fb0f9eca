"""LeRobot and robomimic themselves on sets that `coordlog export` wrote, each in a virtual
environment of its own.

    python -m experiments.exchange.peers lerobot LOGS --python python3.12 --venv .peers/lerobot
    python -m experiments.exchange.peers robomimic LOGS --python python3.11 --venv .peers/robomimic

LeRobot 0.6.1 loads the set, selects episodes by our own column, deletes, splits and merges with its
own tools, and reads what comes out. robomimic 0.3.0 reads ours through SequenceDataset. Both bring
torch, several gigabytes with CUDA; neither is part of the tests.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from pathlib import Path

from coordlog.exchange.blocks import Options, export
from coordlog.exchange.source import entries

PACKAGES = {"lerobot": ["lerobot==0.6.1"], "robomimic": ["robomimic==0.3.0", "six", "matplotlib"]}

LEROBOT = """
import sys
from pathlib import Path
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.datasets.dataset_tools import delete_episodes, merge_datasets, split_dataset

root, work = Path(sys.argv[1]), Path(sys.argv[2])
whole = LeRobotDataset("local/ours", root=root)
print("episodes", whole.num_episodes, "frames", len(whole), "item", sorted(whole[0]))
clean = LeRobotDataset(
    "local/ours", root=root, episode_filter=lambda row: row["coordlog/success"]
)
print("by our own column", len(clean))
near = LeRobotDataset("local/ours", root=root, delta_timestamps={"action": [0.0, 0.04]})
assert near[0]["action"].shape[0] == 2
less = delete_episodes(whole, episode_indices=[0], output_dir=work / "less", repo_id="local/less")
assert less.num_episodes == whole.num_episodes - 1
parts = split_dataset(whole, splits={"train": 0.5, "test": 0.5}, output_dir=work / "parts")
again = merge_datasets(
    list(parts.values()), output_repo_id="local/again", output_dir=work / "again"
)
assert again.num_episodes == whole.num_episodes
print("deleted, split and merged")
"""

ROBOMIMIC = """
import sys
from robomimic.utils.dataset import SequenceDataset

data = SequenceDataset(
    hdf5_path=sys.argv[1] + "/data.hdf5",
    obs_keys=("state", "qpos", "qvel"),
    dataset_keys=("actions", "rewards", "dones"),
    load_next_obs=True,
    seq_length=4,
    hdf5_cache_mode=None,
)
print("demos", data.n_demos, "sequences", len(data), "item", sorted(data[0]))
assert data[0]["next_obs"]["qpos"].shape[0] == 4
"""


def main() -> None:
    """Build the environment if it is missing, export, and let the peer read."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("peer", choices=sorted(PACKAGES))
    parser.add_argument("logs", type=Path, nargs="+")
    parser.add_argument("--python", default=sys.executable)
    parser.add_argument("--venv", type=Path, required=True)
    given = parser.parse_args()
    own = given.venv / "bin" / "python"
    if not own.exists():
        subprocess.run([given.python, "-m", "venv", str(given.venv)], check=True)
    subprocess.run([str(own), "-m", "pip", "install", "-q", *PACKAGES[given.peer]], check=True)
    chosen, _ = entries(given.logs)
    code = LEROBOT if given.peer == "lerobot" else ROBOMIMIC
    with tempfile.TemporaryDirectory() as work:
        folder = Path(work) / "set"
        export(chosen, folder, Options(given.peer))
        # Offline: a file that is missing is to be an error, not a download.
        environment = dict(os.environ, HF_HUB_OFFLINE="1", HF_HOME=f"{work}/home", PYTHONPATH="")
        arguments = [str(own), "-c", code, str(folder), work]
        subprocess.run(arguments, check=True, env=environment, cwd=work)


if __name__ == "__main__":
    main()
