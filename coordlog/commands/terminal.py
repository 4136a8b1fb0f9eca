"""What every command says to a person: tables, progress, notes.

Results go to standard output, everything else to standard error. Nothing that comes from a file or
a path is markup or an escape sequence here: control characters are shown, never obeyed.
"""

from __future__ import annotations

import codecs
import json
import math
import os
import re
import signal
import sys
import unicodedata
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from types import FrameType
from typing import Any, TextIO

from rich import box
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    SpinnerColumn,
    TaskID,
    TaskProgressColumn,
    TextColumn,
    TimeRemainingColumn,
)
from rich.table import Table
from rich.text import Text

from coordlog import monitor
from coordlog.errors import WorkerError

PIPED_WIDTH = 180
"""Columns where the output is no terminal: a file or a pager does not wrap."""

_INVISIBLE = {"Cc", "Cf", "Cs", "Co", "Zl", "Zp"}
"""Unicode categories of what a terminal might obey instead of showing."""
_PLAIN = {"₁": "1", "₂": "2", "µ": "u", "×": "x", "…": "...", "→": "->", "≤": "<=", "≥": ">="}
_ERRORS = "coordlog.plain"
_ADDRESS = re.compile(r"(?<![\w/])(s3|gs|az):/(?=[^/])")


class _Console(Console):
    """A console whose reader may go away: what is said then goes nowhere, and the work goes on."""

    def on_broken_pipe(self) -> None:
        """Say the rest to nobody."""
        forsake(self.file)


def _console(stream: TextIO | None, *, stderr: bool = False) -> Console:
    width = None if stream is not None and stream.isatty() else PIPED_WIDTH
    return _Console(stderr=stderr, width=width, markup=False, highlight=False, emoji=False)


def forsake(stream: Any) -> None:
    """Let a stream that nobody reads any more end in nothing."""
    null = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(null, stream.fileno())
    except (OSError, ValueError):  # no descriptor: a stream of a test
        pass
    finally:
        os.close(null)


def prepare_streams() -> None:
    """Make the process's streams take whatever is said: a character that the encoding lacks is
    written plainly, and a stream that is closed from the start swallows everything.
    """
    codecs.register_error(_ERRORS, _plainly)
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115
        elif hasattr(stream, "reconfigure"):
            stream.reconfigure(errors=_ERRORS)


def hear_warnings() -> None:
    """Say what libraries warn of as notes, each once, without the line of code it came from."""
    heard = set()

    def say_once(message: Warning | str, *_: Any, **__: Any) -> None:
        text = " ".join(str(message).split())
        if text not in heard:
            heard.add(text)
            note(text)

    warnings.showwarning = say_once


def _plainly(error: UnicodeError) -> tuple[str, int]:
    """The error handler: characters of ours in ASCII, all others as their escapes."""
    assert isinstance(error, UnicodeEncodeError)
    lacking = error.object[error.start : error.end]
    plain = "".join(_PLAIN.get(each) or ascii(each)[1:-1] for each in lacking)
    return plain, error.end


out = _console(sys.stdout)
err = _console(sys.stderr, stderr=True)


def shown(text: object) -> str:
    r"""A text with all that a terminal might obey written as escapes.

    Example:
        >>> shown("a\x1b[31mb")
        'a\\x1b[31mb'
    """
    whole = _ADDRESS.sub(r"\1://", str(text))  # paths spell s3://a with one slash
    return "".join(
        ascii(each)[1:-1] if unicodedata.category(each) in _INVISIBLE else each for each in whole
    )


def say(text: object, *, style: str = "") -> None:
    """One line of a result."""
    out.print(Text(shown(text), style=style), soft_wrap=True)


def note(text: object) -> None:
    """One line that is not a result."""
    err.print(Text(shown(text), style="yellow"), soft_wrap=True)


def complain(text: object) -> None:
    """The one sentence that a command ends with."""
    err.print(Text.assemble(("error: ", "bold red"), shown(text)), soft_wrap=True)


