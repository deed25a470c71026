"""Moves of channels in the directory: pure."""
