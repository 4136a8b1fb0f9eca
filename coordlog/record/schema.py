"""Messages ↔ ros2msg text, the schema every viewer of an episode file parses.

`definition` writes the text of a message of `spec`; `parsed` reads the fields out of the text that
stands in a file, from which that file's messages are decoded. Comments explain and are never
compared: two texts say the same if their fields have the same names and types in the same order.

`python -m coordlog.record.schema [FOLDER]` writes `FOLDER/coordlog_msgs/msg/*.msg` (default
`schemas`). The same text goes into every file, so a log explains itself without coordlog.
"""

from __future__ import annotations

import re
import sys
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

from coordlog.errors import FormatError
from coordlog.spec import (
    DESCRIPTION_NAME,
    JOINT_STATE_NAME,
    MESSAGES,
    SCHEMA_VERSION,
    TRANSFORMS_NAME,
    Field,
    Message,
)

ENCODING = "ros2msg"
MESSAGE_ENCODING = "cdr"

_SEPARATOR = "=" * 80
_LINE = re.compile(r"(?P<type>[\w/]+)(?P<array>\[\])?\s+(?P<name>[A-Za-z]\w*)$")

_HEADER = f"""\
{_SEPARATOR}
MSG: std_msgs/Header
# When, and in which frame.

builtin_interfaces/Time stamp
string frame_id
{_SEPARATOR}
MSG: builtin_interfaces/Time
# A point in time since the Unix epoch.

int32 sec
uint32 nanosec
"""

_JOINT_STATE = f"""\
# Positions and velocities of named joints at one moment.

std_msgs/Header header
string[] name  # one name per joint
float64[] position  # [rad]
float64[] velocity  # [rad/s]
float64[] effort  # left empty
{_HEADER}"""

_TRANSFORMS = f"""\
# Where every link is at one moment, each in the frame of the link that carries it.

geometry_msgs/TransformStamped[] transforms
{_SEPARATOR}
MSG: geometry_msgs/TransformStamped
# One frame in another.

std_msgs/Header header  # frame_id: the frame that carries it
string child_frame_id
geometry_msgs/Transform transform
{_SEPARATOR}
MSG: geometry_msgs/Transform
# A translation, then a rotation.

geometry_msgs/Vector3 translation  # [m]
geometry_msgs/Quaternion rotation
{_SEPARATOR}
MSG: geometry_msgs/Vector3
# Three coordinates.

float64 x
float64 y
float64 z
{_SEPARATOR}
MSG: geometry_msgs/Quaternion
# A rotation as a unit quaternion.

float64 x
float64 y
float64 z
float64 w
{_HEADER}"""

_STRING = """\
# A text: of /robot_description the robot and its scene as URDF.

string data
"""


class Column(NamedTuple):
    """One field of a message as a schema text declares it."""

    type: str
    array: bool
    name: str

    def __str__(self) -> str:
        return f"{self.type}{'[]' if self.array else ''} {self.name}"


def definition(message: Message) -> str:
    """The ros2msg definition of one message: its purpose, then one field a line with unit and
    meaning.
    """
    lines = [f"# {message.doc}", f"# coordlog schema version {SCHEMA_VERSION}.", ""]
    lines += [_field(item) for item in message.fields]
    return "\n".join(lines) + "\n"


def _field(item: Field) -> str:
    unit = f"[{item.unit}] " if item.unit else ""
    length = f" (length {item.size})" if item.size else ""
    return f"{column(item)}  # {unit}{item.doc}{length}"


def column(item: Field) -> Column:
    """A field of `spec` as a schema text declares it."""
    return Column(item.type, bool(item.size), item.name)


@lru_cache(maxsize=256)
def parsed(name: str, encoding: str, text: bytes) -> tuple[Column, ...]:
    """The fields that a schema declares, in wire order; those of messages it depends on are not
    looked at.

    Raises:
        FormatError: if it is no ros2msg text, or declares something else than values and sequences
            of values.
    """
    if encoding != ENCODING:
        raise FormatError(f"schema {name}: expected {ENCODING}, got {encoding!r}")
    columns = []
    for line in text.decode(errors="replace").split("\n" + _SEPARATOR[:3])[0].splitlines():
        said = line.partition("#")[0].strip()
        match = _LINE.match(said)
        if said and not match:
            raise FormatError(f"schema {name}: expected a type and a name, got {said!r}")
        if match:
            columns.append(Column(match["type"], match["array"] is not None, match["name"]))
    return tuple(columns)


def require_fields(name: str, got: tuple[Column, ...], wanted: tuple[Field, ...]) -> None:
    """Hold a schema's fields to those that reading depends on; more of them are allowed.

    Raises:
        FormatError: naming the first that is missing, or of another type.
    """
    types = {item.name: item for item in got}
    for item in map(column, wanted):
        found = types.get(item.name)
        if found != item:
            said = "no field of that name" if found is None else f"'{found}'"
            raise FormatError(
                f"schema {name}: expected '{item}', got {said}; its fields are "
                f"{', '.join(each.name for each in got)}"
            )


SCHEMAS: dict[str, str] = {message.name: definition(message) for message in MESSAGES} | {
    JOINT_STATE_NAME: _JOINT_STATE,
    TRANSFORMS_NAME: _TRANSFORMS,
    DESCRIPTION_NAME: _STRING,
}
"""Schema text by ROS 2 name, dependencies included, as it stands in every file."""


def write(folder: Path) -> list[Path]:
    """Write one `.msg` file per message of `spec.MESSAGES` under `folder`; returns their paths."""
    paths = []
    for message in MESSAGES:
        path = folder / f"{message.name}.msg"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(SCHEMAS[message.name], encoding="utf-8")
        paths.append(path)
    return paths


if __name__ == "__main__":
    write(Path(sys.argv[1] if len(sys.argv) > 1 else "schemas"))
