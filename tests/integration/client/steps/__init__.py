"""Steps of iterators that callers cancel, and functions that exit."""
