"""coordlog scenes: what there is to record."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from coordlog.commands import terminal
from coordlog.commands.options import flag
from coordlog.errors import StorageError

if TYPE_CHECKING:
    from coordlog.tasks.scene import Scene


def scenes(
    scene: Annotated[
        list[str] | None, typer.Argument(help="Only these; FILE.py:NAME for one of your own.")
    ] = None,
    picture: Annotated[
        Path | None, typer.Option(help="Render every scene to DIR/NAME.png instead.", metavar="DIR")
    ] = None,
    as_json: Annotated[bool, flag("--json", "Print as JSON.")] = False,
) -> None:
    """List the scenes and their numbers, or render them.

    Examples:

        coordlog scenes

        coordlog scenes --picture pictures/

        coordlog scenes my_robot.py:SCENE
    """
    from coordlog.tasks.own import scene_of
    from coordlog.tasks.scene import SCENES

    chosen = [scene_of(name) for name in scene] if scene else list(SCENES.values())
    if picture is not None:
        _render(chosen, picture)
        return
    rows = [_row(each) for each in chosen]
    if as_json:
        terminal.print_json(rows)
        return
    for row in rows:
        about = (
            f"{row['robot']}, {row['joints']} joints in the action, {row['state']} numbers in the "
            f"state, arms {', '.join(row['arms'])}"
        )
        obstacles = [
            ("obstacle" if i == 0 else "", text) for i, text in enumerate(row["obstacles"])
        ]
        terminal.facts(
            [("robot", about), ("goals", row["goals"]), *obstacles],
            title=f"\n{row['scene']}: {row['about']}",
        )


def _row(scene: Scene) -> dict[str, Any]:
    from coordlog.sim.env import BatchEnv

    layout = BatchEnv(scene, n=1, threads=1).layout
    panels = [
        f"{panel.name} at {_point(panel.centre)}, half extents {_point(panel.half)}"
        for panel in scene.panels
    ]
    low, high = scene.sphere_radius
    spheres = (
        [f"{scene.spheres} spheres, radius {low}-{high} m, in {_box(scene.sphere_box)}"]
        if scene.spheres
        else []
    )
    beside = (
        f"{scene.palm_offset} m to the left and right of a point in {_box(scene.object_box)}"
        if scene.object_box
        else ""
    )
    return {
        "scene": scene.name,
        "robot": scene.robot.name,
        "joints": layout.n_u,
        "arms": [arm.name for arm in scene.robot.arms],
        "obstacles": panels + spheres,
        "goals": beside or "where a random posture puts the palms",
        "state": layout.n_x,
        "about": scene.doc,
    }


def _render(scenes: Sequence[Scene], folder: Path) -> None:
    from coordlog.sim.render import picture, write_png

    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StorageError(f"{folder}: cannot make the folder: {error.strerror}") from error
    for scene in scenes:
        path = folder / f"{scene.name}.png"
        if path.exists():
            raise StorageError(
                f"{path}: the file exists and is not overwritten; choose another folder"
            )
        write_png(path, picture(scene))
        terminal.say(str(path))


def _point(values: tuple[float, ...]) -> str:
    return "(" + ", ".join(f"{value:g}" for value in values) + ")"


def _box(box: Any) -> str:
    return (
        " × ".join(f"[{low:g}, {high:g}]" if high > low else f"{low:g}" for low, high in box) + " m"
    )
