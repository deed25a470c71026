"""Channel groups served over gRPC: reads, cut events, matches, and what hosts tell each other."""
