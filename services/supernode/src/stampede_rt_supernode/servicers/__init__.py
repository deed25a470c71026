"""The gRPC services of a supernode: check, ask or command the directory, encode."""
