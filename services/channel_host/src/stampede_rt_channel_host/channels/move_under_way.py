"""The state of a move, at the source and at the destination: changes of the channel wait until the move is decided."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Protocol

from stampede_rt.errors import Overloaded, StampedeError
from stampede_rt_channel_host.core.channel import Pieces

HELD_SECONDS_MAX = 5.0  # the longest wait of a change; then its caller tries again


class HeldPuts(Protocol):
    """The puts of a channel, see `ChannelPuts`."""

    def hold(self) -> None:
        """Let all puts wait."""

    def release(self) -> None:
        """Accept puts again."""

    def ending(self, error: StampedeError) -> Pieces[None]:
        """Refuse the puts that wait now."""


class MoveUnderWay:
    """A move under way. `redirect_error`: the error that sends callers to the new owner, as soon as there is one."""

    def __init__(self, name: str, puts: HeldPuts, begin: Callable[[Pieces[None]], None]) -> None:
        """`name` is the channel's name. `begin` does work in pieces."""
        self._name = name
        self._puts = puts
        self._begin = begin
        self._timer: asyncio.TimerHandle | None = None
        self.redirect_error: StampedeError | None = None
        self.is_held = False
        self._over = asyncio.Event()

    def hold(self) -> None:
        """Let all changes of the channel wait, each for HELD_SECONDS_MAX at most."""
        self.is_held = True
        self._puts.hold()
        self._wait()

    def _wait(self) -> None:
        self._timer = asyncio.get_running_loop().call_later(HELD_SECONDS_MAX, self._refuse)

    def _refuse(self) -> None:
        """Refuse the puts that wait now. The next call refuses the puts that come later."""
        self._begin(self._puts.ending(held_too_long(self._name)))
        self._wait()

    def stop(self) -> None:
        """Stop refusing puts, because this host drops or replaces the channel, or the move is over. Idempotent.

        Other calls that wait continue. They look for the channel again.
        """
        if self._timer is not None:
            self._timer.cancel()
        self._over.set()

    def end(self) -> None:
        """End the move, because this host owns the channel now: perform the waiting calls."""
        self.stop()
        self._puts.release()

    def redirect(self, redirect_error: StampedeError) -> None:
        """Send the waiting calls to another host, which owns the channel now."""
        self.redirect_error = redirect_error
        self.stop()

    async def decided(self) -> None:
        """Wait until changes of the channel need not wait. Raises Overloaded after HELD_SECONDS_MAX."""
        if not self.is_held:
            return
        try:
            async with asyncio.timeout(HELD_SECONDS_MAX):
                await self._over.wait()
        except TimeoutError:
            raise held_too_long(self._name) from None


def held_too_long(name: str) -> StampedeError:
    """The error for a change that has waited too long for the end of a move."""
    return Overloaded(
        f"channel {name} is moving to another host, and the move takes longer than {HELD_SECONDS_MAX:g} s; try again",
        metadata={"channel": name},
    )
