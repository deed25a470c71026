"""When to try again, when periodic work is due, and how far a host may send ahead. Pure."""
