"""Opens the channels of the programme and connects to their hosts, so that the first item need not wait."""

from __future__ import annotations

import stampede_rt as st
from stampede_rt_demos.tv_watcher.programme import StreamPlan


def open_channel(rt: st.Connection, stream: StreamPlan) -> st.Channel:
    """Return the stream's channel, which the orchestrator has made, after a connection to its host.

    Blocks until the connection is open. Raises ChannelNotFound, Unavailable.
    """
    channel = rt.channel(stream.channel, create=False)
    channel.stats()
    return channel
