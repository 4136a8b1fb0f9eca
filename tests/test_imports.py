"""The direction of imports, and which room owns which library."""

from __future__ import annotations

import ast
import subprocess
import sys
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[1] / "coordlog"
FLOORS = (
    {"version", "verbs"},
    {"errors", "monitor"},
    {"strangers", "conditions"},
    {"modest"},
    {"spec"},
    {"episode", "path"},
    {"contracts"},
    {"parallel"},
    {"crew"},
    {"config"},
    {"robots"},
    {"tasks"},
    {"mjcf"},
    {"kinematics"},
    {"sim"},
    {"policies", "record"},
    {"verify"},
    {"catalog", "exchange", "train", "smooth", "view"},
    {"api"},
    {"commands"},
    {"cli"},
)
"""From the ground up: a room may import rooms before it; those on one floor none of one another."""
FLOOR = {room: level for level, rooms in enumerate(FLOORS) for room in rooms}
PHYSICS = {"mjcf", "kinematics", "sim", "policies", "record", "exchange", "verify"}
OWNERS = {
    "torch": {"train"},
    "rerun": {"view"},
    "mcap": {"record", "verify", "exchange"},
    "rosbags": {"exchange"},
    "h5py": {"exchange"},
    "av": {"exchange"},
    "obstore": {"record"},
    "ray": {"parallel"},
    "mujoco": PHYSICS,
}
"""The rooms that may import a library."""


def name_of(path: Path) -> str:
    return ".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts).removesuffix(
        ".__init__"
    )


MODULES = {path: name_of(path) for path in PACKAGE.rglob("*.py")}


@cache
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
        if not name.startswith("coordlog.") or other in ("", own) or own in ("", "verbs"):
            continue
        assert other in FLOOR, f"{name} is in no known room"
        assert FLOOR[other] < FLOOR[own], f"{MODULES[path]} imports {name} from above or beside it"


@pytest.mark.parametrize("path", sorted(MODULES), ids=lambda path: MODULES[path])
def test_a_heavy_library_stays_in_its_room(path: Path) -> None:
    own = room(MODULES[path])
    for name in imports(path):
        owners = OWNERS.get(name.split(".")[0], {own})
        assert own in owners, f"{MODULES[path]} imports {name}, which belongs to {sorted(owners)}"


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
