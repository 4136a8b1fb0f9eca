"""The direction of imports: errors ← spec ← episode ← sim ← rollout ← { record | train | smooth |
view } ← commands ← cli."""

from __future__ import annotations

import ast
import subprocess
import sys
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[1] / "coordlog"
SIBLINGS = ("record", "train", "smooth", "view")
FLOORS = (
    "version",
    "errors",
    "spec",
    "episode",
    "sim",
    "rollout",
    "scoring",
    "scripted",
    *SIBLINGS,
    "commands",
    "cli",
)
"""From the ground up; a room may import rooms before it, and siblings none of one another."""
OWNERS = {"mujoco": "sim", "torch": "train", "mcap": "record", "rerun": "view"}


def name_of(path: Path) -> str:
    return ".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts).removesuffix(
        ".__init__"
    )


MODULES = {path: name_of(path) for path in PACKAGE.rglob("*.py")}


def imports(path: Path) -> set[str]:
    """Every module a file imports, at load time, inside functions and for typing alike."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert not node.level, f"{path}: relative imports hide the direction"
            found.add(node.module or "")
            found |= {f"{node.module}.{alias.name}" for alias in node.names}
    return found


def room(module: str) -> str:
    parts = module.split(".")
    return parts[1] if len(parts) > 1 else ""


@pytest.mark.parametrize("path", sorted(MODULES), ids=lambda path: MODULES[path])
def test_a_room_imports_only_what_lies_below_it(path: Path) -> None:
    own = room(MODULES[path])
    for name in imports(path):
        other = room(name)
        if not name.startswith("coordlog.") or other in ("", own) or own == "":
            continue
        assert other in FLOORS, f"{name} is in no known room"
        assert FLOORS.index(other) < FLOORS.index(own), f"{MODULES[path]} imports {name} from above"
        assert not (own in SIBLINGS and other in SIBLINGS), (
            f"{MODULES[path]} imports its sibling {name}"
        )


@pytest.mark.parametrize("path", sorted(MODULES), ids=lambda path: MODULES[path])
def test_a_heavy_library_stays_in_its_room(path: Path) -> None:
    for name in imports(path):
        owner = OWNERS.get(name.split(".")[0])
        assert owner in (None, room(MODULES[path])), (
            f"{MODULES[path]} imports {name}, which belongs to {owner}/"
        )


def test_there_is_no_cycle() -> None:
    names = set(MODULES.values())
    graph = {
        MODULES[path]: {use for use in imports(path) if use in names and use != MODULES[path]}
        for path in MODULES
    }
    tuple(TopologicalSorter(graph).static_order())


def test_the_package_and_its_help_load_nothing_heavy() -> None:
    code = (
        "import sys, coordlog, coordlog.cli\n"
        "heavy = {'mujoco', 'torch', 'rerun', 'scipy', 'mcap', 'pyarrow', 'numpy', 'matplotlib', 'gymnasium'} & set(sys.modules)\n"
        "print(sorted(heavy))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
