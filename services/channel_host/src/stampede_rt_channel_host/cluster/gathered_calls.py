"""Joins the calls that many callers make at the same time into few calls to the directory."""

from __future__ import annotations

import asyncio
import logging
from asyncio import sleep
from collections import deque
from collections.abc import Awaitable, Callable, Sequence
from typing import Generic, TypeVar

from stampede_rt.errors import StampedeError, Unavailable

Request = TypeVar("Request")
Answer = TypeVar("Answer")

logger = logging.getLogger(__name__)

LONG_CALL_PARTS = 4
LONG_CALL_INTERVAL_S_MAX = 0.025
"""After a long call the directory has much to do, so the next call waits for more requests. The time between the
beginnings of the two calls is LONG_CALL_PARTS times the duration of the first call, but at most
LONG_CALL_INTERVAL_S_MAX.
"""


class GatheredCalls(Generic[Request, Answer]):
    """Requests that come while a call is under way go together into the next call. So a lone request never waits.

    `ask` makes a call for up to `requests_max` requests. It returns an answer or an error for each, in their order.
    """

    def __init__(
        self,
        ask: Callable[[Sequence[Request]], Awaitable[Sequence[Answer | StampedeError]]],
        requests_max: int,
        interval_s: float = 0.0,
    ) -> None:
        """`interval_s`: the least time between the beginnings of two calls; 0: no call waits.

        After a long call the time is longer. Requests that come earlier wait, and go together into the next call.
        """
        self._ask = ask
        self._requests_max = requests_max
        self._interval_s = interval_s
        self._not_before_s = 0.0
        self._waiting: deque[tuple[Request, asyncio.Future[Answer]]] = deque()
        self._calls: asyncio.Task[None] | None = None

    async def ask(self, request: Request) -> Answer:
        """The answer. Raises the error of this request, or of the call."""
        answer: asyncio.Future[Answer] = asyncio.get_running_loop().create_future()
        self._waiting.append((request, answer))
        if self._calls is None:
            self._calls = asyncio.create_task(self._call_each(), name="gathered calls")
        return await answer

    async def _call_each(self) -> None:
        """Make calls while requests wait."""
        try:
            while self._waiting:
                await self._pause()
                lookups = [self._waiting.popleft() for _ in range(min(self._requests_max, len(self._waiting)))]
                # The caller of a done request was cancelled.
                if lookups := [one for one in lookups if not one[1].done()]:
                    _deal([answer for _, answer in lookups], await self._answers([request for request, _ in lookups]))
        finally:
            self._calls = None

    async def _pause(self) -> None:
        """Wait until the time of the next call, unless enough requests for a whole call wait already."""
        wait_s = self._not_before_s - asyncio.get_running_loop().time()
        if wait_s > 0 and len(self._waiting) < self._requests_max:
            await sleep(wait_s)
        self._not_before_s = asyncio.get_running_loop().time() + self._interval_s

    async def _timed(self, requests: Sequence[Request]) -> Sequence[Answer | StampedeError]:
        begun_s = asyncio.get_running_loop().time()
        try:
            return await self._ask(requests)
        finally:
            if self._interval_s:
                took_s = asyncio.get_running_loop().time() - begun_s
                distance_s = min(LONG_CALL_PARTS * took_s, LONG_CALL_INTERVAL_S_MAX)
                self._not_before_s = max(self._not_before_s, begun_s + distance_s)

    async def _answers(self, requests: Sequence[Request]) -> Sequence[Answer | StampedeError]:
        try:
            return await self._timed(requests)
        except StampedeError as error:
            return [error] * len(requests)
        except Exception as error:
            logger.exception(
                "a call for several moves failed", extra={"event": "task_defect", "task": "gathered calls"}
            )
            # The directory may have performed the call. So this is an error after which the caller may repeat the call.
            return [Unavailable(f"the host failed ({error!r}); please report it")] * len(requests)


def _deal(waiting: Sequence[asyncio.Future[Answer]], answers: Sequence[Answer | StampedeError]) -> None:
    for one, answer in zip(waiting, answers, strict=True):
        if one.done():
            continue
        if isinstance(answer, StampedeError):
            one.set_exception(answer)
        else:
            one.set_result(answer)
