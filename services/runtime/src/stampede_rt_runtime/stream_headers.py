"""Sends the headers of a stream before its first message.

Otherwise gRPC sends the headers with the first message, and notes only at the end of this write that they are sent. If
the service ends the stream during the write, gRPC sends the headers again, with the status. This fails, and the caller
would wait for ever.
"""

from __future__ import annotations

import asyncio

from stampede_rt_runtime.rpc import Context

HEADERS_SECONDS_MAX = 2.0
"""The time in seconds that the end of a stream waits for its headers.

The headers wait only if the caller's system takes nothing at all.
"""


async def send_headers(context: Context) -> None:
    """Send the headers, and let a cancellation of the task wait until gRPC has noted that they are sent. Raises
    InternalError.

    Streams over sockets have no headers.
    """
    send = getattr(context, "send_initial_metadata", None)
    if send is None:
        return
    sending = asyncio.ensure_future(send(()))
    try:
        await asyncio.shield(sending)
    except asyncio.CancelledError:
        sending.add_done_callback(lambda sent: sent.cancelled() or sent.exception())  # the status fails, too
        await asyncio.wait({sending}, timeout=HEADERS_SECONDS_MAX)
        raise
