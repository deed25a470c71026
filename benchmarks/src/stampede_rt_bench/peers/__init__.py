"""Stampede RT and other systems for the same task, each with its real server and its own Python client."""
