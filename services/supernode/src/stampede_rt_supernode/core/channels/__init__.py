"""Channels in the directory: pure."""
