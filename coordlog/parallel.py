"""One function over many items, on several processes or a cluster: every command that maps over
episodes comes through here.

`jobs` is a number of processes on this machine, "ray" for the Ray cluster that this machine belongs
to (or one of its own), or "ray://HOST:PORT". Answers come in the order of the items and do not
depend on who worked them out.
"""

from __future__ import annotations

import multiprocessing
import os
import re
import secrets
import signal
import socket
import sys
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence, Sized
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from typing import Any, TypeVar

from coordlog.errors import ConfigError, CoordlogError, WorkerError

Item = TypeVar("Item")
Answer = TypeVar("Answer")

RAY = "ray"
RETRIES = 3
"""How often an item is begun again on a cluster after the process that had it died."""

_IN_FLIGHT = 4  # items per core of a cluster that are handed out at a time


def batches(items: Sequence[Item], size: int) -> list[Sequence[Item]]:
    """Consecutive groups of at most `size`."""
    return [items[i : i + size] for i in range(0, len(items), size)]


def shard(items: Sequence[Item], text: str) -> Sequence[Item]:
    """One of n shares of the items, named "i/n" with i from 1; "" for all of them.

    Raises:
        ConfigError: if it is no such share.
    """
    if not text:
        return items
    first, slash, second = text.partition("/")
    if not slash or not first.isdecimal() or not second.isdecimal():
        raise ConfigError(f"--shard: expected I/N, such as 1/8, got {text}")
    i, n = int(first), int(second)
    if not 1 <= i <= n:
        raise ConfigError(f"--shard: expected I from 1 to N, got {text}")
    return items[i - 1 :: n]


def workers(jobs: int | str) -> int | str:
    """What `--jobs` means: a number of processes, or the address of a cluster.

    Raises:
        ConfigError: if it is neither.
    """
    text = str(jobs).strip()
    if text.isdecimal():
        return int(text)
    if text == RAY or (text.startswith(f"{RAY}://") and len(text) > len(f"{RAY}://")):
        return text
    raise ConfigError(
        f"--jobs: expected a number of processes, {RAY}, or {RAY}://HOST:PORT, got {jobs}"
    )


def mapped(
    function: Callable[[Item], Answer], items: Iterable[Item], *, jobs: int | str
) -> Iterator[Answer]:
    """Answers in the order of the items, each as soon as it and those before it are there.

    Args:
        function: A module-level function: it is sent to fresh processes. On a cluster it may be
            called twice with an item, where a process died: what it writes must be the same.
        items: What to call it with. Without a length, such as of a generator that need not end,
            they are worked on a little ahead of what is asked for, and never right here.
        jobs: Processes, 0 for one per core; or a cluster, see `workers`. Of items that have a
            length a single one, or a single process, runs right here.

    Raises:
        ConfigError: if `jobs` is none, or the cluster cannot be reached.
        WorkerError: if a process was killed.

    Example:
        >>> list(mapped(abs, [-1, 2], jobs=1))
        [1, 2]
    """
    wanted = workers(jobs)
    if isinstance(wanted, str):
        yield from _on_ray(function, items, wanted)
        return
    count, window, ends = wanted or os.cpu_count() or 1, _IN_FLIGHT, isinstance(items, Sized)
    if isinstance(items, Sized):
        count, window = min(count, len(items)), len(items)
        if count <= 1:
            yield from map(function, items)
            return
    # Fresh processes, not forks: a fork would inherit the threads of a progress bar in an unknown
    # state.
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(count, spawn, initializer=_attend, initargs=(ends,)) as pool:
        try:
            yield from _in_order(
                items,
                max(window, count * _IN_FLIGHT),
                submit=lambda item: pool.submit(function, item),
                answer=lambda future: future.result(),
                cancel=lambda future: future.cancel(),
            )
        except BrokenProcessPool:
            raise WorkerError(
                "a process at work was killed, from outside or because memory ran out; what it had "
                "finished is kept: run the command again, with fewer --jobs if it was memory"
            ) from None


def _attend(ends: bool) -> None:
    """End when the process that we work for does, however it ends; leave Ctrl-C to it where the
    work does not end by itself.
    """
    parent = multiprocessing.parent_process()
    if parent is None:
        return
    if not ends:
        signal.signal(signal.SIGINT, signal.SIG_IGN)

    def end() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=end, daemon=True).start()


