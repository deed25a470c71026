"""Copies of channels in the directory: pure."""
