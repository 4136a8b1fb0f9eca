"""Arguments and options that several commands share, each declared once with its help.

A signature has one line for each option; what only one command has is declared above it, and what
is as short as a flag in the signature itself:

    def check(path: Files, level: Level = "replay", jobs: Jobs = "0",
              as_json: Annotated[bool, json_flag("the findings")] = False) -> None: ...
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Annotated, Any, TypeVar

import typer

Plan = TypeVar("Plan")

Files = Annotated[
    list[Path], typer.Argument(help="Files, or folders that are searched at any depth.")
]
Episodes = Annotated[
    list[Path], typer.Argument(help="Episode files, or folders that are searched at any depth.")
]
Jobs = Annotated[
    str,
    typer.Option(help="Processes, 0 for one per core; ray or ray://HOST:PORT for a cluster."),
]
Shard = Annotated[
    str,
    typer.Option(
        help="The I-th of N equal shares of the work, 1/N to N/N: one for each job of an array.",
        metavar="I/N",
    ),
]


def flag(name: str, text: str) -> Any:
    """An option that is given or not, under one name and with no opposite: "--force"."""
    return typer.Option(name, help=text)


def json_flag(what: str) -> Any:
    """The flag --json, of a command that prints `what` then."""
    return flag("--json", f"Print {what} as JSON.")


def chosen(kind: type[Plan], given: Mapping[str, Any]) -> Plan:
    """A dataclass from the options of a command, by name; those that are no fields are left out."""
    names = {field.name for field in fields(kind)}  # type: ignore[arg-type]
    return kind(**{name: value for name, value in given.items() if name in names})
