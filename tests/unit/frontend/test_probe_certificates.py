"""A front-end tells its callers if no supernode answers it because of certificates."""

from __future__ import annotations

import asyncio
from pathlib import Path

from stampede_rt_frontend.probe import Prober
from stampede_rt_frontend.roster import SupernodeRoster
from stampede_rt_local.certificates import ClusterCertificates
from stampede_rt_runtime.dial import Dialer
from stampede_rt_runtime.identity import Role
from stampede_rt_runtime.server import serving
from stampede_rt_runtime.tls import load_tls


async def why_it_failed(target: str, dialer: Dialer) -> str:
    roster = SupernodeRoster((target,))
    async with Prober(roster, dialer, explain=dialer.explain), asyncio.timeout(45):
        while not roster.failures():  # noqa: ASYNC110  (there is no event for it)
            await asyncio.sleep(0.01)
    return roster.failures()[0]


async def test_a_supernode_of_another_authority_is_named_with_the_reason(tmp_path: Path) -> None:
    ours, theirs = ClusterCertificates(tmp_path / "ours"), ClusterCertificates(tmp_path / "theirs")
    frontend = Dialer(secret=None, tls=load_tls(ours.issue(Role.FRONTEND, "f1"), Role.FRONTEND))
    supernode = load_tls(theirs.issue(Role.SUPERNODE, "s1"), Role.SUPERNODE)
    async with serving(lambda _: None, tls=supernode) as server:
        reason = await why_it_failed(server.address, frontend)
        assert f"the certificate of {server.address} is of an authority that {ours.ca} does not contain" in reason
        reason = await why_it_failed(server.address, Dialer(secret=None))
        assert f"{server.address} asks for certificates (TLS), and this caller has none" in reason
