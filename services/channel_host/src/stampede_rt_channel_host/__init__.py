"""Stampede RT: the service that stores channels (paper, section 4.1)."""
