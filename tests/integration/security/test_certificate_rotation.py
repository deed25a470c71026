"""A running cluster gets new certificates, and a new authority, while it is used: no call fails."""

from __future__ import annotations

import socket
import ssl
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

import stampede_rt as st
from stampede_rt_local.certificates import ClusterCertificates
from stampede_rt_local.cluster import LocalCluster
from stampede_rt_runtime.certificates import describe
from stampede_rt_runtime.identity import Role
from tests.support.waiting import wait_until

PATIENCE_SECONDS = 20.0
PROGRESS_ITEMS = 50


class Load:
    """Puts, gets and a subscription on threads, and new connections. Keeps the failures."""

    def __init__(self, address: str, tls: st.TlsFiles) -> None:
        self._address = address
        self._tls = tls
        self._over = threading.Event()
        self.failures: list[str] = []
        self.counts = {"put": 0, "get": 0, "received": 0, "connect": 0, "directory": 0}

    @contextmanager
    def running(self) -> Iterator[None]:
        with st.connect(self._address, tls=self._tls) as rt:
            channel = rt.channel("rotation", max_items=100_000, max_age="1h")
            subscription = channel.subscribe()
            jobs: list[tuple[str, Callable[[], object]]] = [
                ("put", lambda: channel.put(b"x")),
                ("get", lambda: channel.newest()),
                ("directory", lambda: rt.channels("*")),
                ("connect", lambda: st.connect(self._address, tls=self._tls).close()),
            ]
            threads = [threading.Thread(target=self._repeat, args=job) for job in jobs]
            listener = threading.Thread(target=self._listen, args=(subscription,))
            for thread in (*threads, listener):
                thread.start()
            try:
                yield
            finally:
                self._over.set()
                for thread in threads:
                    thread.join()
                wait_until(lambda: self.counts["received"] >= self.counts["put"], "every put is received")
                subscription.close()
                listener.join()

    def _repeat(self, name: str, job: Callable[[], object]) -> None:
        while not self._over.wait(0.002):
            try:
                job()
            except st.StampedeError as error:
                self.failures.append(f"{name}: {error}")
                return
            self.counts[name] += 1

    def _listen(self, subscription: st.Subscription) -> None:
        for _ in subscription:
            self.counts["received"] += 1

    def wait_for_progress(self) -> None:
        """Wait until each kind of call has succeeded several times more."""
        goal = {name: count + (3 if name == "connect" else PROGRESS_ITEMS) for name, count in self.counts.items()}
        wait_until(
            lambda: bool(self.failures) or all(self.counts[name] >= goal[name] for name in goal),
            f"progress beyond {goal}",
        )
        assert self.failures == []


def presents(address: str, certificate: Path, caller: st.TlsFiles) -> bool:
    """Whether a service that is called now presents the certificate in that file."""
    host, _, port = address.rpartition(":")
    ca, own, key = caller.paths()
    context = ssl.create_default_context(cafile=ca)
    context.load_cert_chain(own, key)
    with socket.create_connection((host, int(port)), 5) as plain, context.wrap_socket(plain, server_hostname=host) as s:
        shown = s.getpeercert(binary_form=True)
    return shown is not None and ssl.DER_cert_to_PEM_cert(shown).strip() == certificate.read_text().strip()


def accepts(address: str, caller: st.TlsFiles) -> bool:
    """Whether a service that is called now accepts the caller's certificate."""
    host, _, port = address.rpartition(":")
    ca, own, key = caller.paths()
    context = ssl.create_default_context(cafile=ca)
    context.load_cert_chain(own, key)
    context.set_alpn_protocols(["h2"])
    with socket.create_connection((host, int(port)), 5) as plain, context.wrap_socket(plain, server_hostname=host) as s:
        s.settimeout(5)
        try:
            return s.recv(1) != b""
        except ConnectionError:
            return False


@pytest.fixture
def cluster() -> Iterator[LocalCluster]:
    with LocalCluster(tls=True, hosts=1, supernodes=3) as made:
        yield made


def files_of(certificates: ClusterCertificates, cluster: LocalCluster) -> dict[str, Path]:
    """Address -> the certificate that the service at this address should present."""
    return {
        process.address: Path(process.arguments[process.arguments.index("--tls-certificate") + 1])
        for process in cluster.processes()
    }


def copied(files: st.TlsFiles, folder: Path) -> st.TlsFiles:
    """The same certificates under names that no rotation touches."""
    folder.mkdir()
    ca, certificate, key = (folder / path.name for path in files.paths())
    for before, after in zip(files.paths(), (ca, certificate, key), strict=True):
        after.write_bytes(before.read_bytes())
        after.chmod(0o600)
    return st.TlsFiles(ca=ca, certificate=certificate, key=key)


def test_certificates_and_authority_are_replaced_under_load_without_a_failed_call(
    cluster: LocalCluster, tmp_path: Path
) -> None:
    certificates = cluster.certificates
    assert certificates is not None
    caller = certificates.issue(Role.CLIENT, "load")
    former = copied(caller, tmp_path / "former")
    services = files_of(certificates, cluster)
    load = Load(cluster.address, caller)
    with load.running():
        load.wait_for_progress()
        certificates.add_authority()  # the services trust both authorities from here on
        newcomer = copied(certificates.issue(Role.CLIENT, "newcomer"), tmp_path / "newcomer")
        for address in services:
            wait_until(lambda address=address: accepts(address, newcomer), f"{address} trusts the new authority")
        load.wait_for_progress()
        certificates.renew()
        for address, file in services.items():
            wait_until(
                lambda address=address, file=file: presents(address, file, newcomer),
                f"{address} presents its new certificate",
            )
        load.wait_for_progress()
        certificates.forget_former()
        (only,) = describe(certificates.ca.read_bytes())
        assert only.is_authority
        late = st.TlsFiles(ca=certificates.ca, certificate=former.certificate, key=former.key)
        for address in services:
            wait_until(
                lambda address=address: not accepts(address, late),
                f"{address} refuses the former certificate",
            )
        load.wait_for_progress()
        cluster.supernodes[0].restart()  # the other services know only the new authority by now
        load.wait_for_progress()
    assert load.failures == []
    with pytest.raises(st.PermissionDenied, match="is not of an authority in"):
        st.connect(cluster.address, tls=late)
