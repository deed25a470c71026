"""How the cost of a put and a get grows with channels, items, readers, groups and payloads."""
