"""The addresses of a cluster, and what a client remembers of it."""
