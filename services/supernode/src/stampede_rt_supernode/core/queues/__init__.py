"""Queues and mailboxes in the directory: pure."""
