"""Serves the channels of a host: puts, gets, subscriptions, rings in shared memory, and limits of memory."""
