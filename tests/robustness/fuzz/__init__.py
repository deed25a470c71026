"""Calls of every kind over a network that breaks, cancelled and timed out at random. Finds hangs, losses and leaks."""
