"""All RPCs of a real host, supernode and front-end, called with what no client of ours would send."""
