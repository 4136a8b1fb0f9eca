"""The one table of what an episode file contains: messages, fields, types, units.

The codec, the `.msg` schemas, the Arrow columns and the documentation are all derived from
`MESSAGES`. A sequence field names its length with a symbol; a `Layout` gives the symbols numbers
for one robot and task. What a task logs of its own is a message of its own (`task_message`), from
the fields the task declares.

    n_q, n_v   MuJoCo's nq and nv of the whole model      n_c   MuJoCo's nu: its actuators
    n_x        policy state          n_u   action         k     heads of the reward (arms)
    n_j        joints of the smoothed path (= n_u)        c     contacts in one step (ragged)
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal, NamedTuple

from coordlog.errors import SpecError

SCHEMA_VERSION = 2
"""What is written. Raised when a reader of the version before would misread a file."""
READABLE = (1, 2)
"""Versions that are read: every one there has been."""

When = Literal["before", "during", "after"]
CORE = "core"
"""Owner of the fields that every episode has."""


class Field(NamedTuple):
    """One field of a message.

    `type` is a ROS 2 primitive name. `size` is "" for a scalar, else the length of a sequence: a
    symbol of `Layout`, a number, or a product of them ("3*k").

    Example:
        >>> Field("goals", "float64", "3*k", "m", "goal of each arm", when="before", owner="hold")
    """

    name: str
    type: str
    size: str
    unit: str
    doc: str
    when: When = "after"
    """"before" the action (T + 1 rows: every step and the final state), "during" (the action
    itself, T rows) or "after" it (T rows)."""
    owner: str = CORE
    """"core", or the name of the task that declares the field."""


def before(fields: Iterable[Field]) -> tuple[Field, ...]:
    """The fields that hold before the action, of which there is one more row than actions."""
    return tuple(item for item in fields if item.when == "before")


def after(fields: Iterable[Field]) -> tuple[Field, ...]:
    """The fields that say what an action led to."""
    return tuple(item for item in fields if item.when == "after")


def owned(fields: Iterable[Field], owner: str) -> tuple[Field, ...]:
    """The fields of one owner: "core", or a task's name."""
    return tuple(item for item in fields if item.owner == owner)


def names(fields: Iterable[Field]) -> tuple[str, ...]:
    """The names of fields, in order."""
    return tuple(item.name for item in fields)


class Message(NamedTuple):
    """One message type: its ROS 2 name, the topic it is published on, and its fields in wire
    order.
    """

    name: str
    topic: str
    doc: str
    fields: tuple[Field, ...]


STEP_INDEX = Field("step", "int64", "", "", "control step, from 0", when="before")

_BEFORE = (
    Field(
        "time",
        "float64",
        "",
        "s",
        "simulated time before the action, since the start of the episode",
        when="before",
    ),
    Field("qpos", "float64", "n_q", "m, rad", "MuJoCo qpos before the action", when="before"),
    Field("qvel", "float64", "n_v", "m/s, rad/s", "MuJoCo qvel before the action", when="before"),
    Field(
        "state",
        "float32",
        "n_x",
        "",
        "policy state before the action, scaled to about [-1, 1]",
        when="before",
    ),
)
_ACTION = Field(
    "action", "float32", "n_u", "", "action that was executed, in [-1, 1]", when="during"
)
_REWARD = Field("reward", "float64", "k", "", "reward of each arm for this action")
_TERMINATED = Field(
    "terminated", "bool", "", "", "the task ended here: instability, or every goal reached"
)
_TRUNCATED = Field(
    "truncated", "bool", "", "", "cut off from outside here: step limit; bootstrap through it"
)

REACH = (
    Field(
        "distance", "float64", "k", "m", "palm to goal of each arm after the action", owner="reach"
    ),
    Field(
        "boundary",
        "bool",
        "k",
        "",
        "palm within the goal boundary after the action",
        owner="reach",
    ),
    Field("goal", "bool", "k", "", "palm within the goal radius after the action", owner="reach"),
    Field(
        "collision",
        "bool",
        "",
        "",
        "any contact other than sole on floor, at any physics substep",
        owner="reach",
    ),
    Field(
        "instability",
        "bool",
        "",
        "",
        "centre of mass left the support polygon, or the torso tipped",
        owner="reach",
    ),
)
"""What the reach task logs of a step. Version 1 had these in `Step` itself."""

