"""A supernode logs once that it cannot talk to another member because of certificates."""

from __future__ import annotations

import logging
from dataclasses import replace
from pathlib import Path

import pytest

from stampede_rt_local.certificates import ClusterCertificates
from stampede_rt_runtime.dial import Dialer
from stampede_rt_runtime.identity import Role
from stampede_rt_runtime.server import serving
from stampede_rt_runtime.tls import load_tls
from stampede_rt_supernode.joining.probe import Probe, ProbeResult
from stampede_rt_supernode.replica import DirectoryReplica
from tests.support.supernode.memory_log import OTHER, MemoryLog


async def test_a_member_of_another_authority_is_logged_once_with_the_reason(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    ours, theirs = ClusterCertificates(tmp_path / "ours"), ClusterCertificates(tmp_path / "theirs")
    dialer = Dialer(secret=None, tls=load_tls(ours.issue(Role.SUPERNODE, "s1"), Role.SUPERNODE))
    other = load_tls(theirs.issue(Role.SUPERNODE, "s2"), Role.SUPERNODE)
    async with serving(lambda _: None, tls=other) as server:
        log = MemoryLog(DirectoryReplica())
        log.other = replace(OTHER, address=server.address)
        probe = Probe(log, dialer, explain=dialer.explain)
        with caplog.at_level(logging.WARNING):
            await probe.round()
            await probe.round()
        await probe._close_channels([server.address])
    assert probe.finding("s2") == ProbeResult(False, None)
    (message,) = [record.getMessage() for record in caplog.records if "member s2" in record.getMessage()]
    assert message.startswith("no certificates in common with member s2: the certificate of localhost:")
