"""The limits of this machine: gRPC without our code, raw sockets, and a copy in memory."""
