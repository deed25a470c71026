"""A host's place in a cluster: its identity, its registration and lease, and its calls to the directory."""
