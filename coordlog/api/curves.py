"""Run folders to learning curves: what the runs measured, grouped, for the view to draw."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from coordlog.errors import ConfigError
from coordlog.train.history import Against, History, Kind, Line, band, grouped, load_history
from coordlog.view.curves import PANELS, Curve, curves_figure
from coordlog.view.joints import save


def draw_curves(folders: Sequence[Path], out: Path, *, against: str, force: bool) -> None:
    """Write the figure of some runs.

    Args:
        folders: Run folders, finished or not.
        out: The file.
        against: What x counts: episodes, updates or steps; "" for episodes where every run has live
            ones, else updates.
        force: Replace the file if it exists.

    Raises:
        ConfigError: if a run has no figure to draw yet, or none against this.
        StorageError: if a folder holds no run, or the file cannot be written.
    """
    histories = [
        load_history(folder) for folder in dict.fromkeys(folder.resolve() for folder in folders)
    ]
    x = _against(histories, against)
    scenes: dict[str, dict[str, list[Curve]]] = {}
    for scene in dict.fromkeys(history.said["scene"] for history in histories):
        of_scene = [history for history in histories if history.said["scene"] == scene]
        groups, panels = grouped(of_scene), _panels(of_scene)
        curves = {
            label: {name: _curves(label, group, name, against=x) for name in panels}
            for label, group in groups.items()
        }
        scenes[scene] = {
            name: [curve for made in curves.values() for curve in made[name]] for name in panels
        }
    save(curves_figure(scenes, against=x), out, force=force)


def _panels(histories: Sequence[History]) -> list[str]:
    """The figures that there are of some runs; those of our scenes, if there are none yet."""
    told = {name for history in histories for row in history.rows for name in row}
    ours = [name for name in PANELS if name != "return"]
    return ["return"] if "return" in told else ours


def _against(histories: Sequence[History], wanted: str) -> Against:
    asleep = [history.folder for history in histories if not history.live]
    if wanted in ("episodes", "steps") and asleep:
        raise ConfigError(
            f"--against {wanted}: expected runs with live steps, got {asleep[0]}, which learns "
            "from logs; use updates"
        )
    chosen: dict[str, Against] = {
        "episodes": "episodes",
        "updates": "updates",
        "steps": "steps",
        "": "updates" if asleep else "episodes",
    }
    if wanted not in chosen:
        raise ConfigError(f"--against: expected episodes, updates or steps, got '{wanted}'")
    return chosen[wanted]


def _curves(label: str, group: Sequence[History], name: str, *, against: Against) -> list[Curve]:
    """Held-out figures, and dashed those of the episodes learnt from.

    Those alone where nothing was evaluated.
    """
    held_out = _lines(group, name, kind="evaluation", against=against)
    explored = _lines(group, name, kind="training", against=against)
    if not held_out and not explored:
        raise ConfigError(
            f"{group[0].folder}: expected a run with an evaluation or a live episode to draw, got "
            "one with neither yet"
        )
    if not held_out:
        return [Curve(f"{label}, while exploring", *band(explored), runs=explored)]
    exploring = [Curve(label, *band(explored), dashed=True)] if explored else []
    return [*exploring, Curve(label, *band(held_out), runs=held_out)]


def _lines(group: Sequence[History], name: str, *, kind: Kind, against: Against) -> list[Line]:
    lines = [history.line(name, kind=kind, against=against) for history in group]
    return [line for line in lines if len(line.x)]
