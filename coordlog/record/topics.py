"""Which topics an episode file has, and the MCAP ids of their channels and schemas.

A channel is defined in the first chunk that has a message for it, so none is ever defined and
unused. Ids of the topics that version 1 had are what they were.
"""

from __future__ import annotations

from functools import lru_cache

from mcap.records import Channel, Schema

from coordlog.episode import Header
from coordlog.record.container import Topic
from coordlog.record.records import pack
from coordlog.record.schema import ENCODING, MESSAGE_ENCODING, SCHEMAS, definition
from coordlog.spec import (
    ARM_TOPIC,
    CONTACTS,
    DESCRIPTION_NAME,
    DESCRIPTION_TOPIC,
    FINAL,
    INPUTS,
    JOINT_STATE_NAME,
    JOINT_STATE_TOPIC,
    KNOT,
    SPLINE,
    STEP,
    TRANSFORMS_NAME,
    TRANSFORMS_TOPIC,
    Field,
    Message,
    arm_message,
    before,
    task_final,
    task_message,
)

_FIXED = {message.topic: message.name for message in (STEP, FINAL, CONTACTS, KNOT, SPLINE)} | {
    JOINT_STATE_TOPIC: JOINT_STATE_NAME
}
_FURTHER = {
    INPUTS.topic: INPUTS.name,
    TRANSFORMS_TOPIC: TRANSFORMS_NAME,
    DESCRIPTION_TOPIC: DESCRIPTION_NAME,
}

_SHOWN = (JOINT_STATE_TOPIC, TRANSFORMS_TOPIC, DESCRIPTION_TOPIC)


def arm_topic(arm: str) -> str:
    """The display topic of one arm."""
    return ARM_TOPIC + arm


def is_logged(topic: str) -> bool:
    """Whether a topic holds what was logged, and not only what viewers show of it."""
    return not (topic in _SHOWN or topic.startswith(ARM_TOPIC))


def task_messages(header: Header) -> tuple[Message, ...]:
    """The messages of an episode's task: of a step, and of the final state if it has such."""
    name, fields = header.task, header.task_fields
    found = (task_message(name, fields),) if fields else ()
    return found + ((task_final(name, fields),) if before(fields) else ())


def topics(header: Header) -> dict[str, Topic]:
    """Every topic that an episode with this header can have, by name."""
    return _topics(header.arms, header.task, header.task_fields)


@lru_cache(maxsize=64)
def _topics(arms: tuple[str, ...], task: str, fields: tuple[Field, ...]) -> dict[str, Topic]:
    own = [task_message(task, fields)] if fields else []
    own += [task_final(task, fields)] if before(fields) else []
    arm = arm_message(task, fields)
    names = _FIXED | {arm_topic(name): arm.name for name in arms} | _FURTHER
    names |= {message.topic: message.name for message in own}
    texts = SCHEMAS | {message.name: definition(message) for message in (*own, arm)}
    numbers = {name: index for index, name in enumerate(dict.fromkeys(names.values()), 1)}
    return {
        topic: _topic(index, topic, name, numbers[name], texts[name])
        for index, (topic, name) in enumerate(names.items(), 1)
    }


def _topic(index: int, topic: str, name: str, number: int, text: str) -> Topic:
    schema = Schema(id=number, name=name, encoding=ENCODING, data=text.encode())
    channel = Channel(
        id=index, topic=topic, message_encoding=MESSAGE_ENCODING, metadata={}, schema_id=number
    )
    return Topic(index, pack(schema), pack(channel))
