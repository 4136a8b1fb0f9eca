"""Logs smoothed into a folder, and told to the catalogue that may lie there."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from coordlog.catalog.asking import catalogued
from coordlog.smooth import batch

if TYPE_CHECKING:
    from coordlog.episode import Json


def smooth_logs(paths: Sequence[Path], out: Path, settings: Json, **options: Any) -> Json:
    """Smooth every episode of some logs; arguments, report and errors as of `batch.smooth_logs`."""
    found = batch.smooth_logs(paths, out, settings, **options)
    if options.get("write", True):
        catalogued(out, [Path(row["target"]) for row in found["rows"]])
    return found
