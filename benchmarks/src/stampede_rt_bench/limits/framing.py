"""What the bare servers understand, over gRPC or sockets: a request of 12 bytes, or payload that goes on to readers."""

from __future__ import annotations

import struct

REQUEST = struct.Struct("<II")  # items of the answer, bytes of each
ACK = bytes(24)
LENGTH = struct.Struct("<I")
QUEUE_MESSAGES_MAX = 8
ONE_READER = "a limit has one reader"
