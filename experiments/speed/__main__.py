"""`make bench`: every benchmark, one after the other, each printing ratios measured in its own
run.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).parent
ARGUMENTS = {
    "bench_check": ["--episodes", "300"],
    "bench_loading": ["--large", "1000", "--steps", "0"],
}
"""Shortened where the default takes long."""
BY_HAND = ("bench_cluster", "bench_learning")
"""Take hours, or a cluster."""


def main() -> None:
    failed = []
    for path in sorted(HERE.glob("bench_*.py")):
        if path.stem in BY_HAND:
            continue
        print(f"\n== {path.stem}", flush=True)
        if subprocess.run(
            [sys.executable, str(path), *ARGUMENTS.get(path.stem, [])], check=False
        ).returncode:
            failed.append(path.stem)
    if failed:
        sys.exit(f"failed: {', '.join(failed)}")


if __name__ == "__main__":
    main()
