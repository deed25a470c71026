"""Groups in the directory: pure."""
