"""One way from tables, assignments and keywords to a config: names, types and ranges checked.

A config is a frozen dataclass: its fields are the one declaration of names, types, defaults and
docs. pydantic checks the types; `__post_init__` of the dataclass checks the ranges.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import asdict, fields, replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, get_type_hints

from coordlog.errors import ConfigError, unknown
from coordlog.strangers import recognise

if TYPE_CHECKING:
    from pydantic import TypeAdapter

T = TypeVar("T")

EXPECTED = {
    "bool_type": "true or false",
    "float_type": "a number",
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "string_type": "a text",
    "tuple_type": "a list",
    "none_required": "nothing",
}
"""What was wanted, by the type of pydantic's error."""
MOST = 1 << 20
"""Largest configuration file that is read [bytes]."""
PLURAL = {
    "a number": "numbers",
    "a whole number": "whole numbers",
    "a text": "texts",
    "true or false": "true or false",
}


def build(kind: type[T], values: Mapping[str, Any], *, prefix: str = "", what: str = "") -> T:
    """A config from a table of a file, of a log, or from keywords.

    Args:
        kind: Dataclass of the config.
        values: Values by field name; a list stands for a tuple, a whole number for a number.
        prefix: What stands before the names in a message, such as "learner.".
        what: What an unknown name is called in the message; by default "KIND key".

    Raises:
        ConfigError: for an unknown name (the message lists the choices), a value of another type,
            or one out of its range.

    Example:
        >>> from coordlog.tasks.config import EnvConfig
        >>> build(EnvConfig, {"max_steps": 20}).max_steps
        20
    """
    return kind(**_checked(kind, values, prefix=prefix, what=what))


def change(config: T, values: Mapping[str, Any], *, prefix: str = "", what: str = "") -> T:
    """The config with some values in place of its own; arguments and errors as for `build`."""
    checked = _checked(type(config), values, prefix=prefix, what=what)
    return replace(config, **checked)  # type: ignore[type-var]


def plain(config: Any) -> dict[str, Any]:
    """The config as JSON-able values; `build` is the inverse."""
    return {
        key: list(value) if isinstance(value, tuple) else value
        for key, value in asdict(config).items()
    }


def load_toml(path: Path, what: str) -> dict[str, Any]:
    """What a TOML file holds; `what` the file is stands in the messages.

    Raises:
        ConfigError: if the file cannot be read, is no file, is very large or is no TOML.
    """
    if path.exists() and not path.is_file():
        raise ConfigError(f"{path}: expected a file with the {what}, got a folder, pipe or device")
    try:
        with path.open("rb") as stream:
            data = stream.read(MOST + 1)
    except OSError as error:
        raise ConfigError(f"{path}: cannot read the {what}: {error.strerror}") from error
    if len(data) > MOST:
        raise ConfigError(f"{path}: expected a {what} of at most {MOST:,} bytes, got more")
    try:
        return tomllib.loads(data.decode("utf-8-sig"))
    except RecursionError:
        raise ConfigError(f"{path}: expected TOML, got one that is too deep") from None
    except ValueError as error:
        stranger = recognise(data, texts=False)
        got = f" {stranger}" if stranger else f": {error}"
        raise ConfigError(f"{path}: expected TOML, got{got}") from error


def read_toml(path: Path) -> dict[str, Any]:
    """The tables of a configuration file.

    Raises:
        ConfigError: as `load_toml`, or if something in it is no table.
    """
    tables = load_toml(path, "configuration")
    for name, table in tables.items():
        if not isinstance(table, dict):
            raise ConfigError(f"{path}: '{name}': expected a table [{name}], got {str(table)[:40]}")
    return tables


def parse_assignment(text: str) -> tuple[str, str, Any]:
    """Section, key and value of "section.key=value".

    The value is read as TOML, and as plain text where that fails.

    Raises:
        ConfigError: if the text has another form.
    """
    key, equals, value = text.partition("=")
    section, dot, name = key.strip().partition(".")
    if not (equals and section and dot and name):
        raise ConfigError(f"--set: expected section.key=value, got {text!r}")
    try:
        return section, name, tomllib.loads(f"value = {value}")["value"]
    except tomllib.TOMLDecodeError:
        return section, name, value.strip()


def _checked(
    kind: type[Any], values: Mapping[str, Any], *, prefix: str, what: str
) -> dict[str, Any]:
    """The values as the types that the fields declare."""
    if not isinstance(values, Mapping):
        where = prefix.rstrip(".") or kind.__name__
        raise ConfigError(f"{where}: expected a table of keys, got {values!r}")
    names = [item.name for item in fields(kind)]
    for key in values:
        if key not in names:
            choices = [f"{prefix}{name}" for name in names]
            raise unknown(what or f"{kind.__name__} key", f"{prefix}{key}", choices)
    return {key: _value(kind, key, value, prefix=prefix) for key, value in values.items()}


def _value(kind: Any, key: str, value: Any, *, prefix: str) -> Any:
    from pydantic import ValidationError

    given = _tuples(value)
    try:
        return _adapter(kind, key).validate_python(given, strict=True)
    except ValidationError as error:
        wanted = _wanted(error)
        raise ConfigError(f"{prefix}{key}: expected {wanted}, got {value!r}") from None


def _wanted(error: Any) -> str:
    """What the field takes, from what pydantic says of a value that it refused."""
    wanted = []
    for each in error.errors(include_url=False):
        name = EXPECTED.get(each["type"], each["msg"])
        if each["type"] == "literal_error":
            name = "one of " + each["ctx"]["expected"].replace("'", "").replace(" or ", ", ")
        if each["type"] in ("missing", "too_long"):
            wanted.append("another number of values")
            continue
        inside = any(isinstance(place, int) for place in each["loc"])
        wanted.append(f"a list of {PLURAL.get(name, name)}" if inside else name)
    return " or ".join(dict.fromkeys(wanted))


def _tuples(value: Any) -> Any:
    return tuple(_tuples(each) for each in value) if isinstance(value, list | tuple) else value


@cache
def _adapter(kind: Any, key: str) -> TypeAdapter[Any]:
    from pydantic import TypeAdapter

    return TypeAdapter(get_type_hints(kind)[key])
