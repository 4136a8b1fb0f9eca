"""What long work tells whoever waits for it: how far it is, what is worth a word, and whether to
stop.

A verb takes a `Monitor` and knows nothing of terminals. This one is for programs: notes go to the
log "coordlog" of `logging`, progress nowhere. The command line has one that draws bars.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager


class Progress:
    """How far one piece of work is."""

    def __init__(self) -> None:
        self.done: float = 0.0

    def advance(self, count: float, note: str | None = None) -> None:
        """Say that so much more is done, and, if a note is given, how it goes."""
        self.update(self.done + count, note)

    def update(self, done: float, note: str | None = None) -> None:
        """Say how much is done."""
        self.done = done


class Monitor:
    """Hears of progress and notes, and never asks to stop.

    Example:
        >>> monitor = Monitor()
        >>> with monitor.progress("smoothing", total=2) as progress:
        ...     progress.advance(1)
        >>> monitor.stopped
        False
    """

    @property
    def stopped(self) -> bool:
        """Whether the work should end between two steps, with all that is done so far."""
        return False

    def note(self, text: str) -> None:
        """Hear of something that is not a result: a file left out, a doubt."""
        logging.getLogger("coordlog").warning("%s", text)

    @contextmanager
    def progress(self, what: str, total: float | None) -> Iterator[Progress]:
        """Follow one piece of work.

        Args:
            what: It, in a word or two.
            total: How much there is to do; None if nobody knows yet.
        """
        yield Progress()
