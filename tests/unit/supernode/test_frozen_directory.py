"""A frozen directory stands still while the one it was made from goes on."""

from __future__ import annotations

from stampede_rt_supernode.codecs.snapshot_codec import encode_snapshot
from stampede_rt_supernode.core.frozen_directory import frozen
from tests.unit.supernode.deeds import (
    Log,
    deregister,
    deregister_peer,
    open_channel,
    open_queue,
    register,
    register_peer,
)


def test_what_happens_afterwards_is_not_in_it() -> None:
    log = Log()
    for number in (1, 2):
        log.apply(register(number))
    for name in ("b", "a", "c"):
        log.apply(open_channel(name, host="host-1", max_items=5))
        log.apply(open_queue(name, host="host-1"))
    for number in (7, 8):
        log.apply(register_peer(number, f"peer-{number}"))
    before = encode_snapshot(log.directory)
    still = frozen(log.directory)
    for name in ("0", "aa", "z"):
        log.apply(open_channel(name, host="host-2", max_items=5))
        log.apply(open_queue(name, host="host-2", max_items=5))
    log.apply(deregister_peer(7))
    log.apply(register_peer(9, "peer-7"))
    log.apply(deregister(2))
    log.apply(register(3))
    assert encode_snapshot(still) == before != encode_snapshot(log.directory)
