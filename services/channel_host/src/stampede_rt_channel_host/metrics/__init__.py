"""The metrics of a channel host."""
