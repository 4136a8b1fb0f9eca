"""An episode in memory: frozen arrays, and who made it how.

T actions lead through T + 1 states: `qpos[t]`, `state[t]` are before `action[t]`; `reward[t]`,
`distance[t]` and all flags are what `action[t]` led to; `qpos[T]`, `state[T]` are where the episode
ended. `terminated` (the task ended) and `truncated` (cut off from outside) are two things and stay
two.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coordlog.errors import SpecError
from coordlog.spec import FINAL, STEP, Field, Layout

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
"""Attachment names: MJCF text and MJB, each one zstd frame, and the raw float64 mjSTATE_INTEGRATION
vector."""


@dataclass(frozen=True)
class Header:
    """All that is known when an episode starts: one MCAP metadata record per attribute.

    Values are JSON-able. The keys each record must have are listed here and nowhere else.
    """

    episode: Json
    """schema_version, id, run, robot, scene, split, seed, index, start, control_period [s],
    start_time [ns since the epoch], goals (k × 3, m), obstacles (list of [x, y, z, radius], m)"""
    env: Json
    """coordlog_version, mujoco_version, architecture, reward (constants), config (environment
    constants), robot (its spec without the model text), joints, actuators, geoms (names by id),
    arms ({name: [action indices]}, shared ones in each), action_joints (names), state (names of the
    n_x entries), layout (n_q, n_v, n_x, n_u, k)"""
    policy: Json
    """kind, name, checkpoint_sha256 or "", noise (constants of the exploration noise, {}
    without)"""
    lineage: Json = field(
        default_factory=lambda: {"parents": [], "transform": "", "parameters": {}}
    )
    """parents (sha256 of files), transform, parameters"""

    @property
    def layout(self) -> Layout:
        """The lengths that give every field its shape."""
        return Layout(**self.env["layout"])

    @property
    def fields(self) -> tuple[Field, ...]:
        """Every field of a step but its index, the core's and the task's, in their order: the
        columns that an episode with this header has. See `spec.before` and `spec.after`.
        """
        return STEP.fields[1:]

    @property
    def arms(self) -> tuple[str, ...]:
        """Arm names, in the order of every per-arm column."""
        return tuple(self.env["arms"])


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


@dataclass(frozen=True, eq=False)
class Episode:
    """T steps and a final state; arrays cannot be written to."""

    header: Header
    result: Result
    time: Array  # (T + 1,) float64, s
    qpos: Array  # (T + 1, n_q) float64
    qvel: Array  # (T + 1, n_v) float64
    state: Array  # (T + 1, n_x) float32
    action: Array  # (T, n_u) float32
    reward: Array  # (T, k) float64
    distance: Array  # (T, k) float64, m
    boundary: Array  # (T, k) bool
    goal: Array  # (T, k) bool
    collision: Array  # (T,) bool
    instability: Array  # (T,) bool
    terminated: Array  # (T,) bool
    truncated: Array  # (T,) bool
    contacts: Array  # (C,) CONTACT, by step
    path: Path | None = None

    def __post_init__(self) -> None:
        """Check every shape and type against the table, and freeze the arrays.

        Raises:
            SpecError: if an array is not what `spec.STEP` and the header's layout say.
        """
        layout, length = self.header.layout, len(self.action)
        both = {item.name for item in FINAL.fields}
        for item in STEP.fields[1:]:
            wanted = layout.shape(item, length + (item.name in both))
            array: Array = getattr(self, item.name)
            if array.shape != wanted or array.dtype != np.dtype(item.type):
                raise SpecError(
                    f"{item.name}: expected {item.type} of shape {wanted}, got {array.dtype} of shape {array.shape}"
                )
            array.setflags(write=False)
        if self.contacts.dtype != CONTACT:
            raise SpecError(
                f"contacts: expected rows of {CONTACT.names}, got {self.contacts.dtype}"
            )
        self.contacts.setflags(write=False)

    def __len__(self) -> int:
        """Number of steps T."""
        return len(self.action)

    def with_result(self, **changes: Any) -> Episode:
        """A copy whose result differs in the given fields."""
        return replace(self, result=replace(self.result, **changes))
