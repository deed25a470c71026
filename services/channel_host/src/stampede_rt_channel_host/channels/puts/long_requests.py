"""Takes the runs out of a long request of puts or enqueues without a copy.

PutRequest and EnqueueRequest have the same form: a head of three fields, then the runs. Each run is a message that
begins with up to two numbers and its ItemRun.
"""

from __future__ import annotations

from typing import Any, NamedTuple, TypeVar

from stampede_rt.errors import InvalidArgument
from stampede_rt.wire.request_pieces import MESSAGE_BYTES_MAX
from stampede_rt.wire.varints import decode_varint
from stampede_rt_channel_host.channels.requests import MessageType, parse

SHORT_BYTES = 4096
"""Protobuf parses a request up to this length whole, which is faster. Longer requests are read field by field."""

_HEAD_TAGS = {1 << 3 | 2, 2 << 3 | 0, 3 << 3 | 1}  # the channel or queue, epoch and producer_id
_FIXED64 = 1
_RUNS_TAG = 4 << 3 | 2
_NUMBER_TAGS = {1 << 3, 2 << 3}  # first_number and wait_nanos of a run
_RUN_TAG = 3 << 3 | 2
_TAIL_BYTES_MAX = 8192  # the most bytes of the fields after a run, such as a message id and an origin

Encoded = bytes | bytearray | memoryview
Head = TypeVar("Head")
Run = TypeVar("Run")


class LongRequest(NamedTuple):
    """A decoded request. `head`: the message of the request, without its runs.

    `runs`: for each run, the message of the run without the encoded items, and a view of the encoded items.
    """

    head: Any
    runs: list[tuple[Any, memoryview]]


def read_long(raw: Encoded, head: MessageType[Head], run: MessageType[Run], name: str) -> LongRequest | None:
    """Decode a request whose fields come in the order of their numbers, as all protobuf encoders write them.

    Returns None for a short request, and for a request of another form: the caller then gives the request to protobuf,
    which decodes or refuses it. But a request of another form with more than MESSAGE_BYTES_MAX raises InvalidArgument,
    because protobuf would copy up to 20 MiB in one step, while all other callers wait. Also raises InvalidArgument for
    bytes that are no message. `name`: the name of the message in errors.
    """
    found = _read(raw, head, run, name) if len(raw) > SHORT_BYTES else None
    if found is None and len(raw) > MESSAGE_BYTES_MAX:
        raise InvalidArgument(
            f"the {len(raw)} bytes of a large request are not a valid {name} message whose fields come in the order "
            "of their numbers; encode it from the .proto file, and leave out fields that the file does not have"
        )
    return found


def _read(raw: Encoded, head: MessageType[Head], run: MessageType[Run], name: str) -> LongRequest | None:
    view, runs = memoryview(raw), []
    try:
        at = _end_of_head(raw)
        decoded_head = parse(head, bytes(view[:at]), name)
        while at < len(raw):
            if raw[at] != _RUNS_TAG:
                return None
            length, begin = decode_varint(raw, at + 1)
            at = begin + length
            run_tag, place = _run_in(raw, begin)
            if not 0 <= place.stop <= at <= len(raw) or at - place.stop > _TAIL_BYTES_MAX:
                return None
            message: Any = parse(run, bytes(view[begin:run_tag]) + bytes(view[place.stop : at]), name)
            if message.run:  # the message has two runs
                return None
            runs.append((message, view[place]))
    except IndexError:  # the request ends within a field
        return None
    return LongRequest(decoded_head, runs)


def _end_of_head(raw: Encoded) -> int:
    """The position after the fields of the head, which come before the runs."""
    at = 0
    while raw[at] in _HEAD_TAGS:
        if raw[at] & 7 == _FIXED64:
            at += 9
            continue
        number, end = decode_varint(raw, at + 1)  # the epoch, or the length of the bytes that follow
        at = end + number if raw[at] & 7 else end
    return at


def _run_in(raw: Encoded, at: int) -> tuple[int, slice]:
    """The position of the run's tag in the message that begins at `at`, and the slice of `raw` that is the run.

    The slice is (-1, -1) if the message does not have the usual form.
    """
    while raw[at] in _NUMBER_TAGS:
        at = decode_varint(raw, at + 1)[1]
    if raw[at] != _RUN_TAG:
        return at, slice(-1, -1)
    length, begin = decode_varint(raw, at + 1)
    return at, slice(begin, begin + length)
