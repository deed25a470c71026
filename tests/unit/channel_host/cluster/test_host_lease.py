"""The host's lease arithmetic: the host must stop before the directory can have given its channels away."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from stampede_rt_channel_host.cluster.host_lease import HostLease

TTL = 5_000


def granted(sent: int) -> HostLease:
    keeper = HostLease()
    keeper.granted(sent_nanos=sent, ttl_nanos=TTL)
    return keeper


def test_a_host_holds_no_lease_before_the_first_grant() -> None:
    keeper = HostLease()
    assert not keeper.is_held(0)
    assert keeper.renewal_in_nanos(123) == 0
    assert keeper.fenced_in_nanos(123) == 0


def test_a_host_fences_itself_at_four_fifths_of_the_ttl_after_it_sent() -> None:
    keeper = granted(1_000)
    assert keeper.is_held(4_999)
    assert not keeper.is_held(5_000)
    assert keeper.fenced_in_nanos(2_000) == 3_000
    assert keeper.fenced_in_nanos(9_000) == 0


def test_a_lease_is_renewed_three_times_per_ttl() -> None:
    keeper = granted(0)
    assert keeper.renewal_in_nanos(0) == TTL // 3
    assert keeper.renewal_in_nanos(TTL) == 0


def test_a_late_answer_to_an_earlier_renewal_does_not_shorten_the_lease() -> None:
    keeper = granted(2_000)
    keeper.granted(sent_nanos=1_000, ttl_nanos=TTL)
    assert keeper.is_held(5_999)


def test_a_lease_given_up_is_held_again_only_after_a_grant() -> None:
    keeper = granted(0)
    keeper.give_up()
    assert not keeper.is_held(1)
    keeper.granted(sent_nanos=10, ttl_nanos=TTL)
    assert keeper.is_held(11)


@given(
    st.lists(
        st.tuples(st.integers(0, 10_000), st.integers(0, 10_000), st.integers(0, 10_000)), min_size=1, max_size=20
    ),
    st.integers(0, 60_000),
)
def test_the_host_never_holds_a_lease_that_the_directory_may_have_ended(
    steps: list[tuple[int, int, int]], probe: int
) -> None:
    """The directory gets each renewal after some delay, and the host the ack after another delay. Acks may overtake
    each other.
    """
    keeper, clock, acks, received_last = HostLease(), 0, [], 0
    for pause, there, back in steps:
        clock += pause
        received_last = max(received_last, clock + there)
        acks.append((clock + there + back, clock))
    for at, sent in sorted(acks):
        if at <= probe:
            keeper.granted(sent_nanos=sent, ttl_nanos=TTL)
    if keeper.is_held(probe):
        assert probe < received_last + TTL
