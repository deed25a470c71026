"""Calls of every kind over a network that breaks, cancelled and timed out at random: what hangs, is lost or leaks."""
