"""Rules by which handles are printed, copied and pickled. Pure."""

from __future__ import annotations

from typing import NoReturn, Self

ID_DIGITS_SHOWN = 8


def handle_repr(kind: str, name: str, id_: bytes, host: str, state: str) -> str:
    """Return a text such as `<Channel 'cam/left' 3fa2c1d0 at host 'h1'>`.

    The text has the first ID_DIGITS_SHOWN hexadecimal digits of `id_`. `state`: the words at the end of the text, such
    as "closed"; empty: none.
    """
    identity = f" {id_.hex()[:ID_DIGITS_SHOWN]}" if id_ else ""
    place = f" at host {host!r}" if host else ""
    return f"<{kind} {name!r}{identity}{place}{f', {state}' if state else ''}>"


class Reference:
    """A handle that only names a thing. `copy` returns the handle itself."""

    def __copy__(self) -> Self:
        return self

    def __deepcopy__(self, memo: object) -> Self:
        return self


class BoundToProcess:
    """A handle that works only in this process. It cannot be copied or pickled."""

    def __reduce_ex__(self, protocol: object) -> NoReturn:
        raise TypeError(
            f"a {type(self).__name__} works only in this process and cannot be copied or pickled; pass its channel, "
            "group or queue instead, and make a new one there"
        )
