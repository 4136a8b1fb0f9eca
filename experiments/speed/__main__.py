"""`make bench`: every benchmark, one after the other, each printing ratios measured in its own
run. Clusters and comparisons with another checkout are run by hand.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

BENCHES = {
    "bench_env": [],
    "bench_many": ["--rows", "200000", "--files", "2000", "--members", "10000"],
    "bench_record": [],
    "bench_smooth": [],
    "bench_train": [],
}
"""Names, and arguments where the default takes long."""


def main() -> None:
    """Run them all, and say which failed."""
    failed = []
    for name, arguments in BENCHES.items():
        print(f"\n== {name}", flush=True)
        command = [sys.executable, "-m", f"experiments.speed.{name}", *arguments]
        if subprocess.run(command, cwd=Path(__file__).parents[2], check=False).returncode:
            failed.append(name)
    if failed:
        sys.exit(f"failed: {', '.join(failed)}")


if __name__ == "__main__":
    main()
