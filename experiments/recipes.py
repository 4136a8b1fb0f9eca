"""The committed recipes (recipes.toml): which rows there are, what they are called, how each comes
about.
"""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

FILE = Path(__file__).with_name("recipes.toml")


def recipes() -> dict[str, Any]:
    """The whole file."""
    return tomllib.loads(FILE.read_text(encoding="utf-8"))


def row_names() -> list[str]:
    """Rows in the order of the tables."""
    return list(recipes()["rows"])
