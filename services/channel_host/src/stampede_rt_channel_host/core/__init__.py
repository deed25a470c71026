"""The state of a host, as pure state machines: values and `now` in, values out.

`channel` holds items by time (paper, sections 3.1, 3.2 and 3.4), `group` computes cuts and matches, and
`queue` holds messages. Every `now` comes from `host_clock`. `dedup` recognises repeated puts of channels and queues.
`run_outcome` holds the outcome of a put.
"""
