"""What each metadata record of a file, and the head of a manifest, must hold: every key, its type
and its bounds, in one place.

A record is believed by nobody before it was held to these tables. Keys that are not listed are
kept and not looked at.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from coordlog.episode import FIELD_KEYS, KINDS, LAYOUT_KEYS, Json
from coordlog.errors import FormatError

MAX_WIDTH = 1 << 16
"""Longest sequence of a message: a damaged layout must not exhaust the memory."""
MAX_TIME = (1 << 63) - 1
"""Latest start of an episode [ns since the epoch] that a log time can hold."""
MAX_NUMBER = 1e12
"""Largest constant that is believed."""


class Rule(NamedTuple):
    """What a value must be, in words and as a test."""

    says: str
    holds: Callable[[Any], bool]
    required: bool = True


def _is_whole(low: int, high: int) -> Callable[[Any], bool]:
    return lambda value: type(value) is int and low <= value <= high


def _is_number(value: Any) -> bool:
    return type(value) in (int, float) and math.isfinite(value) and abs(value) <= MAX_NUMBER


def _is_text(value: Any) -> bool:
    return isinstance(value, str)


def _is_texts(value: Any) -> bool:
    return isinstance(value, list) and all(map(_is_text, value))


def _is_numbers(value: Any) -> bool:
    return isinstance(value, list) and all(map(_is_number, value))


def _is_rows(width: int) -> Callable[[Any], bool]:
    return lambda value: (
        isinstance(value, list) and all(_is_numbers(row) and len(row) == width for row in value)
    )


def _is_mapping(of: Callable[[Any], bool]) -> Callable[[Any], bool]:
    return lambda value: isinstance(value, dict) and all(map(of, value.values()))


def _has(**keys: Callable[[Any], bool]) -> Callable[[Any], bool]:
    return lambda value: (
        isinstance(value, dict)
        and all(key in value and holds(value[key]) for key, holds in keys.items())
    )


def _is_list(of: Callable[[Any], bool]) -> Callable[[Any], bool]:
    return lambda value: isinstance(value, list) and all(map(of, value))


_INDEX = _is_whole(0, MAX_WIDTH)
TEXT = Rule("text", _is_text)
TEXTS = Rule("a list of texts", _is_texts)
MAPPING = Rule("an object", lambda value: isinstance(value, dict))
TRUTH = Rule("true or false", lambda value: type(value) is bool)

EPISODE: dict[str, Rule] = {
    "kind": Rule(f"one of {', '.join(KINDS)}", lambda value: value in KINDS, required=False),
    "id": TEXT,
    "run": TEXT,
    "robot": TEXT,
    "scene": TEXT,
    "split": TEXT,
    "seed": Rule("a whole number or null", lambda value: value is None or type(value) is int),
    "index": Rule("a whole number from 0", _is_whole(0, 1 << 62)),
    "start": TEXT,
    "control_period": Rule(
        "seconds, more than 0", lambda value: _is_number(value) and 0 < value <= 1e6
    ),
    "start_time": Rule(f"0 to {MAX_TIME}", _is_whole(0, MAX_TIME)),
    "goals": Rule("a list of [x, y, z]", _is_rows(3)),
    "obstacles": Rule("a list of [x, y, z, radius]", _is_rows(4)),
}
_ARM = _has(name=_is_text, palm=_is_text, joints=_is_texts)
_ROBOT: dict[str, Rule] = {
    "arms": Rule("a list of {name, palm, joints}", _is_list(_ARM)),
    "shared": TEXTS,
    "soles": TEXTS,
    "torso": TEXT,
    "poses": Rule("an object of {joint: angle}", _is_mapping(_is_mapping(_is_number))),
    "centre": Rule("[x, y, z]", lambda value: _is_numbers(value) and len(value) == 3),
    "reach": Rule("a number", _is_number),
}
ENV: dict[str, Rule] = {
    "coordlog_version": TEXT,
    "mujoco_version": TEXT,
    "architecture": TEXT,
    "task": Rule(
        "an object with a 'name' and a list of 'fields'",
        _has(name=_is_text, fields=_is_list(_has(**dict.fromkeys(FIELD_KEYS, _is_text)))),
        required=False,
    ),
    "reward": MAPPING,
    "config": MAPPING,
    "robot": Rule(
        "an object with a 'name', and arms, shared, soles, torso, poses, centre, reach",
        lambda value: _has(name=_is_text)(value) and not _broken(value, _ROBOT, complete=False),
    ),
    "joints": Rule(
        "a list of {name, qpos, qvel}", _is_list(_has(name=_is_text, qpos=_INDEX, qvel=_INDEX))
    ),
    "actuators": TEXTS,
    "geoms": TEXTS,
    "model_sha256": Rule("text", _is_text, required=False),
    "arms": Rule("an object of lists of action indices", _is_mapping(_is_list(_INDEX))),
    "action_joints": TEXTS,
    "state": TEXTS,
    "state_places": Rule("an object of [first, last + 1]", _is_mapping(_is_list(_INDEX)), False),
    "state_offset": Rule("a list of numbers", _is_numbers, required=False),
    "state_scale": Rule("a list of numbers", _is_numbers, required=False),
    "layout": MAPPING,
}
LAYOUT: dict[str, Rule] = {
    key: Rule(f"0 to {MAX_WIDTH}", _INDEX, required=key != "n_c") for key in LAYOUT_KEYS
}
POLICY: dict[str, Rule] = {
    "kind": TEXT,
    "name": TEXT,
    "checkpoint_sha256": TEXT,
    "noise": MAPPING,
    "constants": Rule("an object", lambda value: isinstance(value, dict), required=False),
    "shield": Rule("text", _is_text, required=False),
    "damper": Rule("an object", lambda value: isinstance(value, dict), required=False),
}
LINEAGE: dict[str, Rule] = {"parents": TEXTS, "transform": TEXT, "parameters": MAPPING}
RESULT: dict[str, Rule] = {
    "length": Rule("a whole number from 0", _is_whole(0, 1 << 40)),
    "returns": Rule(
        "a list of numbers",
        lambda value: isinstance(value, list) and all(type(x) in (int, float) for x in value),
    ),
    "success": TRUTH,
    "clean": TRUTH,
    "terminated": TRUTH,
    "truncated": TRUTH,
    "aborted": TEXT,
    "digest": TEXT,
}
COMMIT: dict[str, Rule] = {
    "metadata": Rule("an object of digests", _is_mapping(_is_text)),
    "attachments": Rule("an object of digests", _is_mapping(_is_text)),
    "messages": Rule("an object of [count, crc]", _is_mapping(_is_list(_is_whole(0, 1 << 62)))),
    "bytes": Rule(
        "two CRCs of eight digits", lambda value: _is_texts(value) and len(value) == 2, False
    ),
    "seal": TEXT,
}
"""What the result holds besides since version 2: what it vouches for."""
_NAME = Rule("text without NUL", lambda value: _is_text(value) and "\0" not in value)
_COUNT = Rule("a whole number from 0", _is_whole(0, 1 << 53))
MANIFEST: dict[str, Rule] = {
    "name": _NAME,
    "version": _COUNT,
    "hash": _NAME,
    "parent": _NAME,
    "episodes": _COUNT,
    "about": Rule(
        "an object whose 'sources' are a list of texts without NUL",
        lambda value: isinstance(value, dict) and _is_list(_NAME.holds)(value.get("sources", [])),
    ),
}
"""The first line of a manifest."""


def require(values: Json, rules: Mapping[str, Rule], where: str) -> None:
    """Hold a record to its table.

    Raises:
        FormatError: naming the record and its first key that is missing or not as declared.
    """
    broken = _broken(values, rules)
    if broken is not None:
        got = repr(values[broken]) if broken in values else "nothing"
        said = got if len(got) <= 80 else got[:77] + "..."
        raise FormatError(f"{where}: '{broken}': expected {rules[broken].says}, got {said}")


def _broken(values: Json, rules: Mapping[str, Rule], *, complete: bool = True) -> str | None:
    """The first key that is missing or not as declared; None if there is none."""
    for key, rule in rules.items():
        if key in values:
            if not rule.holds(values[key]):
                return key
        elif rule.required and complete:
            return key
    return None
