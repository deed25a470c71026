"""Multicast: the items of a channel as UDP datagrams, for many readers in one network (paper, section 4.1).

The host sends each item once, to a multicast group. Readers put the datagrams together, find gaps by seq, and ask the
host for the missing items. `encryption` needs the extra `stampede-rt[multicast]`.
"""
