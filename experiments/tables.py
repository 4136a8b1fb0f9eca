"""Tables of results as JSON files: which there are, what they are called, reading and writing
them.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from coordlog.errors import FormatError

FOLDER = Path(__file__).parent / "tables"
SCENES = ("free", "spheres", "table", "shelf")
TORSOS = ("free", "locked")

Table = dict[str, Any]


def name_of(row: str, scene: str, *, torso: str = "free", seed: int | None = None) -> str:
    """The name of a table: SCENE-ROW, -locked where the spine is held, -sSEED of the training where
    there are several.
    """
    return (
        f"{scene}-{row}"
        + ("-locked" if torso == "locked" else "")
        + ("" if seed is None else f"-s{seed}")
    )


def write(table: Mapping[str, Any], name: str, *, folder: Path = FOLDER) -> Path:
    """Write a table, replacing what was measured before."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{name}.json"
    path.write_text(
        json.dumps(_rounded(table), indent=1, ensure_ascii=False) + "\n", encoding="utf-8"
    )
    return path


def read_all(folder: Path = FOLDER) -> dict[str, Table]:
    """Every table by name.

    Raises:
        FormatError: if one is no JSON.
    """
    found = {}
    for path in sorted(folder.glob("*.json")):
        try:
            found[path.stem] = json.loads(path.read_text(encoding="utf-8"))
        except ValueError as error:
            raise FormatError(f"{path}: expected JSON: {error}; measure it again") from error
    return found


def of_row(
    tables: Mapping[str, Table], row: str, scene: str, *, torso: str = "free"
) -> list[Table]:
    """The tables of one row, one per training seed."""
    return [
        table
        for table in tables.values()
        if (table.get("row"), table.get("scene"), table.get("torso")) == (row, scene, torso)
    ]


def _rounded(value: Any) -> Any:
    """Ten significant digits: files stay readable, and no figure here has more."""
    if isinstance(value, float):
        return float(f"{value:.10g}")
    if isinstance(value, Mapping):
        return {key: _rounded(each) for key, each in value.items()}
    return [_rounded(each) for each in value] if isinstance(value, list | tuple) else value
