"""Stampede RT: the code that all services share."""
