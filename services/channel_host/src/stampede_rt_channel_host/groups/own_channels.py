"""The channels of this host that are members of groups. The host enters each change of their times on the board."""

from __future__ import annotations

from collections.abc import Callable

from stampede_rt.errors import StampedeError
from stampede_rt_channel_host.channels.hosted_channels import HostedChannel
from stampede_rt_channel_host.core.group import OwnChannelTimes, TimesBoard


class OwnChannel:
    """Follows one channel as a `ChannelObserver`, and enters its times on the board.

    Calls `on_change` after every change of the channel, and `on_end` once, when the host no longer serves the channel.
    """

    def __init__(
        self,
        hosted: HostedChannel,
        board: TimesBoard,
        now: Callable[[], int],
        *,
        on_change: Callable[[bytes], None],
        on_end: Callable[[bytes], None],
    ) -> None:
        self.hosted = hosted
        self.channel_id: bytes = hosted.record.channel_id
        self._board = board
        self._now = now
        self._on_change = on_change
        self._on_end = on_end
        self._own = OwnChannelTimes(hosted.channel, now())
        self.enter_times()
        hosted.group_observers[self] = None

    def wake(self) -> None:
        """Enter the present times on the board after a change of the channel."""
        self._own.observe(self._now())
        self.enter_times()
        self._on_change(self.channel_id)

    def end(self, error: StampedeError) -> None:
        """Stop, because the host no longer serves the channel."""
        self.stop_following()
        self._on_end(self.channel_id)

    def stop_following(self) -> None:
        """Stop following the channel. Its last times stay on the board."""
        self.hosted.group_observers.pop(self, None)
        self._board.disown(self.channel_id, self._now())

    def enter_times(self) -> None:
        """Enter the channel's times on the board, under its present epoch."""
        self._board.enter_own(self.channel_id, self._own.times(self.hosted.epoch), self._own.silent_since)
