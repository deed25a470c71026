"""What a supernode answers over gRPC: check, ask or command the directory, encode."""
