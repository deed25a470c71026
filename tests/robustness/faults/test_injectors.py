"""The injectors of faults have the effects that they claim, and the checks of these effects notice them."""

from __future__ import annotations

import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from stampede_rt_local.namespaces import unavailable_because
from stampede_rt_runtime.identity import Role
from stampede_rt_runtime.quotas.limits import Quota
from tests.benchmarks.attacks.catalogue import CASES
from tests.robustness.__main__ import write_page
from tests.robustness.faults import hostile_callers
from tests.robustness.faults.hostile_callers import FAULTS, MIB, QUOTAS, Puts
from tests.robustness.faults.malformed_traffic import giant_frame
from tests.robustness.real_cluster.certificates import Certificates
from tests.robustness.real_cluster.network import Network
from tests.robustness.real_cluster.relay import LinkConditions
from tests.robustness.report import TITLE
from tests.support.service_process import shift_wall_clock

WHY_NOT = unavailable_because()


@pytest.mark.skipif(WHY_NOT is not None, reason=WHY_NOT or "")
def test_a_blocked_link_is_blocked_in_one_direction_only() -> None:
    with Network(2) as network:
        first, second = network.namespaces
        both = {(first, second), (second, first)}
        assert network.open_directions(network.namespaces) == both
        network.block(first, second)
        assert network.open_directions(network.namespaces) == {(second, first)}
        network.unblock_all()
        assert network.open_directions(network.namespaces) == both
        network.set_link(first, up=False)
        assert network.open_directions(network.namespaces) == set()


def test_the_wall_clock_of_a_process_follows_its_file_and_no_other_clock_does(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    offset = tmp_path / "clock"
    offset.write_text("0")
    monkeypatch.setattr(time, "time_ns", lambda: 1_000)
    shift_wall_clock(offset)
    assert time.time_ns() == 1_000
    offset.write_text("-300".ljust(31))
    assert time.time_ns() == 700
    assert time.monotonic_ns() > 0


def test_a_relay_counts_the_effects_of_its_conditions() -> None:
    conditions = LinkConditions(delay_s=0.5, stall_share=1.0, cut_share=1.0)
    assert conditions.wait_s() >= 0.7
    assert conditions.cuts_now()
    chunks, stalled, waited_millis, cuts = (int(word) for word in conditions.counts().split())
    assert (chunks, stalled, cuts) == (1, 1, 1)
    assert waited_millis >= 700


def test_a_rotation_of_certificates_changes_every_file_and_trusts_both_authorities_in_between(tmp_path: Path) -> None:
    certificates = Certificates(tmp_path / "certificates")
    files = certificates.files(Role.SUPERNODE, "s1", "10.0.0.1")
    before = [path.read_bytes() for path in files.paths()]
    certificates.add_authority()
    assert files.paths()[0].read_bytes().startswith(before[0])
    certificates.renew()
    certificates.forget_former()
    after = [path.read_bytes() for path in files.paths()]
    assert not set(before) & set(after)


def test_a_giant_frame_names_the_greatest_length_that_http2_has() -> None:
    frame = giant_frame()
    header = frame[frame.index(b"SM\r\n\r\n") + 6 :][9:18]
    assert int.from_bytes(header[:3], "big") == 2**24 - 1


def test_the_report_of_a_new_run_replaces_the_former_report_on_a_page_and_keeps_the_text_above(tmp_path: Path) -> None:
    page = tmp_path / "out" / "robustness.md"
    write_page(page, f"{TITLE}1 minutes\n")
    assert page.read_text() == f"{TITLE}1 minutes\n"
    page.write_text(f"# Robustness\n\nHow.\n\n{TITLE}1 minutes\n\n## Summary\n")
    write_page(page, f"{TITLE}2 minutes\n")
    assert page.read_text() == f"# Robustness\n\nHow.\n\n{TITLE}2 minutes\n"


def test_the_campaign_of_hostile_clients_uses_up_each_quota() -> None:
    assert set(QUOTAS) == set(Quota)


def test_the_campaign_of_hostile_clients_makes_each_attack() -> None:
    # The clusters of these cases have no certificates.
    open_to_all = {name for name, case in CASES.items() if not case.secured}
    assert {f"attack_{name}" for name in open_to_all} == {name for name in FAULTS if name.startswith("attack_")}


class KeptItems:
    """A channel of which a host has lost an item: seq 2."""

    async def get(self, *_: object, **__: object) -> list[SimpleNamespace]:
        return [SimpleNamespace(seq=seq) for seq in (4, 3, 1)]


async def test_a_lost_item_of_a_good_client_beside_an_attack_is_noticed() -> None:
    puts = Puts(KeptItems(), acked={1, 3})
    await puts.check_kept()
    puts.acked.add(2)
    with pytest.raises(AssertionError, match="1 acknowledged items are lost, among them seq 2"):
        await puts.check_kept()


async def test_a_host_may_keep_the_bytes_of_its_channels_but_not_a_megabyte_for_each_of_60_streams(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(hostile_callers, "FREE_SECONDS_MAX", 0.0)
    calm, cached, held, leaked = 68 * MIB, 55 * MIB, 40 * MIB, 60 * MIB

    async def after(memory: int, rss_bytes: int | None) -> int:
        async def held_bytes() -> int | None:
            return rss_bytes

        watched: Any = SimpleNamespace(name="h1", memory_bytes=lambda: memory)
        return await hostile_callers.wait_until_memory_is_freed(watched, calm, "silent-gets", held_bytes)

    assert await after(calm + cached + held, held) == calm + cached + held
    with pytest.raises(TimeoutError, match="its channels and queues hold 40"):
        await after(calm + cached + held + leaked, held)
    assert await after(calm + 2 * leaked, None)  # a supernode has no channels
    with pytest.raises(TimeoutError):
        await after(calm + 3 * leaked, None)
