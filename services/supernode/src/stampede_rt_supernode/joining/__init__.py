"""Founds clusters, lets supernodes join them, reads their data folders at each start, and probes the other members."""
