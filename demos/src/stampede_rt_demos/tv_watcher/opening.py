"""Opens the channels of the programme and connects to their hosts, so that the first item need not wait for
a connection.
"""

from __future__ import annotations

import stampede_rt as st
from stampede_rt_demos.tv_watcher.programme import StreamPlan


def open_channel(rt: st.Connection, stream: StreamPlan) -> st.Channel:
    """Connect to the host of the stream's channel, and return the channel.

    The orchestrator has created the channel before. Blocks until the connection is open. Raises ChannelNotFound if the
    channel does not exist, and Unavailable.
    """
    channel = rt.channel(stream.channel, create=False)
    channel.stats()
    return channel
