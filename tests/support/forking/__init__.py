"""Starts services as forks of a process that has loaded their modules."""
