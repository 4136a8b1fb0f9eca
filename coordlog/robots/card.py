"""A robot's card: its spec as a TOML file that a person edits."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from coordlog.config import build, load_toml
from coordlog.errors import ConfigError, unknown
from coordlog.robots.robot import Arm, Robot


@dataclass(frozen=True)
class Card:
    """The table [robot] of a card; what is not in it has the default of `Robot`."""

    name: str
    model: str
    """MJCF or URDF, relative to the card."""
    centre: tuple[float, float, float] = (0.0, 0.0, 0.0)
    reach: float = 1.0
    shared: tuple[str, ...] = ()
    soles: tuple[str, ...] = ()
    torso: str = ""
    excludes: tuple[tuple[str, str], ...] = ()


TABLES = ("robot", "arms", "poses", "servo_gains", "ranges", "held", "scene")


def read_tables(path: Path) -> dict[str, Any]:
    """The tables of a card.

    Raises:
        ConfigError: if the file cannot be read, is no TOML, or has a table that no card has.
    """
    tables = load_toml(path, "robot's card")
    for name in tables:
        if name not in TABLES:
            raise unknown(f"table in the card {path}", name, TABLES)
    for name in ("robot", "arms"):
        if name not in tables:
            raise ConfigError(
                f"{path}: expected a robot's card with [robot] and [[arms]], found no {name}; "
                "`coordlog robot MODEL --out CARD.toml` writes one"
            )
    return tables


def robot_of(tables: Mapping[str, Any], folder: Path) -> Robot:
    """The robot that a card's tables describe.

    Args:
        tables: Of the card (`read_tables`).
        folder: Where the card is; its model's path is relative to it.

    Raises:
        ConfigError: for a key that no card has, a missing one, or a value of another kind.
    """
    head = _built(Card, tables["robot"], "robot.", ("name", "model"))
    arms = tuple(
        _built(Arm, arm, f"arms[{i}].", ("name", "palm", "joints"))
        for i, arm in enumerate(tables["arms"])
    )
    if not arms:
        raise ConfigError("card: expected at least one [[arms]], found none")
    return Robot(
        name=head.name,
        mjcf=folder / head.model,
        arms=arms,
        shared=head.shared,
        soles=head.soles,
        torso=head.torso,
        poses={
            pose: _numbers(angles, f"poses.{pose}")
            for pose, angles in _table(tables, "poses").items()
        },
        centre=head.centre,
        reach=head.reach,
        servo_gains={
            k: _pair(v, f"servo_gains.{k}") for k, v in _table(tables, "servo_gains").items()
        },
        ranges={k: _pair(v, f"ranges.{k}") for k, v in _table(tables, "ranges").items()},
        held=_numbers(_table(tables, "held"), "held"),
        excludes=head.excludes,
    )


def _built(kind: Any, values: Any, prefix: str, needed: tuple[str, ...]) -> Any:
    missing = [name for name in needed if not isinstance(values, Mapping) or name not in values]
    if missing:
        raise ConfigError(f"card: expected {prefix}{missing[0]}, found none")
    return build(kind, values, prefix=prefix, what="key in a robot's card")


def _table(tables: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    found = tables.get(name, {})
    if not isinstance(found, Mapping):
        raise ConfigError(f"card: expected a table [{name}], got {found!r}")
    return found


def _numbers(values: Any, where: str) -> dict[str, float]:
    if not isinstance(values, Mapping):
        raise ConfigError(f"card: expected a table of numbers as {where}, got {values!r}")
    for key, value in values.items():
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise ConfigError(f"card: expected a number as {where}.{key}, got {value!r}")
    return {key: float(value) for key, value in values.items()}


def _pair(value: Any, where: str) -> tuple[float, float]:
    numbers = (
        [each for each in value if isinstance(each, int | float)] if isinstance(value, list) else []
    )
    if len(numbers) != 2 or len(value) != 2:
        raise ConfigError(f"card: expected two numbers as {where}, got {value!r}")
    return float(numbers[0]), float(numbers[1])


def as_card(robot: Robot, model: str, notes: Sequence[str] = ()) -> str:
    """A robot's spec as the text of a card.

    Args:
        robot: The spec.
        model: Path of its model as the card is to name it.
        notes: Said at its head.
    """
    lines = [
        f"# {''.join(each if each.isprintable() else ' ' for each in note)}"
        for note in (
            "A robot for coordlog: edit what is wrong, then",
            f"coordlog record --scene {robot.name}.toml",
            *notes,
        )
    ]
    lines += ["", "[robot]", f"name = {_text(robot.name)}", f"model = {_text(model)}"]
    lines += [
        f"centre = {_list(robot.centre)}  # middle of the workspace [m]",
        f"reach = {robot.reach!r}  # half its extent [m]",
    ]
    lines += [f"shared = {_list(robot.shared)}  # joints that move every arm"]
    if robot.soles:
        lines += [
            f"soles = {_list(robot.soles)}  # geoms it stands on",
            f"torso = {_text(robot.torso)}",
        ]
    if robot.excludes:
        pairs = ", ".join(_list(pair) for pair in robot.excludes)
        lines.append(f"excludes = [{pairs}]  # bodies that never collide")
    for arm in robot.arms:
        lines += [
            "",
            "[[arms]]",
            f"name = {_text(arm.name)}",
            f"palm = {_text(arm.palm)}  # a site, or a body",
        ]
        lines += [f"joints = {_list(arm.joints)}"]
    for pose, angles in robot.poses.items():
        lines += ["", f"[poses.{_key(pose)}]"] + [f"{_key(k)} = {v!r}" for k, v in angles.items()]
    if robot.servo_gains:
        lines += ["", "[servo_gains]  # kp, kv of joints that have a motor or no actuator"]
        lines += [f"{_key(k)} = {_list(v)}" for k, v in robot.servo_gains.items()]
    if robot.held:
        lines += ["", "[held]  # control of what is no joint's servo"]
        lines += [f"{_key(k)} = {v!r}" for k, v in robot.held.items()]
    return "\n".join(lines) + "\n"


def _text(value: str) -> str:
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


def _key(value: str) -> str:
    plain = value.replace("_", "").replace("-", "")
    return value if plain.isascii() and plain.isalnum() else _text(value)


def _list(values: Sequence[object]) -> str:
    return "[" + ", ".join(_text(v) if isinstance(v, str) else repr(v) for v in values) + "]"
