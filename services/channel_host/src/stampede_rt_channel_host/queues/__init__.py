"""Queues and mailboxes served over gRPC: enqueue and take streams, leases by the host's clock, dead letters."""
