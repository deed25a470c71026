"""Channel groups served over gRPC: reads, cut events, matches, and the exchange between hosts."""
