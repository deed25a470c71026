"""Stampede RT and what users would pick instead, each with its real server and its own Python client."""
