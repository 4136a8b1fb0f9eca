"""An episode in memory: frozen arrays, and who made it how.

T actions lead through T + 1 states: `qpos[t]`, `state[t]` are before `action[t]`; `reward[t]`,
`distance[t]` and all flags are what `action[t]` led to; `qpos[T]`, `state[T]` are where the episode
ended. `terminated` (the task ended) and `truncated` (cut off from outside) are two things and stay
two.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coordlog.errors import SpecError
from coordlog.spec import CORE, REACH, SCHEMA_VERSION, STEP, V1_STEP, Field, Layout, before, names

Array = NDArray[Any]
Json = dict[str, Any]

CONTACT = np.dtype(
    [
        ("step", "<i8"),
        ("substep", "<i4"),
        ("geom1", "<i4"),
        ("geom2", "<i4"),
        ("depth", "<f8"),
        ("x", "<f8"),
        ("y", "<f8"),
        ("z", "<f8"),
    ]
)
"""One row per contact; the wire holds the same columns per step (spec.CONTACTS)."""

MODEL_XML, MODEL_MJB, INITIAL_STATE = "model.xml.zst", "model.mjb.zst", "initial_state.f64"
"""Attachment names: MJCF text, one zstd frame, and the raw float64 mjSTATE_INTEGRATION vector.
Files of version 1 carry the compiled model (MJB) too."""
VISUALS = "visuals.json.zst"
"""Name of an attachment: which bodies wear which mesh that nothing collides with (mjcf/looks.py).
The meshes lie beside the logs."""

KINDS = ("simulated", "observed")
"""Kinds of episodes: made here, so that they replay bit for bit; or seen from outside."""

FIELD_KEYS = ("name", "type", "size", "unit", "when")
"""What the header says of each field of a task."""
_ACTUATED = tuple(item.name for item in STEP.fields if item.size == "n_c")
LAYOUT_KEYS = tuple(item.name for item in fields(Layout))


@dataclass(frozen=True)
class Header:
    """All that is known when an episode starts: one MCAP metadata record per attribute.

    Values are JSON-able. The keys each record must have are listed here and nowhere else.
    """

    episode: Json
    """schema_version, kind ("simulated" or "observed"; since version 2), id, run, robot, scene,
    split, seed, index, start, control_period [s], start_time [ns since the epoch], goals (k × 3,
    m), obstacles (list of [x, y, z, radius], m)"""
    env: Json
    """coordlog_version, mujoco_version, architecture, task (name; fields: name, type, size, unit,
    when; since version 2), reward (constants), config (environment constants), robot (its spec
    without the model text), joints, actuators, geoms (names by id), arms ({name: [action indices]},
    shared ones in each), action_joints (names), state (names of the n_x entries), state_places
    ({part: [first, last + 1]}), state_offset and state_scale (state = (physical - offset) / scale,
    n_x each), layout (n_q, n_v, n_x, n_u, k, n_c)"""
    policy: Json
    """kind, name, checkpoint_sha256 or "", noise (constants of the exploration noise, {} without);
    where there are any: constants (of a scripted policy), shield (what keeps it from obstacles),
    damper (constants of the velocity damper)"""
    lineage: Json = field(
        default_factory=lambda: {"parents": [], "transform": "", "parameters": {}}
    )
    """parents (sha256 of files), transform, parameters"""

    @property
    def version(self) -> int:
        """Schema version of the file it stands in."""
        return int(self.episode["schema_version"])

    @property
    def kind(self) -> str:
        """Whether it was "simulated" or "observed"."""
        return str(self.episode.get("kind", KINDS[0]))

    @property
    def task(self) -> str:
        """Name of the task, "" if there is none."""
        if self.version == 1:
            return "reach"
        return str(self.env.get("task", {}).get("name", ""))

    @property
    def task_fields(self) -> tuple[Field, ...]:
        """What the task logs of its own."""
        if self.version == 1:
            return REACH
        declared = self.env.get("task", {}).get("fields", ())
        return tuple(
            Field(doc="", owner=self.task, **{key: item[key] for key in FIELD_KEYS})
            for item in declared
        )

    @property
    def layout(self) -> Layout:
        """The lengths that give every field its shape."""
        return Layout(**{key: self.env["layout"].get(key, 0) for key in LAYOUT_KEYS})

    @property
    def fields(self) -> tuple[Field, ...]:
        """Every field of a step but its index, the core's and the task's, in their order: the
        columns that an episode with this header has. See `spec.before` and `spec.after`.
        """
        if self.version == 1:
            return V1_STEP.fields[1:]
        n_c = self.env["layout"].get("n_c", 0)
        core = tuple(item for item in STEP.fields[1:] if n_c or item.size != "n_c")
        return core + self.task_fields

    @property
    def arms(self) -> tuple[str, ...]:
        """Arm names, in the order of every per-arm column."""
        return tuple(self.env["arms"])

    def current(self, *, n_c: int = 0) -> Header:
        """This header, if it is of version 1, as the present version says it.

        Args:
            n_c: Number of actuators that are logged.
        """
        if self.version != 1:
            return self
        fields = [{key: getattr(item, key) for key in FIELD_KEYS} for item in self.task_fields]
        episode = self.episode | {"schema_version": SCHEMA_VERSION, "kind": self.kind}
        env = self.env | {
            "task": {"name": self.task, "fields": fields},
            "layout": self.env["layout"] | {"n_c": n_c},
        }
        return replace(self, episode=episode, env=env)


@dataclass(frozen=True)
class Result:
    """How an episode ended: the last metadata record, which commits the file."""

    length: int
    returns: tuple[float, ...]
    """Sum of rewards per arm, in the order of the steps."""
    success: bool
    """Every palm within its goal radius at the same step."""
    clean: bool
    """Success, with no collision and no instability in the whole episode."""
    terminated: bool
    truncated: bool
    aborted: str
    """Why recording stopped before the episode ended ("interrupted", "recovered", "diverged: …");
    "" if it ended."""
    digest: str
    """sha256 over the bytes of qpos and qvel, step by step and then final, as logged."""


@dataclass(frozen=True)
class Path:
    """A smoothed joint path: the knots it was fitted to, and its cubic Hermite break points."""

    knot_time: Array  # (K,) s
    knot_position: Array  # (K, n_j) rad
    knot_weight: Array  # (K,)
    time: Array  # (B,) s
    position: Array  # (B, n_j) rad
    velocity: Array  # (B, n_j) rad/s


@dataclass(frozen=True, eq=False, init=False)
class Episode:
    """T steps and a final state; arrays cannot be written to.

    Every column is an attribute, of the shape that `header.layout` gives it and with T + 1 rows if
    it holds before the action, T rows otherwise. Of every episode: `time` [s], `qpos`, `qvel`,
    `state`, `action`, `reward`, `terminated`, `truncated`; where actuators were logged `ctrl` and
    `torque`; and what its task logs, for reach `distance` [m], `boundary`, `goal`, `collision`,
    `instability`.

    Example:
        >>> episode = coordlog.open("logs/")[0]                          # doctest: +SKIP
        >>> len(episode), episode.qpos.shape, episode.has("torque")      # doctest: +SKIP
        (110, (111, 34), True)
    """

    header: Header
    result: Result
    columns: Mapping[str, Array]
    """Every column by name, in the order of `header.fields`."""
    contacts: Array
    """(C,) CONTACT, by step."""
    path: Path | None
    """The smoothed path that was executed, if this is a smoothed episode."""
    inputs: Mapping[str, Array]
    """What else the physics was given, when it changed: columns of `spec.INPUTS`, a row for each
    change; empty if nothing did."""

    def __init__(
        self,
        header: Header,
        result: Result,
        *,
        contacts: Array,
        path: Path | None = None,
        inputs: Mapping[str, Array] | None = None,
        columns: Mapping[str, Array] | None = None,
        **named: Array,
    ) -> None:
        """Check every shape and type against the table, and freeze the arrays.

        Args:
            header: Of version 1 or 2; one of version 1 becomes one of version 2 where `ctrl` is
                given.
            result: How it ended.
            contacts: CONTACT rows, by step.
            path: The smoothed path, if there is one.
            inputs: Columns of `spec.INPUTS`.
            columns: Columns by name.
            named: Columns by name, before those of `columns`.

        Raises:
            SpecError: if a column is missing, unknown, or not what `header.fields` says.
        """
        given = {**(columns or {}), **named}
        for name in _ACTUATED:  # of no actuators: not logged
            if name in given and not given[name].shape[-1]:
                del given[name]
        if header.version == 1 and "ctrl" in given:
            header = header.current(n_c=given["ctrl"].shape[-1])
        declared, layout = header.fields, header.layout
        unknown = given.keys() - set(names(declared))
        if "action" not in given or unknown:
            raise SpecError(
                f"episode: expected the columns {', '.join(names(declared))}, "
                f"got {', '.join(given)}"
            )
        length, held = len(given["action"]), {}
        for item in declared:
            if item.name in given:
                wanted = layout.shape(item, length + (item.when == "before"))
                held[item.name] = _column(item, wanted, given[item.name])
            elif item.owner == CORE:
                raise SpecError(f"{item.name}: expected {item.type}, got no such column")
        if contacts.dtype != CONTACT:
            raise SpecError(f"contacts: expected rows of {CONTACT.names}, got {contacts.dtype}")
        contacts.setflags(write=False)
        for name, value in {
            "header": header,
            "result": result,
            "columns": MappingProxyType(held),
            "contacts": contacts,
            "path": path,
            "inputs": MappingProxyType(dict(inputs or {})),
        }.items():
            object.__setattr__(self, name, value)

    def physical(self, part: str) -> Array:
        """One part of the policy's state in SI units, world frame, (T + 1, width) float64.

        Files log `state` as the policy saw it, (physical - offset) / scale; the header's env record
        says where each part lies (`state_places`) and how it was scaled.

        Raises:
            SpecError: for an unknown part, or an episode whose header does not say how its state
                was made; the message lists the parts there are.

        Example:
            >>> episode.physical("goals")[0]      # doctest: +SKIP
            array([0.29, 0.11, 0.5, 0.29, -0.01, 0.5])
        """
        env = self.header.env
        places: Json = env.get("state_places", {})
        if part not in places:
            has = ", ".join(places) or "none: its header does not say how its state was made"
            raise SpecError(f"physical: expected a part of the state ({has}), got '{part}'")
        first, end = places[part]
        offset, scale = (
            np.asarray(env[name][first:end]) for name in ("state_offset", "state_scale")
        )
        return np.asarray(self.state[:, first:end].astype(np.float64) * scale + offset)

    def __len__(self) -> int:
        """Number of steps T."""
        return len(self.columns["action"])

    def __getattr__(self, name: str) -> Array:
        """A column.

        Raises:
            AttributeError: if the episode has none of that name; says what it has.
        """
        columns = self.__dict__.get("columns")
        if columns is None or name.startswith("__"):
            raise AttributeError(name)
        if name in columns:
            array: Array = columns[name]
            return array
        raise AttributeError(
            f"an episode of the task '{self.header.task}' (schema version {self.header.version}) "
            f"has no column '{name}'; it has {', '.join(columns)}"
        )

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle by what it is made of."""
        given = {"contacts": self.contacts, "path": self.path, "inputs": dict(self.inputs)}
        return _made, (self.header, self.result, given, dict(self.columns))

    @property
    def before(self) -> tuple[str, ...]:
        """Names of the columns that hold before an action, of which there is one more row."""
        return tuple(name for name in names(before(self.header.fields)) if name in self.columns)

    def has(self, name: str) -> bool:
        """Whether the episode has a column of that name."""
        return name in self.columns

    def with_result(self, **changes: Any) -> Episode:
        """A copy whose result differs in the given fields."""
        return replace(self, result=replace(self.result, **changes))


def _made(
    header: Header, result: Result, given: dict[str, Any], columns: dict[str, Array]
) -> Episode:
    return Episode(header, result, columns=columns, **given)


def _column(item: Field, wanted: tuple[int, ...], array: Array) -> Array:
    if array.shape != wanted or array.dtype != np.dtype(item.type):
        raise SpecError(
            f"{item.name}: expected {item.type} of shape {wanted}, "
            f"got {array.dtype} of shape {array.shape}"
        )
    array.setflags(write=False)
    return array
