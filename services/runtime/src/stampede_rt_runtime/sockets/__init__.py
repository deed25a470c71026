"""Streams over sockets of their own, beside the gRPC server (`socket_stream.proto`, decision 0157)."""
