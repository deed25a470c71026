"""The addresses of a cluster, and the facts that a client keeps about it."""
