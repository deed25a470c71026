"""The puts into channels: their streams, large requests in pieces, retries, and acks."""
