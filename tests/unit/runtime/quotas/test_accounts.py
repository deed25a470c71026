"""The use of a port by its callers, and the refusals of calls beyond their quotas."""

from __future__ import annotations

import pytest

from stampede_rt.errors import Overloaded
from stampede_rt_runtime.quotas.accounts import RECENT_MAX, Account, Accounts
from stampede_rt_runtime.quotas.limits import DEFAULTS, LIMIT_MAX, Quota, QuotaSetting, QuotaTable


def account(**limits: int) -> Account:
    return Account("cam-1", {**DEFAULTS, **{Quota(name.replace("_", "-")): limit for name, limit in limits.items()}})


def used(one: Account) -> dict[Quota, int]:
    return {use.quota: use.used for use in one.uses() if use.used}


def test_a_caller_can_use_exactly_its_limit() -> None:
    one = account(streams=2)
    for _ in range(2):
        one.check(Quota.STREAMS)
        one.take([Quota.STREAMS])
    with pytest.raises(Overloaded):
        one.check(Quota.STREAMS)
    one.give_back([Quota.STREAMS])
    one.check(Quota.STREAMS)


def test_a_refusal_names_the_quota_the_use_the_limit_and_a_remedy() -> None:
    one = account(bytes_in_flight=10)
    one.charge_for(Quota.BYTES_IN_FLIGHT).set(7)
    with pytest.raises(Overloaded) as caught:
        one.check(Quota.BYTES_IN_FLIGHT, 4)
    assert caught.value.message == (
        "cam-1 has 7 bytes in flight at this port and wants 4 more; its quota bytes-in-flight is 10; put and read less "
        "at a time, or have an operator raise the quota (stampede quota set cam-1 bytes-in-flight=LIMIT)"
    )
    assert caught.value.metadata == {"quota": "bytes-in-flight", "subject": "cam-1", "used": "7", "limit": "10"}


def test_held_amounts_are_summed_and_a_sum_of_zero_is_deleted() -> None:
    one = account(bytes_in_flight=10)
    first, second = one.charge_for(Quota.BYTES_IN_FLIGHT), one.charge_for(Quota.BYTES_IN_FLIGHT)
    first.set(4)
    second.set(5)
    first.set(3)
    assert one.has_room(Quota.BYTES_IN_FLIGHT, 2)
    assert not one.has_room(Quota.BYTES_IN_FLIGHT, 3)
    first.set(0)
    second.set(0)
    assert used(one) == {}


def test_a_refused_waiting_call_uses_up_nothing() -> None:
    one = account(waiting_calls=1, bytes_in_flight=5)
    with pytest.raises(Overloaded), one.waiting(6):
        raise AssertionError("the call must not wait")
    assert used(one) == {}
    with one.waiting(5), pytest.raises(Overloaded), one.waiting(0):
        raise AssertionError("the call must not wait")
    assert used(one) == {}


def test_a_changed_setting_applies_to_present_callers() -> None:
    accounts = Accounts()
    one = accounts.of("cam-1")
    one.take([Quota.STREAMS])
    accounts.set_table(QuotaTable([QuotaSetting("cam-*", Quota.STREAMS, 1)]))
    with pytest.raises(Overloaded):
        one.check(Quota.STREAMS)
    accounts.set_table(QuotaTable())
    one.check(Quota.STREAMS)


def test_a_default_of_this_process_stays_when_settings_change() -> None:
    accounts = Accounts()
    accounts.set_default(Quota.STREAMS, 1)
    accounts.set_table(QuotaTable([QuotaSetting("other", Quota.STREAMS, 5)]))
    accounts.of("cam").take([Quota.STREAMS])
    assert not accounts.of("cam").has_room(Quota.STREAMS)


def test_quotas_do_not_apply_to_parts_of_the_cluster() -> None:
    accounts = Accounts()
    accounts.set_table(QuotaTable([QuotaSetting("*", quota, 0) for quota in Quota]))
    for quota in Quota:
        accounts.of(None).check(quota)


