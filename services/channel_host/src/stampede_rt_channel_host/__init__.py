"""Stampede RT: the service that stores channels and queues (paper, section 4.1)."""
