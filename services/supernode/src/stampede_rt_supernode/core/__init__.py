"""The directory as a pure state machine: records, commands, transitions, queries and leases."""
