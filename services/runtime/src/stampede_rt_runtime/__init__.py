"""Stampede RT: what all services share."""
