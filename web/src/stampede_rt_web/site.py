"""Answers the page's requests: static files, the state of the cluster, drawings of tracks, items and pictures.

No request changes anything. A request names at most TRACKS_MAX channels. Answers are JSON with escaped non-ASCII
letters.
"""

from __future__ import annotations

import asyncio
import json
import time
from pathlib import Path
from typing import Any

from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import FileResponse, Response
from starlette.routing import Mount, Route
from starlette.staticfiles import StaticFiles

from stampede_rt import StampedeError, aio
from stampede_rt.cli.doctor import examine
from stampede_rt.values.policy import parse_name
from stampede_rt.values.timeline import MAX_INSTANT, MIN_INSTANT
from stampede_rt_web.drawing import WIDTH_MAX, Window, draw
from stampede_rt_web.following import TRACKS_MAX, FollowedChannels
from stampede_rt_web.items import Direction, ItemPreviews, neighbour_time
from stampede_rt_web.overview import Overview

STATIC = Path(__file__).parent / "static"
FINDINGS_NANOS = 10_000_000_000  # within this time all pages get the same findings of `stampede doctor`
CONNECT_REST_SECONDS = 1.0  # the least time between a failed attempt to connect and the next one


class Site:
    """Answers the page's requests with one connection to the cluster, which it opens when a page first asks."""

    def __init__(self, url: str | None, channels_glob: str) -> None:
        self._url = url
        self._rt: aio.Connection | None = None
        self._connecting = asyncio.Lock()
        self._failed_at = 0.0
        self._failure = ""
        self._followed = FollowedChannels()
        self._overview = Overview(channels_glob)
        self._previews = ItemPreviews()
        self._findings: dict[str, Any] = {}
        self._findings_due = 0
        self._examining = asyncio.Lock()

    def app(self) -> Starlette:
        """Return the ASGI application."""
        return Starlette(
            routes=[
                Route("/", _index),
                Route("/api/overview", self._answer_overview),
                Route("/api/timeline", self._answer_timeline),
                Route("/api/at", self._answer_at),
                Route("/api/step", self._answer_step),
                Route("/api/doctor", self._answer_doctor),
                Route("/picture/{key}", self._answer_picture),
                Mount("/static", StaticFiles(directory=STATIC)),
            ],
            exception_handlers={StampedeError: _failed},
        )

    async def aclose(self) -> None:
        """Close the connection to the cluster."""
        if self._rt is not None:
            await self._rt.aclose()

    async def _connection(self) -> aio.Connection:
        """Return the connection. Raises StampedeError if no cluster answers; the next request tries again."""
        async with self._connecting:
            if self._rt is None:
                rest = self._failed_at + CONNECT_REST_SECONDS - time.monotonic()
                if self._failed_at and rest > 0:
                    raise HTTPException(503, self._failure)
                try:
                    self._rt = await aio.connect(self._url)
                except StampedeError as error:
                    self._failed_at, self._failure = time.monotonic(), error.message
                    raise
            return self._rt

    async def _answer_overview(self, request: Request) -> Response:
        return _json(await self._overview.answer(await self._connection()))

    async def _answer_timeline(self, request: Request) -> Response:
        rt = await self._connection()
        window = Window(
            start=_instant(request, "from"), end=_instant(request, "to"), width=_whole(request, "width", WIDTH_MAX)
        )
        if window.end <= window.start:
            raise HTTPException(400, "`to` is not later than `from`")
        names = _names(request)
        drawings = await asyncio.gather(*(self._drawing(rt, name, window) for name in names))
        return _json(
            {"base": str(window.start), "now": str(time.time_ns()), "channels": dict(zip(names, drawings, strict=True))}
        )

    async def _drawing(self, rt: aio.Connection, name: str, window: Window) -> dict[str, Any]:
        try:
            followed = await self._followed.channel(rt, name)
        except StampedeError as error:
            self._followed.forget(name)
            return {"failure": error.message}
        await followed.refresh(window, self._overview.stats.get(name))
        if followed.is_gone:
            self._followed.forget(name)
        overlap_nanos = followed.channel.info.policy.overlap_nanos or 0
        drawing = draw(followed.track_for(window), window, overlap_nanos=overlap_nanos)
        if followed.archive_oldest is not None:
            drawing["archive_oldest"] = str(followed.archive_oldest)
        return drawing | ({"failure": followed.failure} if followed.failure else {})

    async def _answer_at(self, request: Request) -> Response:
        rt = await self._connection()
        group = request.query_params.get("group", "")
        at = request.query_params.get("at", "newest")
        instant = None if at == "newest" else _instant(request, "at")
        names = _names(request)
        answers = await asyncio.gather(*(self._item(rt, name, group, instant) for name in names))
        return _json({"now": str(time.time_ns()), "items": answers})

    async def _item(self, rt: aio.Connection, name: str, group: str, instant: int | None) -> dict[str, Any]:
        try:
            return await self._previews.at(await self._reader(rt, name, group), group, instant)
        except StampedeError as error:
            return {"channel": name, "failure": error.message}

    async def _reader(self, rt: aio.Connection, name: str, group: str) -> aio.Channel | aio.GroupChannel:
        """Return the channel `name`; if it is a member of `group`, its descriptor in the group."""
        if group:
            opened = await rt.group(group)
            if any(member.name == name for member in opened):
                return opened[name]
        return (await self._followed.channel(rt, name)).channel

    async def _answer_step(self, request: Request) -> Response:
        rt = await self._connection()
        reader = await self._reader(rt, _names(request)[0], request.query_params.get("group", ""))
        direction: Direction = "previous" if request.query_params.get("direction") == "previous" else "next"
        return _json({"time": await neighbour_time(reader, _instant(request, "at"), direction)})

    async def _answer_doctor(self, request: Request) -> Response:
        async with self._examining:
            if time.time_ns() >= self._findings_due:
                found, _ = await asyncio.to_thread(examine, self._url, None)
                self._findings = {
                    "findings": [
                        {"part": one.part, "address": one.address, "state": one.state, "advice": one.advice}
                        for one in found
                    ]
                }
                self._findings_due = time.time_ns() + FINDINGS_NANOS
        return _json(self._findings)

    async def _answer_picture(self, request: Request) -> Response:
        found = self._previews.pictures.get(request.path_params["key"])
        if found is None:
            raise HTTPException(404, "The server does not keep this picture any more; ask for its item again.")
        return Response(found[1], media_type=found[0])


