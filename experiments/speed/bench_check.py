"""How fast logs are proven: `check --level replay` against the simulation that made them, in one
run.

    python experiments/speed/bench_check.py [--episodes 1000] [--scene table] [--json FILE]

The episodes are recorded first (many simulations on all cores, the expert with noise) and then
checked from their files (processes on all cores), so both numbers are wall clock over the same
steps.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from pathlib import Path

from coordlog.parallel import batches, mapped
from coordlog.policies.scripted import scripted, with_noise
from coordlog.record.recorder import Recorder
from coordlog.sim.env import BatchEnv
from coordlog.sim.rollout import rollout
from coordlog.tasks.scene import find
from coordlog.verify.levels import BATCH, check_files


def check_to_replay(paths: list[Path]) -> int:
    """Steps of some files that were replayed; all must be sound."""
    checked = check_files(paths, level="replay")
    assert not checked.findings, checked.findings[0]
    return checked.steps


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--episodes", type=int, default=1000)
    parser.add_argument("--scene", default="table")
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        env = BatchEnv(find(args.scene), n=64)
        policy, noise = with_noise(scripted("expert", env), env, sigma=0.15, correlation=0.0)
        described = {"kind": "scripted", "name": "expert", "checkpoint_sha256": "", "noise": noise}
        began, steps = time.perf_counter(), 0
        with Recorder(env, folder, policy=described, display=False) as recorder:
            for ids, _ in rollout(recorder, policy, range(args.episodes), seed=0):
                steps += len(ids)
        simulated = steps / (time.perf_counter() - began)
        files = sorted(folder.glob("*.mcap"))
        began = time.perf_counter()
        checked = sum(mapped(check_to_replay, batches(files, BATCH), jobs=0)) / (
            time.perf_counter() - began
        )
    ratio = checked / simulated
    print(
        f"{args.episodes} episodes of {args.scene}: recorded at {simulated:,.0f} steps/s, replayed and compared at {checked:,.0f}"
    )
    print(f"check --level replay: {ratio:.2f} x the speed of simulation (target >= 0.5)")
    if args.json:
        args.json.write_text(
            json.dumps(
                {
                    "simulated": simulated,
                    "checked": checked,
                    "ratio": ratio,
                    "episodes": args.episodes,
                }
            )
        )


if __name__ == "__main__":
    main()
