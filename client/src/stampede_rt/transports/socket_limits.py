"""The limits of the client's streams over sockets. They are the same for asyncio and threads."""

from __future__ import annotations

from stampede_rt.transports.grpc_options import MESSAGE_BYTES_MAX
from stampede_rt.wire.stream_frames import STATUS_BYTES_MAX, FrameKind

SILENCE_S_MAX = 7.5  # hosts send something every 2.5 s
CONNECT_S_MAX = 1.0
RETRY_PAUSE_S = 30.0  # after a failure to connect, streams go over gRPC for this time
# The bytes of one read; the client reads the rest of a longer message directly into the message's buffer.
RECEIVE_BYTES = 2**16
KEPT_BUFFER_BYTES_MAX = 2**21  # for a full message and one more item; a stream keeps this much memory
UNREAD_BYTES_MAX = 2**18  # the messages that the program has not read have at most this size; the host keeps the others
JOINED_BYTES_MAX = 2**16  # up to this length a copy of a message takes less time than a second system call
RECEIVED_BYTES_MAX = {FrameKind.MESSAGE: MESSAGE_BYTES_MAX, FrameKind.STATUS: STATUS_BYTES_MAX, FrameKind.ALIVE: 0}
