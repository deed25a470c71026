"""Peers in the directory: their names, mailboxes and leases. Pure."""
