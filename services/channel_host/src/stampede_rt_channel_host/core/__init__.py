"""The state of a host, as pure state machines: values and `now` in, values out.

`channel` holds items by time (paper, sections 3.1, 3.2 and 3.4). `host_clock`, `judging` and `dedup`
serve every kind.
"""
