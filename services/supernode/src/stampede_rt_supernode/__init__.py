"""Stampede RT: one replica of the directory (paper, section 4.3)."""
