"""The limits of channels and queues together: memory, and the shares of each caller."""
