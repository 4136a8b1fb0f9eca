"""One function over many items, on several processes: every command that maps over episodes comes
through here.
"""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from typing import TypeVar

Item = TypeVar("Item")
Answer = TypeVar("Answer")


def batches(items: Sequence[Item], size: int) -> list[Sequence[Item]]:
    """Consecutive groups of at most `size`."""
    return [items[i : i + size] for i in range(0, len(items), size)]


def mapped(
    function: Callable[[Item], Answer], items: Sequence[Item], *, jobs: int
) -> Iterator[Answer]:
    """Answers in the order of the items, each as soon as it and those before it are there.

    Args:
        function: A module-level function: it is sent to fresh processes.
        items: What to call it with.
        jobs: Processes; 0 for one per core. A single job, or a single item, runs right here.
    """
    jobs = min(jobs or os.cpu_count() or 1, len(items))
    if jobs <= 1:
        yield from map(function, items)
        return
    # Fresh processes, not forks: a fork would inherit the threads of a progress bar in an unknown state.
    with ProcessPoolExecutor(jobs, mp_context=multiprocessing.get_context("spawn")) as pool:
        futures = [pool.submit(function, item) for item in items]
        try:
            for future in futures:
                yield future.result()
        finally:
            for future in futures:
                future.cancel()
