"""Stampede RT: where clients start (paper, section 4)."""
