"""A text that controls a terminal and forges lines, and protobuf messages in which each text is this one."""

from __future__ import annotations

from google.protobuf.descriptor import Descriptor, FieldDescriptor
from google.protobuf.message import Message
from google.protobuf.message_factory import GetMessageClass

HOSTILE = "a\x1b]0;title\x07b\r\nforged\u202e\x9b31m\x1b[2J"
DEPTH_MAX = 4


def hostile_message(described: Descriptor, depth: int = 0) -> Message:
    """Return a message with the hostile text in each of its texts and bytes, and in those of its nested messages. In a
    oneof the last field is set.
    """
    message = GetMessageClass(described)()
    for field in described.fields:
        value = _value(field, depth)
        if value is None:
            continue
        if field.is_repeated:
            getattr(message, field.name).append(value)
        elif isinstance(value, Message):
            getattr(message, field.name).CopyFrom(value)
        else:
            setattr(message, field.name, value)
    return message


def _value(field: FieldDescriptor, depth: int) -> Message | str | bytes | None:
    if field.message_type is not None:
        is_map = field.message_type.GetOptions().map_entry
        return None if is_map or depth == DEPTH_MAX else hostile_message(field.message_type, depth + 1)
    if field.type == FieldDescriptor.TYPE_STRING:
        return HOSTILE
    return HOSTILE.encode() if field.type == FieldDescriptor.TYPE_BYTES else None
