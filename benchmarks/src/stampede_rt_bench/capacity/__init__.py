"""Rates, latencies and memory of one host on this machine."""
