"""Stampede RT: demonstrations on real media."""