def _in_order(
    items: Iterable[Item],
    window: int,
    *,
    submit: Callable[[Item], Any],
    answer: Callable[[Any], Answer],
    cancel: Callable[[Any], object],
) -> Iterator[Answer]:
    """Answers in the order of the items, of which so many at most are handed out at a time."""
    pending: deque[Any] = deque()
    waiting = iter(items)
    try:
        while True:
            while len(pending) < window and (item := next(waiting, _END)) is not _END:
                pending.append(submit(item))
            if not pending:
                return
            yield answer(pending.popleft())
    finally:
        for left in pending:
            cancel(left)


def _on_ray(
    function: Callable[[Item], Answer], items: Iterable[Item], address: str
) -> Iterator[Answer]:
    """As `mapped`, by tasks of Ray."""
    with cluster(address) as ray:
        task = ray.remote(max_retries=RETRIES, num_cpus=1)(_called)
        kept = ray.put(function)
        yield from _in_order(
            items,
            _IN_FLIGHT * max(int(ray.cluster_resources().get("CPU", 1)), 1),
            submit=lambda item: task.remote(kept, item),
            answer=lambda reference: answer_of(ray, reference),
            cancel=lambda reference: ray.cancel(reference, force=False),
        )


_END: Any = object()


def _called(function: Callable[[Item], Answer], item: Item) -> Answer:
    return function(item)


def answer_of(ray: Any, reference: Any, leave: Any = ()) -> Any:
    """The answer of a task, or the error that the function raised; errors to leave are left."""
    try:
        return ray.get(reference)
    except leave:
        raise
    except ray.exceptions.RayTaskError as error:
        raise error.cause from None
    except ray.exceptions.RayError as error:
        raise CoordlogError(
            f"--jobs ray: a task was begun {RETRIES + 1} times and its process died each time:"
            f" {str(error).splitlines()[0]}"
        ) from None


@contextmanager
def cluster(address: str) -> Iterator[Any]:
    """A connection to a cluster, or one of our own on this machine."""
    if address == RAY and not os.environ.get("RAY_ADDRESS"):
        _lock_up()
    import ray
    import ray.exceptions

    if ray.is_initialized():
        yield ray
        return
    elsewhere = address if address != RAY else os.environ.get("RAY_ADDRESS", "")
    _require_head(elsewhere)
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")
    quiet: dict[str, Any] = {"logging_level": "ERROR", "log_to_driver": False}
    try:
        if address == RAY:
            ray.init(**({} if elsewhere else _ALONE), **quiet)
        else:
            ray.init(address, **quiet)
    except Exception as error:  # noqa: BLE001 - Ray raises whatever its transport does
        advice = "--jobs with a number needs no cluster"
        if elsewhere:
            advice = f"the head needs Ray {ray.__version__}, as here, and the same Python"
        said = " ".join(str(error).split())[:_LONGEST]
        raise ConfigError(f"--jobs {address}: cannot use the cluster: {said}; {advice}") from None
    try:
        yield ray
    finally:
        ray.shutdown()


def _require_head(address: str) -> None:
    """Knock at the head of a cluster, if one is named: Ray itself waits for minutes.

    Raises:
        ConfigError: if nobody answers.
    """
    found = _HEAD.fullmatch(address)
    if found is None:
        if address.startswith(f"{RAY}://"):
            raise ConfigError(f"--jobs: expected {RAY}://HOST:PORT, got {address}")
        return  # auto, local, or nothing
    try:
        socket.create_connection((found[1].strip("[]"), int(found[2])), timeout=_KNOCK).close()
    except (OSError, OverflowError) as error:
        raise ConfigError(
            f"--jobs: no head of a cluster at {address}: {getattr(error, 'strerror', '') or error};"
            f" is it up, and the port of Ray's clients ({RAY}://) or of the head (RAY_ADDRESS)?"
        ) from None


def _lock_up() -> None:
    """Have a cluster of our own listen on 127.0.0.1 alone, and ask for a secret.

    The first switch is Ray's for systems whose firewalls ask; Linux takes it as well. Given an
    address of this machine alone, `ray.init` takes that of its network instead.
    """
    if "ray" not in sys.modules and "RAY_AUTH_MODE" not in os.environ:
        os.environ["RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER"] = "0"
        os.environ["RAY_AUTH_MODE"] = "token"
        os.environ["RAY_AUTH_TOKEN"] = secrets.token_hex(32)


_HEAD = re.compile(r"(?:ray://)?([^/\s]+):(\d{1,6})")
_KNOCK = 10.0  # s
_LONGEST = 400
_ALONE: dict[str, Any] = {"address": "local", "include_dashboard": False}
