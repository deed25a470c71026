"""The cluster as a whole in the directory: its tenures, its time and its feature level. Pure."""
