"""What every command says to a person: tables, progress, notes.

Results go to standard output, everything else to standard error.
"""

from __future__ import annotations

import json
import signal
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from types import FrameType
from typing import Any

from rich import box
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    SpinnerColumn,
    TaskProgressColumn,
    TextColumn,
    TimeRemainingColumn,
)
from rich.table import Table

PIPED_WIDTH = 180
"""Columns where the output is no terminal: a file or a pager does not wrap."""

out = Console() if sys.stdout.isatty() else Console(width=PIPED_WIDTH)
err = Console(stderr=True) if sys.stderr.isatty() else Console(stderr=True, width=PIPED_WIDTH)


def note(text: str) -> None:
    """One line that is not a result."""
    err.print(text, style="yellow", highlight=False)


def print_json(data: Any) -> None:
    """A result for a script: one JSON document on standard output."""
    print(json.dumps(data, indent=2, ensure_ascii=False))  # noqa: T201


def table(
    columns: Sequence[str],
    rows: Sequence[Sequence[object]],
    *,
    title: str = "",
    right: Sequence[str] = (),
) -> None:
    """A result for a person."""
    shown = Table(
        title=title or None,
        title_justify="left",
        header_style="bold",
        box=box.SIMPLE_HEAD,
        padding=(0, 1),
    )
    for name in columns:
        shown.add_column(
            name, justify="right" if name in right else "left", no_wrap=True, overflow="ellipsis"
        )
    for row in rows:
        shown.add_row(*(str(cell) for cell in row))
    out.print(shown)


def facts(pairs: Sequence[tuple[str, object]], *, title: str = "") -> None:
    """A short list of names and values."""
    shown = Table(
        title=title or None, title_justify="left", show_header=False, box=None, padding=(0, 2, 0, 0)
    )
    for name, value in pairs:
        shown.add_row(f"[bold]{name}[/bold]", str(value))
    out.print(shown)


def progress() -> Progress:
    """A progress bar on standard error; silent where that is no terminal."""
    columns = (
        SpinnerColumn(),
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TaskProgressColumn(),
    )
    return Progress(
        *columns,
        TimeRemainingColumn(),
        TextColumn("{task.fields[note]}"),
        console=err,
        disable=not err.is_terminal,
    )


class Interruption:
    """Whether Ctrl-C (or a polite kill) was received; true from then on."""

    def __init__(self) -> None:
        self.received = False

    def __bool__(self) -> bool:
        return self.received

    def _receive(self, number: int, frame: FrameType | None) -> None:
        if self.received:
            raise KeyboardInterrupt
        self.received = True


@contextmanager
def interruptible() -> Iterator[Interruption]:
    """Let the first Ctrl-C be a flag that the loop looks at between two steps.

    The second interrupts at once.
    """
    interruption = Interruption()
    before = {
        number: signal.signal(number, interruption._receive)
        for number in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        yield interruption
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def megabytes(count: int) -> str:
    """A size for a person."""
    return f"{count / 1e6:.1f} MB" if count >= 1e5 else f"{count / 1e3:.1f} kB"
