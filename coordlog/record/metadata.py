"""Header and Result ↔ the string maps of MCAP metadata records.

A string stands as it is, everything else as compact JSON; a string that would read as JSON is
quoted, so that decoding is exact. Floats keep every bit (shortest repr); dicts keep their order,
which for `env["arms"]` is the order of columns.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections.abc import Mapping
from dataclasses import asdict, fields
from functools import lru_cache
from typing import Any

from coordlog.episode import LAYOUT_KEYS, Header, Json, Result
from coordlog.errors import FormatError, NewerError, SpecError
from coordlog.record import declared
from coordlog.record.cdr import TYPES
from coordlog.spec import READABLE, STEP, Layout, names

PREFIX = "coordlog."
EPISODE, ENV = PREFIX + "episode", PREFIX + "env"
RESULT = PREFIX + "result"
HEADER_RECORDS = tuple(PREFIX + item.name for item in fields(Header))
"""Names of the metadata records that open a file, in order."""

_TABLES = {
    EPISODE: declared.EPISODE,
    ENV: declared.ENV,
    PREFIX + "policy": declared.POLICY,
    PREFIX + "lineage": declared.LINEAGE,
}

Strings = Mapping[str, str]

_parse = json.JSONDecoder().decode
_SPACE = " \t\n\r"
_WORDS = {"null": None, "true": True, "false": False, "NaN": math.nan, "Infinity": math.inf}
_NUMBER = re.compile(rf"(0|[1-9][0-9]*)(\.[0-9]+)?([eE][+-]?[0-9]+)?[{_SPACE}]*\Z")
"""JSON that begins with a letter, or a digit: most texts are neither, and failing is slow."""


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
            f"metadata '{key}': expected a value that JSON can hold, got {type(value).__name__}: "
            f"{error}"
        ) from None


def _decode_value(text: str) -> Any:
    first = text[:1]
    if first.isalpha() or not first:
        return _WORDS.get(text.rstrip(_SPACE), text)
    try:
        if first.isdigit() and not _NUMBER.match(text):  # a digest, say
            return text
        return _parse(text)
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
    require_readable(records)
    return Header(*(decode(records[name]) for name in HEADER_RECORDS))


def require_readable(records: Mapping[str, Strings]) -> None:
    """Hold the records of a header to what is declared of them.

    Raises:
        FormatError: naming the record and the key.
    """
    require_version(records[EPISODE])
    for name in HEADER_RECORDS:
        _require_declared(name, tuple(records[name].items()))


@lru_cache(maxsize=256)
def _require_declared(name: str, items: tuple[tuple[str, str], ...]) -> None:
    """Most records are the same for all episodes of a run: judge them once."""
    table = _TABLES[name]
    values = decode({key: text for key, text in items if key in table})
    declared.require(values, table, f"metadata {name}")
    if name == ENV:
        declared.require(values["layout"], declared.LAYOUT, f"metadata {ENV} layout")
        _require_env(values)


def _require_env(env: Json) -> None:
    """Hold what one key of `coordlog.env` says of another to it."""
    layout = _layout(env["layout"])
    for joint in env["joints"]:
        if joint["qpos"] >= layout.n_q or joint["qvel"] >= layout.n_v:
            raise FormatError(
                f"metadata {ENV}: 'joints': expected addresses below {layout.n_q} and "
                f"{layout.n_v}, got {joint}"
            )
    for arm, indices in env["arms"].items():
        if any(index >= layout.n_u for index in indices):
            raise FormatError(
                f"metadata {ENV}: 'arms': expected action indices below {layout.n_u}, got {arm}: "
                f"{indices}"
            )
    for item in env.get("task", {}).get("fields", ()):
        sizes = (*LAYOUT_KEYS, "n_j")
        known = all(part.isdecimal() or part in sizes for part in item["size"].split("*"))
        if not item["name"].isidentifier() or item["name"] in names(STEP.fields):
            raise FormatError(
                f"metadata {ENV}: 'task': expected a field with a name of its own, got {item}"
            )
        if item["type"] not in TYPES or item["when"] not in ("before", "after"):
            raise FormatError(
                f"metadata {ENV}: 'task': expected a field of a primitive type, before or after, "
                f"got {item}"
            )
        if item["size"] and (not known or not _fits(item["size"])):
            raise FormatError(
                f"metadata {ENV}: 'task': expected a size of numbers and symbols, got {item}"
            )


def _fits(size: str) -> bool:
    """Whether the numbers in a size are no larger than a message may be."""
    product = 1
    for part in size.split("*"):
        product *= int(part[:9]) if part.isdecimal() else 1
    return product <= declared.MAX_WIDTH


def _layout(values: Json) -> Layout:
    return Layout(**{key: values.get(key, 0) for key in LAYOUT_KEYS})


def require_version(episode: Strings) -> int:
    """The schema version that the metadata record `coordlog.episode` says, if it is one that this
    release reads.

    Raises:
        NewerError: if it is of a later version.
        FormatError: if it is of another one, or says none.
    """
    version = episode.get("schema_version")
    if version is None:
        raise FormatError(f"metadata {EPISODE}: schema_version missing: not a coordlog episode")
    if version in map(str, READABLE):
        return int(version)
    reads = f"this release reads versions {READABLE[0]} to {READABLE[-1]}"
    if version.isdecimal() and int(version[:9]) > READABLE[-1]:
        raise NewerError(
            f"schema version {version}; {reads}: a release of coordlog that writes version "
            f"{version}, or a later one, reads it (pip install --upgrade coordlog)"
        )
    raise FormatError(f"schema version {version!r}; {reads}: the record is damaged")


def encode_result(result: Result) -> dict[str, str]:
    """The string map of what a result says."""
    return encode(asdict(result))


def decode_result(strings: Strings) -> Result:
    """The inverse of `encode_result`; what else the record holds is left.

    Raises:
        FormatError: if a key is missing or holds a value of another type.
    """
    values = decode({key: strings[key] for key in declared.RESULT if key in strings})
    declared.require(values, declared.RESULT, f"metadata {RESULT}")
    values["returns"] = tuple(values["returns"])
    return Result(**{item.name: values[item.name] for item in fields(Result)})


def digest(values: Strings) -> str:
    """sha256 of a metadata record: of its keys and values in the order of keys, each preceded by
    its length as uint32.
    """
    parts = [text.encode() for pair in sorted(values.items()) for text in pair]
    packed = b"".join([len(part).to_bytes(4, "little") + part for part in parts])
    return hashlib.sha256(packed).hexdigest()


def encode_commit(
    result: Result,
    *,
    metadata: Mapping[str, Strings],
    attachments: Mapping[str, str],
    messages: Mapping[str, tuple[int, int]],
) -> dict[str, str]:
    """The string map of the commit marker, to be `sealed`: the result, and what it vouches for
    whatever container that stands in.

    Args:
        result: How the episode ended.
        metadata: The records that opened the file.
        attachments: sha256 of each attachment, by name.
        messages: Count and CRC-32 of the payloads of each topic that is not for looking alone.
    """
    return encode_result(result) | encode(
        {
            "metadata": {name: digest(values) for name, values in metadata.items()},
            "attachments": dict(attachments),
            "messages": {topic: list(pair) for topic, pair in messages.items()},
        }
    )


def sealed(marker: Strings, before: int, summary: int) -> dict[str, str]:
    """A commit marker with what it says of the bytes around it, and its own seal; of one length
    whatever the numbers.

    Args:
        marker: From `encode_commit`.
        before: CRC-32 of all bytes of the file before the marker's record.
        summary: CRC-32 of its summary, as the footer has it.
    """
    strings = {**marker, "bytes": bytes_text(before, summary)}
    return strings | {"seal": digest(strings)}


def bytes_text(before: int, summary: int) -> str:
    """What a commit marker says of the bytes before it and of the summary: their CRCs."""
    return f'["{before:08x}","{summary:08x}"]'


def vouched(records: Mapping[str, Strings]) -> Json:
    """What the commit marker of a finished file vouches for, once its own seal and the metadata
    records have been held to it; empty for files of version 1, which have no such thing.

    Raises:
        FormatError: if the marker or a record is not as it was written; names the record.
    """
    if require_version(records.get(EPISODE, {})) == 1:
        return {}
    strings = dict(records[RESULT])
    values = decode(strings)
    declared.require(values, declared.COMMIT, f"metadata {RESULT}")
    if strings.pop("seal") != digest(strings):
        raise FormatError(f"metadata {RESULT}: the record is damaged: its seal is another")
    for name in HEADER_RECORDS:
        if name not in values["metadata"]:
            raise FormatError(f"metadata {RESULT}: it does not vouch for {name}")
    for name, wanted in values["metadata"].items():
        if name not in records:
            raise FormatError(f"metadata {name} missing: the commit marker names it")
        if digest(records[name]) != wanted:
            raise FormatError(f"metadata {name}: the record is damaged: its digest is another")
    kinds = ("metadata", "attachments", "messages", "bytes")
    return {key: values[key] for key in kinds if key in values}
