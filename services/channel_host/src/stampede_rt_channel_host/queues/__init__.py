"""The shell of queues and mailboxes: enqueue and take streams, leases by the host's clock, dead letters."""
