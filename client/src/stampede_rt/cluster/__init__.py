"""Where a cluster is, and what a client remembers of it."""
