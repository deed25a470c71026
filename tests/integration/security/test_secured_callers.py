"""The callers that a cluster with certificates admits and refuses, and their errors."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

import stampede_rt as st
from stampede_rt import aio
from stampede_rt.errors import PermissionDenied
from stampede_rt_local.certificates import ClusterCertificates
from stampede_rt_local.cluster import LocalCluster
from stampede_rt_runtime.identity import Role
from tests.support.cluster import secured_cluster_fixture

DAY = timedelta(days=1)

cluster = secured_cluster_fixture(hosts=0, supernodes=1)


@pytest.fixture(scope="module")
def secret_cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LocalCluster]:
    place = tmp_path_factory.mktemp("secret") / "secret"
    with LocalCluster(tls=True, hosts=0, supernodes=1, durable=False, secret_file=place) as made:
        yield made


@pytest.fixture
def certificates(cluster: LocalCluster) -> ClusterCertificates:
    assert cluster.certificates is not None
    return cluster.certificates


@pytest.fixture
def foreign(tmp_path: Path) -> ClusterCertificates:
    return ClusterCertificates(tmp_path / "foreign")


def connect_blocking(address: str, tls: st.TlsFiles | None) -> None:
    st.connect(address, tls=tls).close()


def connect_awaited(address: str, tls: st.TlsFiles | None) -> None:
    async def enter() -> None:
        async with aio.connect(address, tls=tls):
            pass

    asyncio.run(enter())


Connect = Callable[[str, st.TlsFiles | None], None]
both_surfaces = pytest.mark.parametrize("connect", [connect_blocking, connect_awaited])


def refusal(connect: Connect, address: str, tls: st.TlsFiles | None) -> str:
    with pytest.raises(PermissionDenied) as caught:
        connect(address, tls)
    assert "\n" not in caught.value.message
    return caught.value.message


@both_surfaces
def test_a_certificate_of_the_cluster_is_enough(connect: Connect, cluster: LocalCluster) -> None:
    connect(cluster.address, cluster.tls_files())


@both_surfaces
def test_the_error_of_a_caller_without_a_certificate_says_that_it_needs_one(
    connect: Connect, cluster: LocalCluster
) -> None:
    error = refusal(connect, cluster.address, None)
    assert error.startswith(f"{cluster.address} asks for certificates (TLS), and this caller has none; name yours with")


@both_surfaces
def test_an_expired_certificate_is_refused(
    connect: Connect, cluster: LocalCluster, certificates: ClusterCertificates
) -> None:
    late = certificates.issue(Role.CLIENT, "late", begins=datetime.now(UTC) - 2 * DAY, lifetime=DAY)
    assert refusal(connect, cluster.address, late) == (
        f"{cluster.address} refused this caller: the certificate {late.certificate} has expired; "
        "issue it anew (stampede certs issue)"
    )


@both_surfaces
def test_a_caller_of_another_authority_does_not_trust_the_cluster(
    connect: Connect, cluster: LocalCluster, foreign: ClusterCertificates
) -> None:
    error = refusal(connect, cluster.address, foreign.issue(Role.CLIENT, "cam"))
    assert error.startswith(
        f"the certificate of {cluster.address} is of an authority that {foreign.ca} does not contain"
    )


@both_surfaces
def test_a_foreign_certificate_is_refused_also_with_the_right_authority_file(
    connect: Connect, cluster: LocalCluster, certificates: ClusterCertificates, foreign: ClusterCertificates
) -> None:
    stranger = foreign.issue(Role.CLIENT, "cam")
    mixed = st.TlsFiles(ca=certificates.ca, certificate=stranger.certificate, key=stranger.key)
    error = refusal(connect, cluster.address, mixed)
    assert f"refused this caller: the certificate {stranger.certificate} is not of an authority in" in error


@both_surfaces
def test_a_certificate_that_only_the_caller_trusts_is_refused(
    connect: Connect,
    cluster: LocalCluster,
    certificates: ClusterCertificates,
    foreign: ClusterCertificates,
    tmp_path: Path,
) -> None:
    stranger = foreign.issue(Role.CLIENT, "cam")
    bundle = tmp_path / "both.pem"
    bundle.write_bytes(certificates.ca.read_bytes() + foreign.ca.read_bytes())
    mixed = st.TlsFiles(ca=bundle, certificate=stranger.certificate, key=stranger.key)
    assert refusal(connect, cluster.address, mixed) == (
        f"{cluster.address} refused the certificate {stranger.certificate}: "
        "no authority that issued it is trusted there; use a certificate of that cluster"
    )


@both_surfaces
def test_a_cluster_can_require_both_a_certificate_and_the_secret(
    connect: Connect, secret_cluster: LocalCluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("STAMPEDE_SECRET_FILE", str(secret_cluster.secret_file))
    connect(secret_cluster.address, secret_cluster.tls_files())
    assert "asks for certificates (TLS)" in refusal(connect, secret_cluster.address, None)
    wrong = tmp_path / "wrong"
    wrong.write_text("another one")
    wrong.chmod(0o600)
    monkeypatch.setenv("STAMPEDE_SECRET_FILE", str(wrong))
    error = refusal(connect, secret_cluster.address, secret_cluster.tls_files())
    assert error.startswith("the call brought a secret that differs from the service's; ")
