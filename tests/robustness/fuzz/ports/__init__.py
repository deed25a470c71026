"""All RPCs of a real host, supernode and front-end, called with messages that no client of the product sends."""