STEP = Message(
    "coordlog_msgs/msg/Step",
    "/coordlog/step",
    "One control step: the state before the action, the action executed, and what it led to. "
    "Authoritative.",
    (
        STEP_INDEX,
        *_BEFORE,
        _ACTION,
        Field("ctrl", "float64", "n_c", "", "MuJoCo ctrl at the end of the step: servo targets"),
        Field(
            "torque",
            "float64",
            "n_c",
            "N, N·m",
            "MuJoCo actuator_force at the end of the step, of every actuator",
        ),
        _REWARD,
        _TERMINATED,
        _TRUNCATED,
    ),
)

LEARNT = (_BEFORE[-1], _ACTION, *REACH, _TERMINATED)
"""What is learnt from: the policy state, the action, and what the task says that it led to."""
REWARDED = (_BEFORE[-1], _ACTION, _REWARD, _TERMINATED)
"""The same of an environment that is not ours: the rewards are those that it gave."""

V1_STEP = STEP._replace(
    fields=(STEP_INDEX, *_BEFORE, _ACTION, _REWARD, *REACH, _TERMINATED, _TRUNCATED)
)
"""Step as version 1 has it: with the fields of the reach task, without ctrl and torque."""

FINAL = Message(
    "coordlog_msgs/msg/Final",
    "/coordlog/final",
    "The state after the last action: N steps and one final state, never an action without its "
    "outcome.",
    (
        STEP_INDEX._replace(doc="number of steps"),
        *(item._replace(doc=item.doc.replace("before the", "after the last")) for item in _BEFORE),
    ),
)

CONTACTS = Message(
    "coordlog_msgs/msg/Contacts",
    "/coordlog/contacts",
    "Contacts other than sole on floor during one control step: per geom pair the deepest over "
    "the substeps.",
    (
        Field("step", "int64", "", "", "control step during which they happened"),
        Field("substep", "int32", "c", "", "physics substep of the control step, from 0"),
        Field("geom1", "int32", "c", "", "MuJoCo geom id; names in the metadata `coordlog.env`"),
        Field("geom2", "int32", "c", "", "MuJoCo geom id; geom1 < geom2"),
        Field("depth", "float64", "c", "m", "penetration, ≥ 0"),
        Field("x", "float64", "c", "m", "contact position, world frame"),
        Field("y", "float64", "c", "m", "contact position, world frame"),
        Field("z", "float64", "c", "m", "contact position, world frame"),
    ),
)

INPUTS = Message(
    "coordlog_msgs/msg/Inputs",
    "/coordlog/inputs",
    "What else the physics is given from this substep on, until the next message; none if it "
    "never changes.",
    (
        Field("step", "int64", "", "", "control step, from 0"),
        Field("substep", "int32", "", "", "physics substep of the control step, from 0"),
        Field("qfrc_applied", "float64", "n_v", "N, N·m", "generalized forces applied"),
        Field("xfrc_applied", "float64", "6*bodies", "N, N·m", "force and torque on each body"),
        Field("eq_active", "bool", "equalities", "", "which equality constraints are active"),
        Field("mocap_pos", "float64", "3*mocaps", "m", "positions of the mocap bodies"),
        Field("mocap_quat", "float64", "4*mocaps", "", "orientations of the mocap bodies, w first"),
        Field(
            "state", "float64", "s", "", "the whole integration state, where it was set; or none"
        ),
    ),
)

KNOT = Message(
    "coordlog_msgs/msg/Knot",
    "/coordlog/knots",
    "One joint-space sample that a smoothed path was fitted to.",
    (
        Field("time", "float64", "", "s", "since the start of the episode"),
        Field("position", "float64", "n_j", "rad", "joint angles, order of the action joints"),
        Field(
            "weight",
            "float64",
            "",
            "",
            "fidelity weight of the sample; infinite at an exact end point",
        ),
    ),
)

