"""Stampede RT: the front-end, at which clients start (paper, section 4)."""
