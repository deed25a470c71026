"""The state of a move, at the source and at the destination: changes of the channel wait until the move is decided."""

from __future__ import annotations

import asyncio
from typing import Protocol

from stampede_rt.errors import Overloaded, StampedeError

HELD_SECONDS_MAX = 5.0  # the longest wait of a change; then its caller tries again


class HeldPuts(Protocol):
    """The puts of a channel, see `ChannelPuts`."""

    def hold(self) -> None:
        """Let all puts wait."""

    def release(self) -> None:
        """Accept puts again."""


class Moving:
    """A move under way. `elsewhere`: the error that sends callers to the new owner, once there is one."""

    def __init__(self, puts: HeldPuts) -> None:
        self._puts = puts
        self.elsewhere: StampedeError | None = None
        self.is_held = False
        self._over = asyncio.Event()

    def hold(self) -> None:
        """Let all changes of the channel wait."""
        self.is_held = True
        self._puts.hold()

    def end(self) -> None:
        """End the move, because this host owns the channel now: perform the waiting calls."""
        self._over.set()
        self._puts.release()

    def gone(self, elsewhere: StampedeError) -> None:
        """Send the waiting calls to another host, which owns the channel now."""
        self.elsewhere = elsewhere
        self._over.set()

    async def decided(self, name: str) -> None:
        """Wait until changes of the channel need not wait. Raises Overloaded after HELD_SECONDS_MAX."""
        if not self.is_held:
            return
        try:
            async with asyncio.timeout(HELD_SECONDS_MAX):
                await self._over.wait()
        except TimeoutError:
            raise held_too_long(name) from None


def held_too_long(name: str) -> StampedeError:
    """The error for a change that has waited too long for the end of a move."""
    return Overloaded(
        f"channel {name} is moving to another host, which takes longer than {HELD_SECONDS_MAX:g} s; try again",
        metadata={"channel": name},
    )
