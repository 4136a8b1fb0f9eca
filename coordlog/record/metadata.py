"""Header and Result ↔ the string maps of MCAP metadata records.

A string stands as it is, everything else as compact JSON; a string that would read as JSON is
quoted, so that decoding is exact. Floats keep every bit (shortest repr); dicts keep their order,
which for `env["arms"]` is the order of columns.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, fields
from functools import lru_cache
from typing import Any

from coordlog.episode import Header, Json, Result
from coordlog.errors import FormatError, SpecError
from coordlog.spec import SCHEMA_VERSION, Layout

PREFIX = "coordlog."
EPISODE, ENV = PREFIX + "episode", PREFIX + "env"
RESULT = PREFIX + "result"
HEADER_RECORDS = tuple(PREFIX + item.name for item in fields(Header))
"""Names of the metadata records that open a file, in order."""

_RESULT_TYPES: dict[str, type] = {
    item.name: {"int": int, "bool": bool, "str": str}.get(str(item.type), list)
    for item in fields(Result)
}

MAX_WIDTH = 1 << 16
"""Longest sequence of a message: a damaged layout must not exhaust the memory."""
MAX_TIME = (1 << 63) - 1
"""Latest start of an episode [ns since the epoch] that a log time can hold."""

Strings = Mapping[str, str]


def encode(values: Json) -> dict[str, str]:
    """A JSON-able dict as a string map.

    Raises:
        SpecError: if a value cannot be written as JSON; names the key.
    """
    return {key: _encode_value(key, value) for key, value in values.items()}


def decode(strings: Strings) -> Json:
    """The inverse of `encode`."""
    return {key: _decode_value(text) for key, text in strings.items()}


def _encode_value(key: str, value: Any) -> str:
    if isinstance(value, str) and _decode_value(value) is value:
        return value
    try:
        return json.dumps(value, separators=(",", ":"), ensure_ascii=False)
    except (TypeError, ValueError) as error:
        raise SpecError(
            f"metadata '{key}': expected a value that JSON can hold, got {type(value).__name__}: {error}"
        ) from None


def _decode_value(text: str) -> Any:
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        return text


def encode_header(header: Header) -> dict[str, dict[str, str]]:
    """One string map per metadata record that opens a file."""
    return {PREFIX + item.name: encode(getattr(header, item.name)) for item in fields(Header)}


def decode_header(records: Mapping[str, Strings]) -> Header:
    """The header out of a file's metadata records.

    Raises:
        FormatError: if a record or a key that reading depends on is missing, or the schema version
            is another one.
    """
    require_version(records.get(EPISODE, {}))
    missing = [name for name in HEADER_RECORDS if name not in records]
    if missing:
        raise FormatError(f"metadata {', '.join(missing)} missing: not a coordlog episode")
    _require_episode(decode(records[EPISODE]))
    _require_env(tuple(records[ENV].items()))
    return Header(*(decode(records[name]) for name in HEADER_RECORDS))


def require_readable(records: Mapping[str, Strings]) -> None:
    """Hold the records of a header that is about to be written to what `decode_header` wants,
    without decoding them anew each time.

    Raises:
        FormatError: as `decode_header`.
    """
    require_version(records[EPISODE])
    _require_episode(decode(records[EPISODE]))
    _require_env(tuple(records[ENV].items()))


def _require_episode(episode: Json) -> None:
    _require(episode, {"start_time": int}, EPISODE)
    _require_range({"start_time": episode["start_time"]}, MAX_TIME, EPISODE)


@lru_cache(maxsize=8)
def _require_env(items: tuple[tuple[str, str], ...]) -> None:
    """The record `coordlog.env` is the same for all episodes of a run: judge it once."""
    env = dict(items)
    decode_layout(env)
    _require(decode(env), {"joints": list}, ENV)


def decode_layout(env: Strings) -> tuple[Layout, tuple[str, ...]]:
    """Layout and names of the arms out of the metadata record `coordlog.env`: all that decoding
    messages needs.

    Raises:
        FormatError: if a key is missing.
    """
    return _decode_layout(env.get("layout", ""), env.get("arms", ""))


@lru_cache(maxsize=64)
def _decode_layout(layout: str, arms: str) -> tuple[Layout, tuple[str, ...]]:
    values = decode({"layout": layout, "arms": arms})
    _require(values, {"layout": dict, "arms": dict}, ENV)
    _require(values["layout"], {item.name: int for item in fields(Layout)}, ENV + " layout")
    _require_range(values["layout"], MAX_WIDTH, ENV + " layout")
    return Layout(**values["layout"]), tuple(values["arms"])


def require_version(episode: Strings) -> None:
    """Hold the metadata record `coordlog.episode` to the schema version of this release.

    Raises:
        FormatError: if it is of another version, or says none.
    """
    version = episode.get("schema_version")
    if version is None:
        raise FormatError(f"metadata {EPISODE}: schema_version missing: not a coordlog episode")
    if version != str(SCHEMA_VERSION):
        raise FormatError(
            f"schema version {version}; this release reads version {SCHEMA_VERSION}: use the coordlog that wrote it"
        )


def encode_result(result: Result) -> dict[str, str]:
    """The string map of the commit marker."""
    return encode(asdict(result))


def decode_result(strings: Strings) -> Result:
    """The inverse of `encode_result`.

    Raises:
        FormatError: if a key is missing or holds a value of another type.
    """
    values = decode(strings)
    _require(values, _RESULT_TYPES, RESULT)
    values["returns"] = tuple(values["returns"])
    return Result(**{name: values[name] for name in _RESULT_TYPES})


def _require(values: Json, kinds: Mapping[str, type], where: str) -> None:
    for key, kind in kinds.items():
        if type(values.get(key)) is not kind:
            raise FormatError(
                f"metadata {where}: '{key}': expected {kind.__name__}, got {values.get(key)!r}"
            )


def _require_range(values: Mapping[str, int], limit: int, where: str) -> None:
    for key, value in values.items():
        if not 0 <= value <= limit:
            raise FormatError(f"metadata {where}: '{key}': expected 0 to {limit}, got {value}")
