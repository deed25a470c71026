"""Hosts in the directory: pure."""
