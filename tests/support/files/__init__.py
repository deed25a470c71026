"""Recordings and files of other programs, for tests."""
