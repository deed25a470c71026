"""Random protobuf messages, made from their descriptors. The encoded bytes of some messages are then damaged."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

from google.protobuf.descriptor import Descriptor, FieldDescriptor
from google.protobuf.message import Message
from google.protobuf.message_factory import GetMessageClass

from tests.robustness.fuzz import hostile_values
from tests.robustness.fuzz.drawing import ByteSource

KEPT_OF_EACH = 48
DEPTH_MAX = 6
REPEATED_BYTES_MAX = 100_000
LENGTH_DELIMITED = 2
_BITS = {
    FieldDescriptor.CPPTYPE_INT32: (32, True),
    FieldDescriptor.CPPTYPE_INT64: (64, True),
    FieldDescriptor.CPPTYPE_UINT32: (32, False),
    FieldDescriptor.CPPTYPE_UINT64: (64, False),
}


class KnownValues:
    """The values that a caller has learnt of a cluster: ids, names, epochs and others, by the names of their fields."""

    def __init__(self) -> None:
        self._values: dict[str, list[Any]] = {}
        self._spared: set[Any] = set()

    def spare(self, *values: Any) -> None:
        """Never learn these values."""
        self._spared.update(values)

    def add(self, name: str, *values: Any) -> None:
        """Add values for the field `name`."""
        known = self._values.setdefault(name, [])
        for value in values:
            if value in known:
                known.remove(value)  # the latest values are kept longest
            if value not in self._spared:
                known.append(value)
        del known[:-KEPT_OF_EACH]

    def of(self, name: str) -> Sequence[Any]:
        """The values of a field in the order in which they were learnt."""
        return self._values.get(name, ())

    def learn(self, message: Message) -> None:
        """Learn all values of an answer."""
        for field, value in message.ListFields():
            for one in value if isinstance(value, Iterable) and not isinstance(value, (str, bytes)) else (value,):
                if isinstance(one, Message):
                    self.learn(one)
                elif field.message_type is None and not isinstance(one, (bool, float)):
                    self.add(field.name, one)


def drawn_message(source: ByteSource, descriptor: Descriptor, known: KnownValues, depth: int = 0) -> Message:
    """A message that any caller in any language could make. Most messages use known values."""
    message: Message = GetMessageClass(descriptor)()
    aimed, share = not source.chance(30), source.choice((70, 90, 45, 20))
    for field in descriptor.fields:
        values = [value for value in known.of(field.name) if _fits(field, value)] if aimed else []
        if values and source.below(100) < 95:
            _set_known(source, message, field, values)
        elif source.chance(share):
            _set(source, message, field, known, depth)
    if descriptor.full_name in _SHAPES and not source.chance(20):
        _SHAPES[descriptor.full_name](source, message)
    return message


def _is_message(field: FieldDescriptor) -> bool:
    return field.message_type is not None


def _set_known(source: ByteSource, message: Message, field: FieldDescriptor, values: Sequence[Any]) -> None:
    if field.is_repeated:
        getattr(message, field.name).extend(source.choice(values) for _ in range(_count(source)))
    else:
        setattr(message, field.name, source.choice(values))


def _whole_run(source: ByteSource, message: Any) -> None:
    """Columns of one length, as a producer encodes them."""
    payloads = [source.take(source.choice((4, 0, 1, 30))) for _ in range(1 + source.below(4))]
    del message.payload_length_bytes[:]
    message.payload_length_bytes.extend(map(len, payloads))
    message.payloads = b"".join(payloads)
    message.ClearField("origin")
    for column in (message.time_unix_nano, message.duration_nanos):
        if column and source.chance(50):
            del column[:]  # the host stamps the items, and they last until the next ones
        elif column:
            values = sorted((*column, *column, *column, *column)[: len(payloads)])
            del column[:]
            column.extend(values)
    message.first_seq = 0
    message.ClearField("attributes" if source.chance(80) else "content_type")


_SHAPES: dict[str, Callable[[ByteSource, Any], None]] = {"stampede_rt.v1.ItemRun": _whole_run}


def _set(source: ByteSource, message: Message, field: FieldDescriptor, known: KnownValues, depth: int) -> None:
    if _is_message(field) and field.message_type.GetOptions().map_entry:
        values = field.message_type.fields_by_name["value"]
        for _ in range(source.below(4)):
            getattr(message, field.name)[hostile_values.text(source)] = _scalar(source, values, known)
    elif _is_message(field):
        _set_message(source, message, field, known, depth)
    elif field.is_repeated:
        getattr(message, field.name).extend(_scalar(source, field, known) for _ in range(_count(source)))
    else:
        setattr(message, field.name, _scalar(source, field, known))


def _set_message(source: ByteSource, message: Message, field: FieldDescriptor, known: KnownValues, depth: int) -> None:
    if depth >= DEPTH_MAX:
        return
    for _ in range(_count(source) if field.is_repeated else 1):
        part = drawn_message(source, field.message_type, known, depth + 1)
        if field.is_repeated:
            getattr(message, field.name).append(part)
        else:
            getattr(message, field.name).CopyFrom(part)


def _count(source: ByteSource) -> int:
    return source.choice((1, 2, 0, 3, 1, 1, 2, 300 if source.chance(5) else 4))


def _scalar(source: ByteSource, field: FieldDescriptor, known: KnownValues) -> Any:
    known_values = known.of(field.name)
    if known_values and source.chance(75):
        value = source.choice(known_values)
        if _fits(field, value):
            return value
    if field.cpp_type in _BITS:
        return _wrapped(hostile_values.integer(source), *_BITS[field.cpp_type])
    if field.type == FieldDescriptor.TYPE_BYTES:
        return hostile_values.blob(source)
    return _ANY[field.cpp_type](source)


def _fits(field: FieldDescriptor, value: Any) -> bool:
    if field.cpp_type == FieldDescriptor.CPPTYPE_STRING:
        return isinstance(value, bytes if field.type == FieldDescriptor.TYPE_BYTES else str)
    if field.cpp_type == FieldDescriptor.CPPTYPE_ENUM:
        return isinstance(value, int) and abs(value) < 10
    if field.cpp_type in _BITS and isinstance(value, int):
        return value == _wrapped(value, *_BITS[field.cpp_type])
    return False


def _wrapped(value: int, bits: int, signed: bool) -> int:
    value %= 2**bits
    return value - 2**bits if signed and value >= 2 ** (bits - 1) else value


_ANY: dict[int, Callable[[ByteSource], Any]] = {
    FieldDescriptor.CPPTYPE_STRING: hostile_values.text,
    FieldDescriptor.CPPTYPE_BOOL: lambda source: source.chance(50),
    FieldDescriptor.CPPTYPE_ENUM: lambda source: source.choice((1, 0, 2, 3, 4, 5, 99, -1, 2**31 - 1)),
    FieldDescriptor.CPPTYPE_FLOAT: lambda source: source.choice(hostile_values.FLOATS),
    FieldDescriptor.CPPTYPE_DOUBLE: lambda source: source.choice(hostile_values.FLOATS),
}


def drawn_request(source: ByteSource, descriptor: Descriptor, known: KnownValues) -> bytes:
    """The bytes of a message of this type. Most of them are valid."""
    return _maybe_damaged(source, drawn_message(source, descriptor, known))


def drawn_stream(source: ByteSource, descriptor: Descriptor, known: KnownValues, count: int) -> list[bytes]:
    """The messages of one stream. Most streams have the opening once, in the first message."""
    messages = [drawn_message(source, descriptor, known) for _ in range(count)]
    for name in ("hello", "open"):
        if name in descriptor.fields_by_name and not source.chance(15):
            _open(source, messages, descriptor.fields_by_name[name], known)
    return [_maybe_damaged(source, message) for message in messages]


def _open(source: ByteSource, messages: Sequence[Message], field: FieldDescriptor, known: KnownValues) -> None:
    for message in messages:
        message.ClearField(field.name)  # type: ignore[arg-type]
    if field.name == "hello":
        messages[0].Clear()
    _set(source, messages[0], field, known, 0)


def _maybe_damaged(source: ByteSource, message: Message) -> bytes:
    raw = message.SerializeToString()
    return damaged(source, raw) if source.chance(20) else raw


def damaged(source: ByteSource, raw: bytes) -> bytes:
    """The bytes of a message, changed at one place or several, at any depth."""
    for _ in range(1 + source.below(3)):
        raw = source.choice(_DAMAGES)(source, raw)
    return raw


def varint(value: int) -> bytes:
    """Encode a number as a varint."""
    out = bytearray()
    while value > 127:
        out.append(value & 127 | 128)
        value >>= 7
    return bytes((*out, value))


def _records(raw: bytes) -> list[bytes]:
    """The fields of a message, each with tag and value. A rest that cannot be parsed is the last field."""
    found, at = [], 0
    while at < len(raw):
        end = _end_of_record(raw, at)
        found.append(raw[at:end])
        at = end
    return found


def _end_of_record(raw: bytes, at: int) -> int:
    tag, at = _varint_at(raw, at)
    match tag & 7:
        case 0:
            return _varint_at(raw, at)[1]
        case 1:
            return min(at + 8, len(raw))
        case 2:
            length, at = _varint_at(raw, at)
            return min(at + length, len(raw))
        case 5:
            return min(at + 4, len(raw))
    return len(raw)


def _varint_at(raw: bytes, at: int) -> tuple[int, int]:
    value = shift = 0
    while at < len(raw):
        byte = raw[at]
        value |= (byte & 127) << shift
        at, shift = at + 1, shift + 7
        if byte < 128 or shift > 63:
            break
    return value, at


def _some_record(source: ByteSource, raw: bytes) -> tuple[list[bytes], int]:
    records = _records(raw) or [b""]
    return records, source.below(len(records))


def _repeated(source: ByteSource, raw: bytes) -> bytes:
    """Repeat a field. If the field is singular, its last value counts."""
    records, place = _some_record(source, raw)
    times = min(source.choice((1, 2, 50, 1000)), REPEATED_BYTES_MAX // max(1, len(records[place])))
    return b"".join([*records, *[records[place]] * times])


def _shuffled(source: ByteSource, raw: bytes) -> bytes:
    records, place = _some_record(source, raw)
    return b"".join(records[place:] + records[:place])


def _without(source: ByteSource, raw: bytes) -> bytes:
    records, place = _some_record(source, raw)
    return b"".join(records[:place] + records[place + 1 :])


def _inside(source: ByteSource, raw: bytes) -> bytes:
    """The same message with another value in a field, and a corrected length."""
    records, place = _some_record(source, raw)
    tag, start = _varint_at(records[place], 0)
    if tag & 7 == LENGTH_DELIMITED:
        _, start = _varint_at(records[place], start)
        inner = source.choice(_DAMAGES[:-1])(source, records[place][start:])
        records[place] = varint(tag) + varint(len(inner)) + inner
    return b"".join(records)


def _unknown(source: ByteSource, raw: bytes) -> bytes:
    """Fields that the contract lacks, of all wire types."""
    number = source.choice((999, 536870911, 0, 19000, 15))
    extra = (
        varint(number << 3 | 2) + varint(5) + b"extra",
        varint(number << 3) + b"\xff" * 9 + b"\x01",
        varint(number << 3 | 1) + b"\0" * 8,
        varint(number << 3 | 5) + b"\0" * 4,
        varint(number << 3 | 3) + varint(number << 3 | 4),
        varint(number << 3 | 6),
        varint(number << 3 | 2) + varint(10_000) + b"z" * 10_000,
    )
    return raw + source.choice(extra)


def _nested(source: ByteSource, raw: bytes) -> bytes:
    """The message inside further messages, sometimes deeper than a parser allows."""
    number = 1 + source.below(20)
    for _ in range(source.choice((3, 40, 99, 101, 300))):
        raw = varint(number << 3 | 2) + varint(len(raw)) + raw
    return raw


def _huge_varint(source: ByteSource, raw: bytes) -> bytes:
    tag = varint((1 + source.below(20)) << 3 | source.choice((0, 2)))
    return (
        raw
        + tag
        + source.choice((b"\xff" * 9 + b"\x01", b"\xff" * 20, b"\x80" * 9 + b"\0", varint(2**31), b"\xff" * 9))
    )


def _cut(source: ByteSource, raw: bytes) -> bytes:
    return raw[: source.below(len(raw) + 1)]


def _flipped(source: ByteSource, raw: bytes) -> bytes:
    if not raw:
        return raw
    changed = bytearray(raw)
    for _ in range(1 + source.below(4)):
        changed[source.below(len(changed))] ^= 1 << source.below(8)
    return bytes(changed)


_DAMAGES: tuple[Callable[[ByteSource, bytes], bytes], ...] = (
    *(_repeated, _shuffled, _without, _unknown, _nested, _huge_varint, _cut, _flipped, _flipped),
    _inside,
)
