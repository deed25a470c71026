"""A ring in shared memory: the newest runs of a channel, which readers of the same machine read without a call. Pure.

A host writes the ring (`stampede_rt_channel_host.core.ring_writer`), and readers map it. This package has the layout
and the reader's side.
"""
