"""Scenes as a person names them: one that ships, one in a file of their own, a robot's card."""

from __future__ import annotations

import re
import runpy
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

from coordlog.errors import ConfigError, unknown
from coordlog.strangers import what_is
from coordlog.tasks.card import read_card
from coordlog.tasks.scene import SCENES, Scene, find

NAMES_FILES = re.compile(r"\bfile(name)?\s*=")
"""A model in MJCF or URDF that reads files."""


def scene_of(name: str) -> Scene:
    """The scene that a person asks for: one that ships, one of their own as FILE.py:NAME, for which
    the file is run, or a robot's card, ROBOT.toml.

    Names that come out of logs and policy files go to `tasks.scene.find` instead: what somebody
    sent must not run anything.

    Raises:
        ConfigError: for an unknown name, a file that cannot be run or read, or a name in it that is
            no scene.
    """
    if name.endswith(".toml"):
        return read_card(Path(name))
    file, colon, attribute = name.rpartition(":")
    what = "" if name in SCENES else what_is(name) or what_is(file, texts=False)
    if what:
        raise ConfigError(
            f"{name}: expected a scene, a robot's card (.toml) or FILE.py:NAME, got {what}"
        )
    if not colon:
        return find(name)
    found = run_file(Path(file), "scenes")
    scenes = [key for key, value in found.items() if isinstance(value, Scene)]
    if attribute not in scenes:
        raise unknown(f"scene of {file}", attribute, scenes)
    own: Scene = found[attribute]
    if own.robot.assets is None and NAMES_FILES.search(
        str(own.robot.mjcf)
    ):  # beside the file, as Python
        own = replace(own, robot=replace(own.robot, assets=Path(file).resolve().parent))
    return own


def run_file(file: Path, what: str) -> dict[str, Any]:
    """Run a file of the user's as `python FILE.py` does: its own folder is where it imports from
    first.

    Args:
        file: What to run.
        what: What it is run for, as the message says it: "scenes", "policy".

    Returns:
        What the file defines, by name.

    Raises:
        ConfigError: if it cannot be run, with what it raised.
    """
    folder = str(file.resolve().parent)
    sys.path.insert(0, folder)
    try:
        return runpy.run_path(str(file))
    except Exception as error:  # the file is the user's, and so is whatever it raises
        raise ConfigError(
            f"{file}: cannot be run for its {what}: {type(error).__name__}: {error}"
        ) from error
    finally:
        sys.path.remove(folder)
