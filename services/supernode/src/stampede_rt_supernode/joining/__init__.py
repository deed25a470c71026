"""How supernodes found a cluster, prepare, join, leave and volunteer."""
