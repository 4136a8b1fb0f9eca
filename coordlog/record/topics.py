"""Which topics an episode file has, and the MCAP ids of their channels and schemas: the same in
every file.

A channel is defined in the first chunk that has a message for it, so none is ever defined and
unused.
"""

from __future__ import annotations

from functools import lru_cache

from mcap.records import Channel, Schema

from coordlog.record.container import Topic
from coordlog.record.records import pack
from coordlog.record.schema import ENCODING, MESSAGE_ENCODING, SCHEMAS
from coordlog.spec import (
    ARM,
    CONTACTS,
    FINAL,
    JOINT_STATE_NAME,
    JOINT_STATE_TOPIC,
    KNOT,
    SPLINE,
    STEP,
)

_FIXED = {message.topic: message.name for message in (STEP, FINAL, CONTACTS, KNOT, SPLINE)} | {
    JOINT_STATE_TOPIC: JOINT_STATE_NAME
}
_SCHEMA_IDS = {name: index for index, name in enumerate(SCHEMAS, 1)}


def arm_topic(arm: str) -> str:
    """The display topic of one arm."""
    return ARM.topic + arm


@lru_cache(maxsize=64)
def topics(arms: tuple[str, ...]) -> dict[str, Topic]:
    """Every topic that an episode with these arms can have, by name."""
    names = _FIXED | {arm_topic(arm): ARM.name for arm in arms}
    return {
        topic: _topic(index, topic, name) for index, (topic, name) in enumerate(names.items(), 1)
    }


def _topic(index: int, topic: str, name: str) -> Topic:
    number = _SCHEMA_IDS[name]
    schema = Schema(id=number, name=name, encoding=ENCODING, data=SCHEMAS[name].encode())
    channel = Channel(
        id=index, topic=topic, message_encoding=MESSAGE_ENCODING, metadata={}, schema_id=number
    )
    return Topic(index, pack(schema), pack(channel))
