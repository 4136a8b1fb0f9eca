"""`spec.MESSAGES` as ros2msg text, the schema every viewer of an episode file parses.

`python -m coordlog.record.schema [FOLDER]` writes `FOLDER/coordlog_msgs/msg/*.msg` (default
`schemas`). The same text goes into every file, so a log explains itself without coordlog.
"""

from __future__ import annotations

import sys
from pathlib import Path

from coordlog.spec import JOINT_STATE_NAME, MESSAGES, SCHEMA_VERSION, Field, Message

ENCODING = "ros2msg"
MESSAGE_ENCODING = "cdr"

_SEPARATOR = "=" * 80

_JOINT_STATE = f"""\
# Positions and velocities of named joints at one moment.

std_msgs/Header header
string[] name  # one name per joint
float64[] position  # [rad]
float64[] velocity  # [rad/s]
float64[] effort  # left empty
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


def definition(message: Message) -> str:
    """The ros2msg definition of one message: its purpose, then one field a line with unit and
    meaning.
    """
    lines = [f"# {message.doc}", f"# coordlog schema version {SCHEMA_VERSION}.", ""]
    lines += [_field(item) for item in message.fields]
    return "\n".join(lines) + "\n"


def _field(item: Field) -> str:
    array = "[]" if item.size else ""
    unit = f"[{item.unit}] " if item.unit else ""
    length = f" (length {item.size})" if item.size else ""
    return f"{item.type}{array} {item.name}  # {unit}{item.doc}{length}"


SCHEMAS: dict[str, str] = {message.name: definition(message) for message in MESSAGES} | {
    JOINT_STATE_NAME: _JOINT_STATE
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
