"""The topics of a node: their names, types, and how contacts are read from messages."""

from collections.abc import Iterator
from typing import Any, Final, NamedTuple

from taxel.ros2.finger_input import ContactMessage
from taxel.ros2.messages import (
    BIOTAC_ALL,
    CHANNEL_ARRAY,
    CONTACT,
    DIAGNOSTICS,
    POINT,
    WRENCH,
    stamp_ns_of,
    vector_of,
)
from taxel.ros2.settings import Inputs, NodeSettings

HAND_TOPIC: Final = "tactile"
DIAGNOSTICS_TOPIC: Final = "/diagnostics"

DIAGNOSTICS_EVERY_S: Final = 1.0


class InputTopic(NamedTuple):
    """A topic that brings contacts of a finger."""

    finger: str
    name: str
    type: str


def input_topics(settings: NodeSettings) -> Iterator[InputTopic]:
    """The topics that bring contacts; names are relative to the node's namespace."""
    for finger in settings.fingers:
        if settings.inputs is Inputs.TACTILE_CONTACT:
            yield InputTopic(finger, f"{finger}/contact", CONTACT)
        else:
            yield InputTopic(finger, f"{finger}/wrench", WRENCH)
            yield InputTopic(finger, f"{finger}/point", POINT)


def output_topics(settings: NodeSettings) -> dict[str, str]:
    """The types of the topics that are published, by name."""
    topics = {channel_topic(finger): CHANNEL_ARRAY for finger in settings.fingers}
    if settings.is_shadow_hand:
        topics[HAND_TOPIC] = BIOTAC_ALL
    return {**topics, DIAGNOSTICS_TOPIC: DIAGNOSTICS}


def channel_topic(finger: str) -> str:
    """The topic of a finger's channels."""
    return f"{finger}/tactile"


def contact_of(message: Any, name: str) -> ContactMessage:
    """What a message of the type `name` says of a contact."""
    header = message.header
    stamp_ns, frame_id = stamp_ns_of(header), str(header.frame_id)
    if name == POINT:
        return ContactMessage(stamp_ns, frame_id, vector_of(message.point), None)
    place = vector_of(message.position) if name == CONTACT else None
    return ContactMessage(stamp_ns, frame_id, place, vector_of(message.wrench.force))
