"""UDP multicast: the host sends the items of a channel once, for all readers of one network (paper, section 4.1)."""
