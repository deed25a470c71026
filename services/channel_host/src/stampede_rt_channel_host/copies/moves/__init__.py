"""Moves of channels to other hosts, and drains of hosts."""
