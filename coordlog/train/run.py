"""A run folder that explains itself: what was asked, of which code, on which data.

run.json                 settings, environment, versions, git revision, evaluation
data.lock                sha256 and name of every logged episode that is learnt from, one per line
metrics.jsonl            a row per interval and per evaluation
checkpoint.safetensors   everything a resumed run needs, with buffer/
policy.safetensors       the policy as of the last checkpoint; best.safetensors: the best one
evaluated episodes/                every live and every evaluation episode
tensorboard/             event files, if asked for
.held                    which process trains, or did last; the lock on it is the kernel's
"""

from __future__ import annotations

import json
import os
import platform
import subprocess
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from coordlog.config import plain
from coordlog.episode import Json
from coordlog.errors import ConfigError, StorageError
from coordlog.record.storage import lock
from coordlog.tasks.config import EnvConfig

PACKAGES = ("coordlog", "mujoco", "numpy", "torch", "pyarrow", "mcap", "safetensors")
RUN, LOCK, HELD = "run.json", "data.lock", ".held"
MOST = 16 << 20
"""Largest run.json that is read [bytes]; ours have 20 kB."""
NEEDED = ("scene", "mode", "settings", "seed")
KINDS = {
    "scene": str,
    "mode": str,
    "settings": dict,
    "seed": int,
    "env": dict,
    "recorder": str,
    "where": str,
    "data": str,
    "envs": int,
}
TABLES = (
    *("network", "learner", "behaviour", "noise", "replay", "loop"),
    *("config", "reward", "robot", "layout"),
)
"""Entries of settings and env that are tables."""
MUST_AGREE = (
    *("scene", "mode", "env", "seed", "envs", "where", "data", "start"),
    *("window", "collectors"),
)
"""Keys of run.json that a resumed run may not change."""


def begin(folder: Path, said: Json, *, data: Sequence[tuple[str, str]]) -> None:
    """Write what a new run is about.

    Args:
        folder: The run folder; made if missing.
        said: JSON-able: scene, env, mode, settings, seed, envs, …
        data: Digest and name of every logged episode.

    Raises:
        StorageError: if the folder holds a run already, or cannot be written.
    """
    require_new(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / LOCK).write_text(
            "".join(f"{digest}  {name}\n" for digest, name in data), encoding="utf-8"
        )
        (folder / RUN).write_text(
            json.dumps({**said, "versions": versions(), "git": revision()}, indent=1) + "\n",
            encoding="utf-8",
        )
    except OSError as error:
        raise StorageError(f"{folder}: cannot begin a run: {error.strerror}") from error


@contextmanager
def held(folder: Path) -> Iterator[None]:
    """Keep every other process from training into a run folder while the context lasts.

    The kernel lets go of it when this process ends, however it ends. Where the file system has no
    locks nothing is kept from anybody.

    Raises:
        StorageError: if another process holds it, saying which; or if the folder cannot be written.
    """
    path = folder / HELD
    try:
        folder.mkdir(parents=True, exist_ok=True)
        fd = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
    except OSError as error:
        raise StorageError(f"{folder}: cannot hold the run: {error.strerror}") from error
    try:
        if not lock(fd):
            holder = os.pread(fd, 200, 0).decode("utf-8", "replace").strip()
            raise StorageError(
                f"{folder}: this run is being trained by another process, {holder or 'unknown'};"
                " wait for its end, or choose another --out"
            )
        now = time.strftime("%Y-%m-%d %H:%M:%S")
        with suppress(OSError):  # who holds it is a courtesy
            os.ftruncate(fd, 0)
            os.pwrite(fd, f"pid {os.getpid()} on {platform.node()} since {now}\n".encode(), 0)
        yield
    finally:
        os.close(fd)


def require_new(folder: Path) -> None:
    """Refuse a folder that holds a run.

    Raises:
        StorageError: if it does.
    """
    if (folder / RUN).exists():
        raise StorageError(
            f"{folder}: holds a run already and is not overwritten; --resume goes on with it, "
            "--out names another folder"
        )


def recall(folder: Path) -> Json:
    """What a run was about.

    Raises:
        StorageError: if there is no run in the folder.
        ConfigError: if its run.json is damaged, or not of a run.
    """
    path = folder / RUN
    try:
        with path.open("rb") as stream:
            text = stream.read(MOST + 1)
    except (FileNotFoundError, NotADirectoryError):
        raise StorageError(
            f"{folder}: holds no run: expected a folder with {RUN}, found none"
        ) from None
    except OSError as error:
        raise StorageError(f"{path}: cannot be read: {error.strerror}") from error
    if len(text) > MOST:
        raise ConfigError(f"{path}: expected at most {MOST:,} bytes, got more: not of a run")
    try:
        said = json.loads(text)
    except (ValueError, RecursionError) as error:
        reason = "too deep" if isinstance(error, RecursionError) else str(error)
        raise ConfigError(f"{path}: expected JSON: {reason}") from None
    if not isinstance(said, dict):
        raise ConfigError(f"{path}: expected a JSON object, got {str(said)[:40]}")
    return _checked(path, said)


def _checked(path: Path, said: Json) -> Json:
    """The record of a run, if its entries are what they should be.

    Raises:
        ConfigError: naming the first that is not.
    """
    missing = [key for key in NEEDED if key not in said]
    if missing:
        raise ConfigError(
            f"{path}: expected what a run was about, {', '.join(missing)} missing; is it of "
            "another program?"
        )
    for key, kind in KINDS.items():
        if key in said and type(said[key]) is not kind:
            raise ConfigError(
                f"{path}: '{key}': expected {kind.__name__}, got {str(said[key])[:40]!r}"
            )
    sections = [*said["settings"].items(), *said.get("env", {}).items()]
    for name, section in sections:
        if name in TABLES and type(section) is not dict:
            raise ConfigError(f"{path}: '{name}': expected a table, got {str(section)[:40]!r}")
    said.setdefault("start", "stand")  # runs of before there was a choice
    if said.get("env", {}).get("config"):  # that of an environment which is not ours is empty
        said["env"]["config"] = plain(EnvConfig()) | said["env"].get("config", {})
    return said


def require_same(before: Json, now: Json, *, folder: Path) -> None:
    """Refuse to resume a run as another one.

    Raises:
        ConfigError: naming the first key that differs.
    """
    for key in MUST_AGREE:
        if before.get(key) != now.get(key):
            name, *values = _difference(key, before.get(key), now.get(key))
            was, now_is = (repr(value)[:60] for value in values)
            raise ConfigError(
                f"{folder}: resume with the run's own options: its {name} was {was} and is now "
                f"{now_is}"
            )


def _difference(name: str, before: object, now: object) -> tuple[str, object, object]:
    """The first entry that differs, by its dotted name."""
    if isinstance(before, dict) and isinstance(now, dict):
        for key in {**before, **now}:
            if before.get(key) != now.get(key):
                return _difference(f"{name}.{key}", before.get(key), now.get(key))
    return name, before, now


def versions() -> dict[str, str]:
    """Installed versions of what the result depends on."""
    found = {}
    for name in PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "not installed"
    return found


def revision() -> str:
    """The git commit of the code, "+changes" if it has uncommitted ones.

    "" outside a repository.
    """
    here = Path(__file__).parent
    try:
        commit = subprocess.run(
            ["git", "rev-parse", "HEAD"], cwd=here, capture_output=True, text=True, check=True
        ).stdout.strip()
        dirty = subprocess.run(
            ["git", "status", "--porcelain"], cwd=here, capture_output=True, text=True, check=True
        ).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return ""
    return commit + ("+changes" if dirty else "")
