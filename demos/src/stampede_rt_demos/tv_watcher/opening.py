"""Opens the programme's channels, so that the first item does not have to wait for the way to its host."""

from __future__ import annotations

import stampede_rt as st
from stampede_rt_demos.tv_watcher.programme import StreamPlan


def open_channel(rt: st.Connection, stream: StreamPlan) -> st.Channel:
    """The stream's channel, which the orchestrator has made; its host has been found and connected to on return.

    Blocks for as long as that takes. Raises ChannelNotFound, Unavailable.
    """
    channel = rt.channel(stream.channel, create=False)
    channel.stats()
    return channel
