"""coordlog scenes: what there is to record."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from coordlog.commands import terminal


def scenes(
    picture: Annotated[Path | None, typer.Option(help="Render every scene to DIR/NAME.png instead.", metavar="DIR")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print as JSON.")] = False,
) -> None:
    """List the scenes and their numbers, or render them.

    Examples:

        coordlog scenes

        coordlog scenes --picture pictures/
    """
    from coordlog.sim.scene import SCENES

    if picture is not None:
        _render(picture)
        return
    rows = [_row(name) for name in SCENES]
    if as_json:
        terminal.print_json(rows)
        return
    columns = ("scene", "robot", "joints", "arms", "obstacles", "goals", "state", "about")
    terminal.table(columns, [[row[name] for name in columns] for row in rows], right=("joints", "state"))


def _row(name: str) -> dict[str, Any]:
    from coordlog.sim.env import BatchEnv
    from coordlog.sim.scene import SCENES

    scene, layout = SCENES[name], BatchEnv(SCENES[name], n=1, threads=1).layout
    panels = [f"{panel.name} at {_point(panel.centre)}, half extents {_point(panel.half)}" for panel in scene.panels]
    low, high = scene.sphere_radius
    spheres = [f"{scene.spheres} spheres, radius {low}-{high} m, in {_box(scene.sphere_box)}"] if scene.spheres else []
    goals = "palms of a random posture" if scene.object_box is None else f"±{scene.palm_offset} m beside a point in {_box(scene.object_box)}"
    return {
        "scene": name,
        "robot": scene.robot.name,
        "joints": layout.n_u,
        "arms": " ".join(arm.name for arm in scene.robot.arms),
        "obstacles": "\n".join(panels + spheres) or "none",
        "goals": goals,
        "state": layout.n_x,
        "about": scene.doc,
    }


def _render(folder: Path) -> None:
    from coordlog.sim.picture import save_picture
    from coordlog.sim.scene import SCENES

    for name in SCENES:
        path = folder / f"{name}.png"
        save_picture(SCENES[name], path)
        terminal.out.print(str(path))


def _point(values: tuple[float, ...]) -> str:
    return "(" + ", ".join(f"{value:g}" for value in values) + ")"


def _box(box: Any) -> str:
    return " × ".join(f"[{low:g}, {high:g}]" if high > low else f"{low:g}" for low, high in box) + " m"