def print_json(data: Any) -> None:
    """A result for a script: one JSON document on standard output.

    Numbers that JSON lacks are null; what the encoding lacks is written as JSON escapes.
    """
    text = json.dumps(_finite(data), indent=2, ensure_ascii=False, default=str)
    try:
        text.encode(sys.stdout.encoding or "utf-8")
    except UnicodeEncodeError:
        text = json.dumps(_finite(data), indent=2, default=str)
    try:
        print(text, flush=True)  # noqa: T201
    except BrokenPipeError:
        forsake(sys.stdout)


def _finite(data: Any) -> Any:
    if isinstance(data, float) and not math.isfinite(data):
        return None
    if isinstance(data, dict):
        return {str(key): _finite(value) for key, value in data.items()}
    if isinstance(data, list | tuple):
        return [_finite(value) for value in data]
    return data


def table(
    columns: Sequence[str],
    rows: Sequence[Sequence[object]],
    *,
    title: str = "",
    right: Sequence[str] = (),
) -> None:
    """A result for a person."""
    drawn = Table(
        title=Text(shown(title)) if title else None,
        title_justify="left",
        header_style="bold",
        box=box.SIMPLE_HEAD,
        padding=(0, 1),
    )
    for name in columns:
        drawn.add_column(
            Text(shown(name)),
            justify="right" if name in right else "left",
            no_wrap=True,
            overflow="ellipsis",
        )
    for row in rows:
        drawn.add_row(*(Text(shown(cell)) for cell in row))
    out.print(drawn)


def facts(pairs: Sequence[tuple[str, object]], *, title: str = "") -> None:
    """A short list of names and values."""
    drawn = Table(
        title=Text(shown(title)) if title else None,
        title_justify="left",
        show_header=False,
        box=None,
        padding=(0, 2, 0, 0),
    )
    for name, value in pairs:
        drawn.add_row(Text(shown(name), style="bold"), Text(shown(value)))
    out.print(drawn)


def progress() -> Progress:
    """A progress bar on standard error; silent where that is no terminal."""
    columns = (
        SpinnerColumn(),
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TaskProgressColumn(),
    )
    return Progress(
        *columns,
        TimeRemainingColumn(),
        TextColumn("{task.fields[note]}", markup=False),
        console=err,
        disable=not err.is_terminal,
    )


class _Bar(monitor.Progress):
    """A bar of its own for one piece of work."""

    def __init__(self, bars: Progress, task: TaskID) -> None:
        super().__init__()
        self._bars, self._task = bars, task

    def update(self, done: float, note: str | None = None) -> None:
        """Draw it."""
        super().update(done)
        fields: dict[str, Any] = {} if note is None else {"note": note}
        self._bars.update(self._task, completed=done, **fields)


class Watcher(monitor.Monitor):
    """Draws bars and prints notes; within `interruptible`, Ctrl-C (or a polite kill) asks to stop.

    True from then on.
    """

    def __init__(self) -> None:
        self._received = False

    @property
    def stopped(self) -> bool:
        """Whether somebody asked to stop."""
        return self._received

    def __bool__(self) -> bool:
        return self._received

    def note(self, text: str) -> None:
        """Print it."""
        note(text)

    @contextmanager
    def progress(self, what: str, total: float | None) -> Iterator[monitor.Progress]:
        """Draw a bar."""
        with progress() as bars:
            yield _Bar(bars, bars.add_task(shown(what), total=total, note=""))

    def _receive(self, number: int, frame: FrameType | None) -> None:
        if self._received:
            raise KeyboardInterrupt
        self._received = True


@contextmanager
def interruptible() -> Iterator[Watcher]:
    """Let the first Ctrl-C be a flag that the loop looks at between two steps.

    The second interrupts at once.
    """
    watcher = Watcher()
    before = {
        number: signal.signal(number, watcher._receive)
        for number in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        yield watcher
    except WorkerError:  # what stops this process often stops its whole group
        if watcher.stopped:
            raise KeyboardInterrupt from None
        raise
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def megabytes(count: int) -> str:
    """A size for a person."""
    return f"{count / 1e6:.1f} MB" if count >= 1e5 else f"{count / 1e3:.1f} kB"
