"""The command line in this process: what a command says, and how it ends."""

from __future__ import annotations

import os
from pathlib import Path
from typing import NamedTuple

import pytest
from typer.testing import CliRunner

from coordlog import cli
from coordlog.errors import EXIT_INTERRUPTED, CoordlogError


class Said(NamedTuple):
    """How a command ended."""

    exit_code: int
    stdout: str
    stderr: str
    unforeseen: BaseException | None
    """An error that nobody raised on purpose: a user would see a traceback without the net that
    `cli.main` spans below everything."""


def said(*args: object, cache: Path | None = None) -> Said:
    """Run a command as `cli.main` does, but for its net; with a cache folder of its own."""
    words = [os.fspath(arg) if isinstance(arg, os.PathLike) else str(arg) for arg in args]
    env = {} if cache is None else {"XDG_CACHE_HOME": str(cache)}
    done = CliRunner().invoke(cli.app, words, env=env)
    error = done.exception
    if isinstance(error, CoordlogError):
        return Said(error.exit_code, done.stdout, f"{done.stderr}error: {error}\n", None)
    if isinstance(error, KeyboardInterrupt):
        return Said(EXIT_INTERRUPTED, done.stdout, done.stderr, None)
    if error is not None and not isinstance(error, SystemExit):
        return Said(1, done.stdout, done.stderr, error)
    return Said(done.exit_code, done.stdout, done.stderr, None)


def sound(*args: object, code: int = 0, cache: Path | None = None) -> Said:
    """Run a command that must end with this exit code and no traceback."""
    done = said(*args, cache=cache)
    if done.unforeseen is not None:
        raise done.unforeseen
    if done.exit_code != code:
        pytest.fail(f"exit code {done.exit_code}, not {code}: {done.stdout}{done.stderr}")
    return done
