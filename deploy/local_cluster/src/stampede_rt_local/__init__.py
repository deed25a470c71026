"""Stampede RT: the whole system on one machine."""
