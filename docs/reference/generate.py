"""Fill in what the documentation says and the code knows: tables of fields and settings, every
option, the home page.

A page holds `<!-- generated: NAME -->` … `<!-- end -->`; what stands between is written anew by
`python docs/reference/generate.py` (`make schemas`), and a test compares. What stands around is
written by hand.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import cache
from pathlib import Path

import griffe
import typer.cli
from typer.testing import CliRunner

from coordlog.spec import MESSAGES, Message
from coordlog.train.settings import PRESETS

DOCS = Path(__file__).parents[1]
README = DOCS.parent / "README.md"
MARK = re.compile(r"<!-- generated: (?P<name>[\w .]+) -->\n.*?<!-- end -->", re.DOTALL)


def fill(text: str) -> str:
    """A page with everything between its marks written anew.

    Raises:
        KeyError: for a mark that nothing here fills.
    """

    def write(mark: re.Match[str]) -> str:
        kind, *arguments = mark["name"].split()
        return f"<!-- generated: {mark['name']} -->\n\n{WRITERS[kind](*arguments).strip()}\n\n<!-- end -->"

    return MARK.sub(write, text)


def messages() -> str:
    """The messages of an episode file, a table each."""
    return "\n\n".join(_message(message) for message in MESSAGES)


def _message(message: Message) -> str:
    topic = f"`{message.topic}`" if not message.topic.endswith("/") else f"`{message.topic}NAME`"
    rows = [
        (
            f"`{item.name}`",
            f"`{item.type}{'[]' if item.size else ''}`",
            item.size,
            item.unit,
            item.doc,
        )
        for item in message.fields
    ]
    return f"### {topic}\n\n`{message.name}`. {message.doc}\n\n{_table(('field', 'type', 'length', 'unit', 'meaning'), rows)}"


def fields(module: str, name: str) -> str:
    """The attributes of a class and what is said below each, as a list."""
    said = [(attribute, " ".join(text.split())) for attribute, _, text in _attributes(module, name)]
    return "\n".join(f"- `{attribute}`" + (f": {text}" if text else "") for attribute, text in said)


def settings(section: str) -> str:
    """The settings of a section in every preset."""
    name = type(getattr(PRESETS["default"], section)).__name__
    rows = []
    for key, _, said in _attributes("coordlog.train.config", name):
        values = [
            f"`{_toml(getattr(getattr(preset, section), key))}`" for preset in PRESETS.values()
        ]
        rows.append((f"`{section}.{key}`", *values, " ".join(said.split())))
    return _table(("setting", *(f"`{preset}`" for preset in PRESETS), "meaning"), rows)


def constants(module: str, name: str) -> str:
    """The fields of a configuration with their defaults."""
    rows = [
        (f"`{key}`", f"`{default}`", " ".join(said.split()))
        for key, default, said in _attributes(module, name)
    ]
    return _table(("key", "default", "meaning"), rows)


def commands() -> str:
    """Every command with its arguments and options, as typer documents them."""
    done = CliRunner().invoke(
        typer.cli.app,
        ["coordlog.cli", "utils", "docs", "--name", "coordlog"],
        catch_exceptions=False,
    )
    text = done.stdout.partition("\n## ")[2]
    return f"## {text}".replace("```console\n$ ", "```console\n")


def home() -> str:
    """The README, with links as they are from inside `docs/`."""
    text = README.read_text(encoding="utf-8")
    return text.replace("](docs/", "](").replace(
        "](schemas/coordlog_msgs/msg)", "](reference/file-format.md)"
    )


WRITERS: dict[str, Callable[..., str]] = {
    item.__name__: item for item in (messages, fields, settings, constants, commands, home)
}


def _attributes(module: str, name: str) -> list[tuple[str, str, str]]:
    """Name, default as it is written, and docstring of every field of a dataclass."""
    found = [
        item
        for item in _module(module)[name].members.values()
        if item.is_attribute and "property" not in item.labels
    ]
    return [
        (item.name, str(item.value or ""), item.docstring.value if item.docstring else "")
        for item in found
    ]


@cache
def _module(name: str) -> griffe.Object:
    """A module as its source says, not imported."""
    return griffe.visit(
        name,
        filepath=(path := DOCS.parent / f"{name.replace('.', '/')}.py"),
        code=path.read_text(encoding="utf-8"),
    )


def _toml(value: object) -> str:
    """A value as it is written after `--set section.key=`."""
    if isinstance(value, bool):
        return str(value).lower()
    return (
        str(list(value))
        if isinstance(value, tuple)
        else f'"{value}"'
        if isinstance(value, str)
        else f"{value}"
    )


def _table(columns: tuple[str, ...], rows: list[tuple[str, ...]]) -> str:
    lines = [columns, ("---",) * len(columns), *rows]
    return "\n".join(
        "| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines
    )


def pages() -> list[Path]:
    """Every page that has a mark."""
    return [
        path for path in sorted(DOCS.rglob("*.md")) if MARK.search(path.read_text(encoding="utf-8"))
    ]


if __name__ == "__main__":
    for page in pages():
        page.write_text(fill(page.read_text(encoding="utf-8")), encoding="utf-8")