def test_only_idle_callers_lose_their_accounts_if_there_are_very_many_callers() -> None:
    accounts = Accounts()
    busy = accounts.of("busy")
    held = accounts.of("holding").charge_for(Quota.BYTES_HELD)
    for number in range(3 * RECENT_MAX):
        accounts.of(f"passer-{number}")
    held.set(1)
    assert len(accounts) == RECENT_MAX + 2
    assert accounts.of("busy") is busy
    assert used(accounts.of("holding")) == {Quota.BYTES_HELD: 1}


def test_the_limit_of_changes_per_second_applies_to_the_average_of_ten_seconds() -> None:
    now_s = 100.0
    accounts = Accounts({**DEFAULTS, Quota.CHANGES_PER_SECOND: 2}, lambda: now_s)
    one = accounts.of("cam")
    for _ in range(20):
        one.change()
    with pytest.raises(
        Overloaded, match="cam has 2 changes of the directory a second; its quota changes-per-second is 2"
    ):
        one.change()
    assert used(one) == {Quota.CHANGES_PER_SECOND: 2}
    now_s += 1.0
    one.change()
    one.change()
    with pytest.raises(Overloaded):
        one.change()
    now_s += 10.0
    assert used(one) == {}


def test_callers_without_a_name_have_no_limit_unless_one_is_set() -> None:
    accounts = Accounts()
    accounts.set_default(Quota.BYTES_HELD, 100)
    limits = {name: accounts.of(name).limit(Quota.BYTES_HELD) for name in ("cam", "@clients", "@cluster", "@anyone")}
    assert limits == {"cam": 100, "@clients": LIMIT_MAX, "@cluster": LIMIT_MAX, "@anyone": LIMIT_MAX}
    accounts.set_table(QuotaTable([QuotaSetting("@clients", Quota.BYTES_HELD, 7)]))
    assert accounts.of("@clients").limit(Quota.BYTES_HELD) == 7


def test_a_port_counts_its_refusals_and_keeps_the_time_of_the_last_one() -> None:
    now_s = 5.0
    accounts = Accounts({**DEFAULTS, Quota.STREAMS: 0}, lambda: now_s)
    assert (accounts.refusals, accounts.refused_ago_nanos()) == (0, None)
    for name in ("cam", "other"):
        with pytest.raises(Overloaded):
            accounts.of(name).check(Quota.STREAMS)
    now_s += 2.0
    assert (accounts.refusals, accounts.refused_ago_nanos()) == (2, 2 * 10**9)


def test_accounts_report_the_usage_and_the_refusals_of_each_caller() -> None:
    accounts = Accounts()
    one = accounts.of("cam")
    _idle = accounts.of("idle")
    one.take([Quota.STREAMS])
    one.exceeded(Quota.WAITING_CALLS, 1)
    found = [(use.subject, use.quota, use.used, use.refused) for use in accounts.uses()]
    assert found == [("cam", Quota.STREAMS, 1, 0), ("cam", Quota.WAITING_CALLS, 0, 1)]


def test_the_report_of_an_account_includes_the_counts_of_the_directory() -> None:
    accounts, made = Accounts(), [("cam", Quota.CHANNELS, 7), ("other", Quota.QUEUES, 2)]
    accounts.draw_from(lambda: made)
    accounts.of("cam").take([Quota.STREAMS])
    assert [(use.subject, use.quota, use.used) for use in accounts.uses()] == [
        ("cam", Quota.STREAMS, 1), ("cam", Quota.CHANNELS, 7), ("other", Quota.QUEUES, 2),
    ]  # fmt: skip
    made.pop()
    made[0] = ("cam", Quota.CHANNELS, 6)
    assert [(use.quota, use.used) for use in accounts.uses()][-1] == (Quota.CHANNELS, 6)


def test_refusals_of_the_directory_count_for_their_caller() -> None:
    accounts = Accounts()
    accounts.count_refusal(Overloaded("full", metadata={"quota": "channels", "subject": "cam"}))
    accounts.count_refusal(Overloaded("the directory is full"))
    assert [(use.subject, use.quota, use.refused) for use in accounts.uses()] == [("cam", Quota.CHANNELS, 1)]
    assert accounts.refusals == 1
