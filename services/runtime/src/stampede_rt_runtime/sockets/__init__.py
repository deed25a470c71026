"""Streams over sockets of their own, in addition to the gRPC server (`socket_stream.proto`, decision 0157)."""