SPLINE = Message(
    "coordlog_msgs/msg/Spline",
    "/coordlog/spline",
    "One break point of a smoothed path; between two of them the path is the cubic Hermite "
    "polynomial.",
    (
        Field("time", "float64", "", "s", "since the start of the episode"),
        Field("position", "float64", "n_j", "rad", "spline value"),
        Field("velocity", "float64", "n_j", "rad/s", "spline derivative"),
    ),
)

TASK_TOPIC = "/coordlog/task/"
ARM_TOPIC = "/coordlog/arm/"


def task_message(task: str, fields: tuple[Field, ...]) -> Message:
    """The message of a task's own fields, one for every step.

    Example:
        >>> task_message("reach", REACH).topic
        '/coordlog/task/reach'
    """
    doc = f"What the task '{task}' logs of one control step."
    return Message(
        f"coordlog_msgs/msg/{_camel(task)}Task", TASK_TOPIC + task, doc, (STEP_INDEX, *fields)
    )


def task_final(task: str, fields: tuple[Field, ...]) -> Message:
    """The message of a task's own fields that hold after the last action, one an episode."""
    after_last = FINAL.fields[0]
    return Message(
        f"coordlog_msgs/msg/{_camel(task)}Final",
        TASK_TOPIC + task + "/final",
        f"What the task '{task}' logs of the state after the last action.",
        (after_last, *before(fields)),
    )


def arm_message(task: str, fields: tuple[Field, ...]) -> Message:
    """One arm's share of a step as named scalars, for viewers: its reward, and every field of the
    task that has an entry for each arm.
    """
    each = [item for item in (_REWARD, *after(fields)) if item.size == "k"]
    prefix = "" if task == "reach" else _camel(task)  # version 1 called that of reach so
    return Message(
        f"coordlog_msgs/msg/{prefix}Arm",
        ARM_TOPIC,
        "One arm's share of a step as named scalars, for viewers; the topic ends in the arm's "
        "name.",
        tuple(item._replace(size="", doc=item.doc.replace("each arm", "the arm")) for item in each),
    )


def _camel(name: str) -> str:
    letters = "".join(letter if letter.isalnum() else " " for letter in name)
    return "".join(word[:1].upper() + word[1:] for word in letters.split())


ARM = arm_message("reach", REACH)

MESSAGES = (
    STEP,
    FINAL,
    CONTACTS,
    INPUTS,
    task_message("reach", REACH),
    KNOT,
    SPLINE,
    ARM,
)
"""Everything coordlog writes of its own, with the message of the reach task for a task's."""

JOINT_STATE_NAME = "sensor_msgs/msg/JointState"
JOINT_STATE_TOPIC = "/joint_states"
TRANSFORMS_NAME, TRANSFORMS_TOPIC = "tf2_msgs/msg/TFMessage", "/tf"
DESCRIPTION_NAME, DESCRIPTION_TOPIC = "std_msgs/msg/String", "/robot_description"


@dataclass(frozen=True)
class Layout:
    """The lengths that turn the table into shapes, for one robot and task."""

    n_q: int
    n_v: int
    n_x: int
    n_u: int
    k: int
    n_c: int = 0
    """0 where actuators are not logged: files of version 1, observed episodes."""

    @property
    def n_j(self) -> int:
        """Joints of a smoothed path: the action's."""
        return self.n_u

    def width(self, field: Field) -> int | None:
        """Length of a sequence field; None for a scalar.

        Raises:
            SpecError: if the field's size is neither a number nor a symbol of this class.
        """
        if field.size == "":
            return None
        width = 1
        for factor in field.size.split("*"):
            if not factor.isdecimal() and not hasattr(self, factor):
                raise SpecError(
                    f"field '{field.name}': expected as its length numbers or symbols of "
                    f"{', '.join(vars(self))}, joined by *, got '{field.size}'"
                )
            width *= int(factor) if factor.isdecimal() else int(getattr(self, factor))
        return width

    def shape(self, field: Field, n: int) -> tuple[int, ...]:
        """Shape of n values of a field, as an array with the step axis first."""
        width = self.width(field)
        return (n,) if width is None else (n, width)
