"""The cluster as a whole in the directory, its tenures and its time: pure."""
