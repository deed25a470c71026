"""The state of a host, as pure state machines: values and `now` in, values out.

`channel` holds items by time (paper, sections 3.1, 3.2 and 3.4), `group` cuts and matches, `queue` messages. All of
them use `host_clock`, `judging` and `dedup`.
"""
