"""Finds the item of a channel at an instant, with a preview, and the times of the items before and after."""

from __future__ import annotations

import asyncio
import time
from collections import OrderedDict
from typing import Any, Literal

from stampede_rt import Item, Items, StampedeError, aio
from stampede_rt.values.timeline import NEWEST, OLDEST
from stampede_rt_web.preview import picture_of, preview_of

PICTURES_BYTES_MAX = 64 * 1024 * 1024
PICTURE_BYTES_MAX = 8 * 1024 * 1024  # a larger picture is not shown
NEWEST_AGE_NANOS_MAX = 150_000_000  # pages that ask for the newest item more often get the same answer

Key = tuple[bytes, int, int]  # the channel's id, its incarnation, and the item's seq
Direction = Literal["next", "previous"]


class PictureCache:
    """The pictures that pages will fetch, by item.

    Beyond PICTURES_BYTES_MAX, drops the picture for which no caller has called `keep` for the longest time.
    """

    def __init__(self) -> None:
        self._pictures: OrderedDict[str, tuple[str, bytes]] = OrderedDict()
        self._bytes = 0

    def keep(self, key: str, content_type: str, picture: bytes) -> None:
        """Keep a picture until later pictures need its room."""
        if key not in self._pictures:
            self._pictures[key] = (content_type, picture)
            self._bytes += len(picture)
        self._pictures.move_to_end(key)
        while self._bytes > PICTURES_BYTES_MAX:
            _, (_, gone) = self._pictures.popitem(last=False)
            self._bytes -= len(gone)

    def get(self, key: str) -> tuple[str, bytes] | None:
        """Return the content type and the bytes of a picture; None if the cache has dropped it."""
        return self._pictures.get(key)


class ItemPreviews:
    """Makes answers with the item of a channel at an instant.

    Several pages that ask for the newest item share one read.
    """

    def __init__(self) -> None:
        self.pictures = PictureCache()
        self._newest: OrderedDict[tuple[str, str], tuple[int, dict[str, Any]]] = OrderedDict()

    async def at(self, reader: aio.Channel | aio.GroupChannel, group: str, instant: int | None) -> dict[str, Any]:
        """Return the answer with the item whose span contains `instant` (nanoseconds); None: the newest item.

        If there is no such item, the answer says why.
        """
        key = (reader.name, group)
        if instant is None and key in self._newest and time.time_ns() - self._newest[key][0] < NEWEST_AGE_NANOS_MAX:
            return self._newest[key][1]
        read_at_nanos = time.time_ns()
        try:
            found = await reader.at(NEWEST if instant is None else instant)
        except StampedeError as error:
            return {"channel": reader.name, "failure": error.message}
        answer = await self._answer(reader, found)
        if instant is None:
            self._newest[key] = (read_at_nanos, answer)
            while len(self._newest) > 256:
                self._newest.popitem(last=False)
        return answer

    async def _answer(self, reader: aio.Channel | aio.GroupChannel, found: Items) -> dict[str, Any]:
        if not found:
            reason = found.reason
            return {
                "channel": reader.name,
                "reason": str(reason) if reason else None,
                "detail": reason.detail if reason else "No item's span contains this instant.",
            }
        item = found[-1]
        preview = await asyncio.to_thread(self._preview, reader.info.channel_id, item)
        return {"channel": reader.name, "item": _facts(item), "others": len(found) - 1, "preview": preview}

    def _preview(self, channel_id: bytes, item: Item) -> dict[str, Any]:
        payload = item.payload or b""
        shown = preview_of(item.content_type, payload)
        if shown["kind"] == "picture":
            content_type, picture = picture_of(item.content_type, payload) or ("", b"")
            if len(picture) > PICTURE_BYTES_MAX:
                return {"kind": "text", "text": f"A picture of {len(picture)} bytes is too large for this page."}
            key = f"{channel_id.hex()}-{item.incarnation}-{item.seq}"
            self.pictures.keep(key, content_type, picture)
            shown["url"] = f"picture/{key}"
        return shown


async def neighbour_time(reader: aio.Channel | aio.GroupChannel, instant: int, direction: Direction) -> str | None:
    """Return the time of the first item after `instant`, or of the last one before it, as text; None: there is none."""
    found = await reader.get(
        OLDEST,
        NEWEST,
        match="start",
        after=instant,
        newest_first=direction == "previous",
        limit=1,
        payloads=False,
    )
    return str(found[0].time) if found else None


def _facts(item: Item) -> dict[str, Any]:
    return {
        "time": str(item.time),
        "end": None if item.end is None else str(item.end),
        "duration_nanos": item.duration,
        "seq": item.seq,
        "bytes": item.payload_length_bytes,
        "content_type": item.content_type,
        "attributes": dict(list(item.attributes.items())[:32]),
    }
