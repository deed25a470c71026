"""What the parts can do on this machine: bare grpcio, raw sockets, and a copy in memory."""
