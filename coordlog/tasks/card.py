"""A robot's card as a scene: the robot, and what its table [scene] puts around it."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from coordlog.config import build
from coordlog.errors import ConfigError
from coordlog.robots.card import read_tables, robot_of
from coordlog.tasks.scene import Box3, Panel, Scene


@dataclass(frozen=True)
class SceneCard:
    """The table [scene] of a card, as `Scene` means it; empty, every arm has a goal of its own."""

    name: str = ""
    doc: str = ""
    object_half: tuple[float, float, float] | None = None
    object_box: Box3 | None = None
    palm_offset: float = 0.0
    spheres: int = 0
    sphere_radius: tuple[float, float] = (0.03, 0.06)
    sphere_box: Box3 | None = None


def read_card(path: Path) -> Scene:
    """The scene that a robot's card describes.

    Raises:
        ConfigError: if it cannot be read, or says what no card says.
    """
    tables = read_tables(path)
    robot = robot_of(tables, path.parent)
    around: dict[str, Any] = dict(tables.get("scene", {}))
    panels = around.pop("panels", [])
    if not isinstance(panels, list):
        raise ConfigError(f"{path}: expected a list of tables as scene.panels, got {panels!r}")
    said = build(SceneCard, around, prefix="scene.", what="key in a robot's card")
    told = asdict(said)
    told["name"] = said.name or robot.name
    told["doc"] = said.doc or f"Goals that {robot.name} can reach"
    told["panels"] = tuple(
        build(Panel, panel, prefix=f"scene.panels[{i}].", what="key in a robot's card")
        for i, panel in enumerate(panels)
    )
    return Scene(robot=robot, **told)
