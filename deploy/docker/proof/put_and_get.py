"""Puts three items and gets them, like a user outside the containers: `put_and_get.py [CHANNEL]`."""

import sys

import stampede_rt as st

with st.connect("localhost:7580") as rt:
    left = rt.channel(sys.argv[1] if len(sys.argv) > 1 else "cam/left", max_age="1m")
    for word in (b"one", b"two", b"three"):
        left.put(word)
    newest = left.newest()
    print("newest:", newest and newest.payload)
    print("last 30 s:", [item.payload for item in left.get(*st.last("30s"))])
