"""Participants in the directory, their names and leases: pure."""
