"""Stampede RT: the supernode, which holds one copy of the directory (paper, section 4.3)."""
