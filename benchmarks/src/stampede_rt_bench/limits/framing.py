"""The frames of the bare servers, over gRPC and over sockets: requests of 8 bytes, acknowledgements, and payloads."""

from __future__ import annotations

import struct

REQUEST = struct.Struct("<II")  # the number of items in the answer, and the bytes of each item
ACK = bytes(24)
LENGTH = struct.Struct("<I")
QUEUE_MESSAGES_MAX = 8
ONE_READER = "a limit has one reader"
