"""Every column of an episode with the names of its entries, whatever fields its task has.

A column is *before* (T + 1 rows: the state each action met, and the final state) or *after* (T
rows: the action, and what it led to). Exporters take columns from here and have no list of their
own.
"""

from __future__ import annotations

from typing import NamedTuple

from coordlog.episode import Array, Episode, Header
from coordlog.spec import Field


class Column(NamedTuple):
    """One column.

    Example:
        `columns(episode)["action"].labels` are the names of the action's joints.
    """

    name: str
    values: Array
    """(T + 1, …) if `before`, else (T, …)"""
    before: bool
    labels: tuple[str, ...]
    """names of the entries; () for one number a step"""
    unit: str
    doc: str


def columns(episode: Episode) -> dict[str, Column]:
    """All columns of an episode by name, in the order of the format; without the step's number."""
    found = {}
    for item in fields_of(episode):
        values = getattr(episode, item.name)
        labels = labels_of(item, episode.header) if values.ndim > 1 else ()
        if values.ndim > 1 and not values.shape[1]:
            continue
        found[item.name] = Column(
            item.name, values, item.when == "before", labels, item.unit, item.doc
        )
    return found


def fields_of(episode: Episode) -> tuple[Field, ...]:
    """The fields that an episode has, but for the step's number."""
    return tuple(item for item in episode.header.fields if hasattr(episode, item.name))


def labels_of(item: Field, header: Header) -> tuple[str, ...]:
    """Names of the entries of a sequence field: joints, arms, or the field's name and a number."""
    env = header.env
    width = header.layout.width(item) or 0
    named: dict[str, tuple[str, ...]] = {
        "n_x": tuple(env.get("state", ())),
        "n_u": tuple(env.get("action_joints", ())),
        "n_c": tuple(env.get("actuators", ())),
        "k": header.arms,
    }
    labels = named.get(item.size, ())
    if item.size in ("n_q", "n_v"):
        key = "qpos" if item.size == "n_q" else "qvel"
        places = {int(joint[key]): str(joint["name"]) for joint in env.get("joints", ())}
        labels = tuple(places.get(i, f"{item.name}_{i}") for i in range(width))
    if len(labels) != width or len(set(labels)) != width:
        return tuple(f"{item.name}_{i}" for i in range(width))
    return labels
