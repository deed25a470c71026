"""Foundation of a cluster, and preparation, join, removal and restart of its supernodes."""