async def _index(request: Request) -> Response:
    return FileResponse(STATIC / "index.html")


async def _failed(request: Request, error: Exception) -> Response:
    message = error.message if isinstance(error, StampedeError) else str(error)
    return _json({"failure": message}, 503)


def _json(value: Any, status: int = 200) -> Response:
    return Response(json.dumps(value, allow_nan=False).encode(), status, media_type="application/json")


def _names(request: Request) -> list[str]:
    names = request.query_params.getlist("channel")
    if not 1 <= len(names) <= TRACKS_MAX:
        raise HTTPException(400, f"name 1 to {TRACKS_MAX} channels, not {len(names)}")
    return [parse_name(name) for name in names]


def _instant(request: Request, key: str) -> int:
    text = request.query_params.get(key, "")
    if not text.isascii() or not text.lstrip("-").isdigit() or len(text) > 20:
        raise HTTPException(400, f"`{key}` is not a number of nanoseconds")
    return min(max(int(text), MIN_INSTANT), MAX_INSTANT)


def _whole(request: Request, key: str, most: int) -> int:
    text = request.query_params.get(key, "")
    if not text.isascii() or not text.isdigit() or not 1 <= int(text[:9]) <= most:
        raise HTTPException(400, f"`{key}` is not a number from 1 to {most}")
    return int(text)
