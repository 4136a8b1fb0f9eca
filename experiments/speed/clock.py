"""What all benchmarks do alike: the variants of one measurement take turns, the median turn counts,
and what is found is printed as rows and kept as JSON.
"""

from __future__ import annotations

import argparse
import gc
import json
import statistics
import time
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import NamedTuple


class Row(NamedTuple):
    """One figure."""

    what: str
    value: float
    unit: str = "×"
    target: str = ""


def turns(
    variants: Mapping[str, Callable[[], object]], *, rounds: int = 5, repeat: int = 1
) -> dict[str, list[float]]:
    """Processor seconds of a call of each variant, one value for each round after a first one that
    does not count. On a busy machine the wall clock mostly measures the others.
    """
    seconds: dict[str, list[float]] = {name: [] for name in variants}
    for turn in range(rounds + 1):
        for name, call in variants.items():
            gc.collect()
            began = time.process_time()
            for _ in range(repeat):
                call()
            if turn:
                seconds[name].append((time.process_time() - began) / repeat)
    return seconds


def medians(seconds: Mapping[str, list[float]]) -> dict[str, float]:
    """The median turn of each variant."""
    return {name: statistics.median(values) for name, values in seconds.items()}


def options(doc: str | None, **numbers: int) -> argparse.Namespace:
    """The command line: whole numbers by name with their defaults, and --json FILE."""
    parser = argparse.ArgumentParser(description=(doc or "").split("\n", 1)[0])
    for name, usual in numbers.items():
        parser.add_argument(f"--{name}", type=int, default=usual)
    parser.add_argument("--json", type=Path)
    return parser.parse_args()


def show(rows: Iterable[Row], file: Path | None) -> None:
    """Print each row as it comes, and keep all."""
    found = []
    for row in rows:
        found.append(row._asdict())
        target = f"(target {row.target})" if row.target else ""
        print(f"{row.what:72} {row.value:10.3f} {row.unit:8} {target}", flush=True)
    if file:
        file.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
