"""A run folder that explains itself: what was asked, of which code, on which data.

run.json                 settings, environment, versions, git revision, evaluation
data.lock                sha256 and name of every logged episode that is learnt from, one per line
metrics.jsonl            a row per interval and per evaluation
checkpoint.safetensors   everything a resumed run needs, with buffer/
policy.safetensors       the policy as of the last checkpoint; best.safetensors: the best one
evaluated episodes/                every live and every evaluation episode
tensorboard/             event files, if asked for
"""

from __future__ import annotations

import json
import subprocess
from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from coordlog.config import plain
from coordlog.episode import Json
from coordlog.errors import ConfigError, StorageError
from coordlog.tasks.config import EnvConfig

PACKAGES = ("coordlog", "mujoco", "numpy", "torch", "pyarrow", "mcap", "safetensors")
RUN, LOCK = "run.json", "data.lock"
MUST_AGREE = ("scene", "mode", "env", "seed", "envs", "where", "data", "start")
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


def require_new(folder: Path) -> None:
    """Refuse a folder that holds a run.

    Raises:
        StorageError: if it does.
    """
    if (folder / RUN).exists():
        raise StorageError(
            f"{folder}: holds a run already and is not overwritten; --resume goes on with it, --out names another folder"
        )


def recall(folder: Path) -> Json:
    """What a run was about.

    Raises:
        StorageError: if there is no run in the folder.
        ConfigError: if its run.json is damaged.
    """
    try:
        said: Json = json.loads((folder / RUN).read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise StorageError(
            f"{folder}: holds no run: expected a folder with {RUN}, found none"
        ) from None
    except OSError as error:
        raise StorageError(f"{folder / RUN}: cannot be read: {error.strerror}") from error
    except ValueError as error:
        raise ConfigError(f"{folder / RUN}: expected JSON: {error}") from error
    if not isinstance(said, dict):
        raise ConfigError(f"{folder / RUN}: expected a JSON object, got {str(said)[:40]}")
    said.setdefault("start", "stand")  # runs of before there was a choice
    if isinstance(said.get("env"), dict):
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
                f"{folder}: resume with the run's own options: its {name} was {was} and is now {now_is}"
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
