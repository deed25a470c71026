"""When to try again, when something periodic is due, and how far a host may send ahead. Pure."""
