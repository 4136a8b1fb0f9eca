"""Rows of metrics as TensorBoard event files.

Needs the package tensorboard, which nothing else here does.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from coordlog.errors import ConfigError, StorageError
from coordlog.train.metrics import Row

if TYPE_CHECKING:
    from torch.utils.tensorboard import SummaryWriter

PLACES = ("kind", "update", "step")
"""Keys of a row that say where it stands."""


def require_tensorboard() -> None:
    """Refuse to begin what is to be written where it cannot be.

    Raises:
        ConfigError: if the package is not installed.
    """
    try:
        import torch.utils.tensorboard  # noqa: F401
    except ImportError as error:
        raise ConfigError(
            "--tensorboard: expected the package tensorboard, found none; pip install "
            "'coordlog[tensorboard]'"
        ) from error


class EventFiles:
    """One scalar per figure of a row, named "training/score", "evaluation/clean", …, over
    updates.
    """

    def __init__(self, folder: Path) -> None:
        """Write nothing yet.

        Args:
            folder: Where the event files go, beside those of a run that is gone on with.
        """
        self._folder = folder
        self._writer: SummaryWriter | None = None

    def __call__(self, row: Row) -> None:
        """Write a row.

        Raises:
            StorageError: if the file system refuses.
        """
        update = int(row["update"] or 0)
        try:
            writer = self._opened(update)
            for name, value in row.items():
                if name not in PLACES and isinstance(value, float | int):
                    writer.add_scalar(f"{row['kind']}/{name}", value, update)
            writer.flush()
        except OSError as error:
            raise StorageError(
                f"{self._folder}: event files cannot be written: {error.strerror}"
            ) from error

    def __enter__(self) -> EventFiles:
        return self

    def __exit__(self, *_: object) -> None:
        if self._writer is not None:
            self._writer.close()

    def _opened(self, update: int) -> SummaryWriter:
        """The writer. What an interrupted run wrote from this update on is taken again, and so no
        longer shown.
        """
        if self._writer is None:
            from torch.utils.tensorboard import SummaryWriter

            self._writer = SummaryWriter(str(self._folder), purge_step=update)
        return self._writer
