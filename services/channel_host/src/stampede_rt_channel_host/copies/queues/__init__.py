"""Replicas and moves of queues."""
