"""How handles show themselves, and what becomes of them when they are copied or pickled. Pure."""

from __future__ import annotations

from typing import NoReturn, Self

ID_DIGITS_SHOWN = 8


def handle_repr(kind: str, name: str, id_: bytes, host: str, state: str) -> str:
    """`<Channel 'cam/left' 3fa2c1d0 at host 'h1'>`, and behind it what keeps it from being used, if anything does."""
    identity = f" {id_.hex()[:ID_DIGITS_SHOWN]}" if id_ else ""
    place = f" at host {host!r}" if host else ""
    return f"<{kind} {name!r}{identity}{place}{f', {state}' if state else ''}>"


class Reference:
    """What only names something elsewhere: a copy of it is itself."""

    def __copy__(self) -> Self:
        return self

    def __deepcopy__(self, memo: object) -> Self:
        return self


class BoundToProcess:
    """What is at work: it cannot be copied, nor passed to another process."""

    def __reduce_ex__(self, protocol: object) -> NoReturn:
        raise TypeError(
            f"a {type(self).__name__} is at work in this process: it cannot be copied or pickled; pass the channel, "
            "group or queue that it belongs to, and begin another there"
        )
