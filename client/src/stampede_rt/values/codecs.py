"""Codecs of channels and queues: they turn values into payloads and back. Pure. numpy is imported at its first use.

Each item carries its content type on the wire. A reader without the writer's codec can therefore still tell the kind of
a payload.
"""

from __future__ import annotations

import io
import json
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, Protocol, runtime_checkable

from stampede_rt.errors import CodecError, InvalidArgument
from stampede_rt.values.model import PutItem
from stampede_rt.values.payloads import check_payload


@runtime_checkable
class Codec(Protocol):
    """The interface of a codec: a MIME type, and two functions. `decode` is the inverse of `encode`.

    `encode` and `decode` may raise any exception. The caller gets a CodecError with that exception as its cause.
    """

    @property
    def content_type(self) -> str:
        """The MIME type of the encoded payloads: 1 to 255 ASCII characters."""
        ...

    def encode(self, value: Any) -> bytes:
        """Return `value` as a payload."""
        ...

    def decode(self, payload: bytes) -> Any:
        """Return the value of `payload`."""
        ...


CodecLike = Literal["bytes", "json", "numpy"] | Codec
"""The name of a codec of this package, or a codec of the program."""


class JsonCodec:
    """JSON values: text, numbers, lists, dictionaries with text as keys, true, false, null."""

    content_type = "application/json"

    def encode(self, value: Any) -> bytes:
        """Return the value as JSON in UTF-8. Refuses NaN and infinity, because JSON has no such numbers."""
        return json.dumps(value, ensure_ascii=False, allow_nan=False, separators=(",", ":")).encode()

    def decode(self, payload: bytes) -> Any:
        """Return the value of JSON text."""
        return json.loads(payload)


class NumpyCodec:
    """Arrays with shape and dtype, in numpy's file format (`.npy`). Other languages have readers for this format."""

    content_type = "application/x-npy"

    def __init__(self) -> None:
        try:
            import numpy  # noqa: F401  # so that a missing numpy is an error here, and not at the first item
        except ImportError as error:
            raise CodecError('codec="numpy" needs numpy, which is not installed; run: pip install numpy') from error

    def encode(self, value: Any) -> bytes:
        """Return an array, or any value that numpy turns into one, as a `.npy` file. Refuses arrays of objects."""
        import numpy as np

        file = io.BytesIO()
        np.lib.format.write_array(file, np.asarray(value), allow_pickle=False)
        return file.getvalue()

    def decode(self, payload: bytes) -> Any:
        """Return a new, writable array."""
        import numpy as np

        return np.lib.format.read_array(io.BytesIO(payload), allow_pickle=False)


_NAMED: dict[str, type[JsonCodec] | type[NumpyCodec]] = {"json": JsonCodec, "numpy": NumpyCodec}


@dataclass(frozen=True, slots=True)
class HandleCodec:
    """The codec of a handle. `thing` names the channel or queue in errors; `content_type` labels the payloads."""

    codec: Codec
    thing: str
    content_type: str

    @classmethod
    def parse(cls, codec: str | Codec | None, thing: str, content_type: str | None = None) -> HandleCodec | None:
        """Return the coding for the argument `codec` of a handle; None if the program puts and gets plain payloads.

        `content_type` replaces the content type of the codec. Raises InvalidArgument, and CodecError if the codec is
        "numpy" and numpy is not installed.
        """
        if codec is None or codec == "bytes":
            return None
        if isinstance(codec, str) and codec in _NAMED:
            codec = _NAMED[codec]()
        if isinstance(codec, str | type) or not isinstance(codec, Codec):
            raise InvalidArgument(
                f'codec is {codec!r}; write "bytes", "json" or "numpy", or give an object with content_type, encode '
                "and decode"
            )
        label = content_type or codec.content_type
        if not isinstance(label, str) or not (label.isascii() and 0 < len(label) <= 255):
            raise InvalidArgument(
                f"the codec's content_type is {label!r}; write a MIME type of 1 to 255 ASCII characters"
            )
        return cls(codec, thing, label)

    def encode(self, value: Any) -> bytes:
        """Return `value` as a payload. Raises CodecError, ItemTooLarge."""
        try:
            payload = self.codec.encode(value)
        except Exception as error:
            raise CodecError(
                f"{self.thing}: a value of type {type(value).__name__} cannot be encoded as {self.content_type}: "
                f"{error}"
            ) from error
        return check_payload(payload)

    def decode(self, payload: bytes | None, content_type: str, which: str) -> Any:
        """Return the value of `payload`; None if `payload` is None. `which` names the item or message in errors.

        Raises CodecError, also if `content_type` is not empty and has another media type than the codec.
        """
        if payload is None:
            return None
        if content_type and _media_type(content_type) != _media_type(self.content_type):
            raise CodecError(
                f"{self.thing}: {which} is {content_type}, not {self.content_type}; name the codec for it, or read "
                "its payload"
            )
        try:
            return self.codec.decode(payload)
        except Exception as error:
            raise CodecError(
                f"{self.thing}: {which} ({len(payload)} bytes) cannot be decoded as {self.content_type}: {error}; "
                "read its payload instead"
            ) from error

    def item(self, fields: Iterable[Any]) -> CodedItem:
        """Return the item with these fields of `Item`, in their order. The item decodes its own payload."""
        item = CodedItem._make(fields)
        item.coding = self
        return item


class CodedItem(PutItem):
    """An item of a handle with a codec. It decodes its payload at the first use of `value`, and keeps the value."""

    coding: HandleCodec | None = None

    @cached_property
    def value(self) -> Any:
        """The decoded payload; None in reads without payloads. Raises CodecError."""
        if self.coding is None:  # the item is a copy made with `_replace`, which keeps no codec
            return self.payload
        return self.coding.decode(self.payload, self.content_type, f"item #{self.seq} at {self.time}")


def _media_type(content_type: str) -> str:
    return content_type.partition(";")[0].strip().lower()
