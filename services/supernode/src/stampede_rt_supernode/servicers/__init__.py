"""The gRPC services of a supernode: they check requests, ask or command the directory, and encode responses."""
