"""Replays a recording into the match of Stampede RT: the core of a host, with the clock of the recording."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from stampede_rt.values.model import Policy
from stampede_rt.wire.runs import encode_run, seal_run
from stampede_rt_bench.matching.recording import RATES_HZ, REFERENCE, Arrival
from stampede_rt_bench.matching.sets import FoundSet, Replay
from stampede_rt_channel_host.core.channel import ChannelCore, Offer
from stampede_rt_channel_host.core.group import OWN, FoundMatch, LocalTrack, Matcher, OwnChannelTimes

ITEMS_MAX = 1000


def replay(arrivals: Sequence[Arrival], tolerance_nanos: int) -> Replay:
    """Return the matches, with their times, for this recording."""
    start = arrivals[0].arrived
    policy = Policy(max_age_nanos=60_000_000_000, max_future_nanos=1_000_000_000)
    channels = {stream: ChannelCore(policy, incarnation=1, name=stream) for stream in RATES_HZ}
    times = {stream: OwnChannelTimes(channel, start) for stream, channel in channels.items()}
    tracks = {stream.encode(): LocalTrack(channel) for stream, channel in channels.items() if stream != REFERENCE}
    matcher = Matcher(channels[REFERENCE], tracks, tolerance_nanos, start)
    found: list[FoundSet] = []
    for arrival in arrivals:
        _put(channels[arrival.stream], arrival)
        times[arrival.stream].observe(arrival.arrived)
        found += [_found(one, arrival.arrived) for one in _take(matcher, times, arrival.arrived) if not one.missing]
    return Replay(sets=found, reported_unmatched=matcher.unmatched)


def _take(matcher: Matcher, times: Mapping[str, OwnChannelTimes], now: int) -> list[FoundMatch]:
    def has_passed(member: bytes, instant: int) -> bool:
        return times[REFERENCE if member == OWN else member.decode()].times(1).has_passed(instant)

    return matcher.take(has_passed, now, ITEMS_MAX)


def _found(matched: FoundMatch, given: int) -> FoundSet:
    times = {member.decode(): near.time for member, near in matched.matched.items()}
    return FoundSet(given=given, reference=matched.item.slice.first_time, times=times)


def _put(channel: ChannelCore, arrival: Arrival) -> None:
    raw = encode_run([b"."], times=[arrival.time])

    def seal(first_seq: int, kept: Sequence[int] | None, stamped_time: int | None) -> bytes:
        return seal_run(raw, first_seq)

    outcome = channel.put(Offer(times=[arrival.time], durations=None, lengths=[1]), arrival.arrived, seal)
    if outcome.run is None:
        raise AssertionError(f"the channel did not accept {arrival}: {outcome.rejections}")
