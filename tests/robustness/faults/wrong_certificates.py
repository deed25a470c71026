"""Certificates that are renewed during use, and callers with wrong certificates, in a cluster with certificates."""

from __future__ import annotations

import asyncio
import shutil
import socket
import ssl
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from stampede_rt.security.tls import TlsFiles
from stampede_rt_runtime.identity import Role
from tests.robustness.faults.malformed_traffic import tls_context
from tests.robustness.faults.scene import RECOVERY_SECONDS_MAX, Fault, Scene
from tests.robustness.real_cluster.certificates import Certificates
from tests.robustness.real_cluster.placed_process import FaultHadNoEffect, PlacedProcess

SEEN_SECONDS = 15.0
KIND_REFUSED = "callers with a foreign, an expired and no certificate"


async def rotate(scene: Scene) -> None:
    """Let a new authority take over: issue every certificate again, and then distrust the former authority."""
    certificates = _certificates(scene)
    victims = scene.cluster.processes()
    began = time.monotonic()
    with tempfile.TemporaryDirectory(dir=scene.folder) as folder:
        former = _copied(certificates.files(Role.CLIENT, "stranger"), Path(folder))
        await _rotated(certificates, victims, former)
    recovery = await scene.recovery(time.monotonic())
    evidence = f"all {len(victims)} services show new certificates and refuse a caller with a former one"
    kind = "rotation of all certificates and of the authority"
    scene.ended(kind, began, recovery, limit_s=RECOVERY_SECONDS_MAX, evidence=evidence)


async def _rotated(certificates: Certificates, victims: list[PlacedProcess], former: TlsFiles) -> None:
    """Perform the steps of `rotate`.

    After each step wait until every service uses its new files. Raises FaultHadNoEffect.
    """
    certificates.add_authority()
    newcomer = certificates.files(Role.CLIENT, f"newcomer-{time.monotonic_ns()}")
    await _each(victims, lambda one: accepts(one, newcomer), "trusts the new authority")
    certificates.renew()
    await _each(victims, lambda one: _shows_own(one, newcomer), "shows its new certificate")
    certificates.forget_former()
    late = TlsFiles(ca=certificates.ca, certificate=former.certificate, key=former.key)
    await _each(victims, lambda one: not accepts(one, late), "refuses a certificate of the former authority")


async def wrong_certificates(scene: Scene) -> None:
    """Check that every port refuses callers with wrong certificates, and accepts a caller with the right
    certificate.
    """
    certificates = _certificates(scene)
    began = time.monotonic()
    right = certificates.files(Role.CLIENT, "stranger")
    refused = 0
    with tempfile.TemporaryDirectory(dir=scene.folder) as folder:
        wrong = {
            "foreign": certificates.foreign(Role.CLIENT, "stranger", Path(folder, "foreign")),
            "expired": certificates.expired(Role.CLIENT, "stranger"),
            "no": None,
        }
        for one in scene.cluster.processes():
            if not await asyncio.to_thread(accepts, one, right):
                raise FaultHadNoEffect(f"{one.name} refuses the right certificate, so other refusals prove nothing")
            for kind, files in wrong.items():
                if await asyncio.to_thread(accepts, one, files, certificates.ca):
                    raise AssertionError(f"{one.name} lets in a caller with {kind} certificate")
                refused += 1
    recovery = await scene.recovery(began)
    evidence = (
        f"{refused} of {refused} callers were refused, "
        "and the caller with the right certificate was accepted everywhere"
    )
    scene.ended(KIND_REFUSED, began, recovery, limit_s=RECOVERY_SECONDS_MAX, evidence=evidence)


def _certificates(scene: Scene) -> Certificates:
    assert scene.cluster.certificates is not None, "this fault is for clusters with certificates"
    return scene.cluster.certificates


def _copied(files: TlsFiles, folder: Path) -> TlsFiles:
    """Copies of the files in another folder, where no rotation overwrites them."""
    ca, certificate, key = (shutil.copy(path, folder) for path in files.paths())
    return TlsFiles(ca=ca, certificate=certificate, key=key)


async def _each(victims: list[PlacedProcess], holds: Callable[[PlacedProcess], bool], what: str) -> None:
    """Wait until `holds` returns True for every service. Raises FaultHadNoEffect."""
    deadline = time.monotonic() + SEEN_SECONDS
    for one in victims:
        while not await asyncio.to_thread(holds, one):
            if time.monotonic() > deadline:
                raise FaultHadNoEffect(f"{SEEN_SECONDS} s after the change this is still not true: {one.name} {what}")
            await asyncio.sleep(0.1)


def accepts(one: PlacedProcess, files: TlsFiles | None, ca: Path | None = None) -> bool:
    """Whether a service accepts a new connection of this caller. `files` None: the caller has no certificate."""
    if files is not None:
        context = tls_context(files)
    else:
        context = ssl.create_default_context(cafile=str(ca))
        context.set_alpn_protocols(["h2"])
    try:
        with _connected(one, context) as connection:
            return connection.recv(1) != b""  # with TLS 1.3 a service refuses only after the handshake
    except (ssl.SSLError, ConnectionError):
        return False


def _shows_own(one: PlacedProcess, caller: TlsFiles) -> bool:
    assert one.tls is not None
    with _connected(one, tls_context(caller)) as connection:
        shown = connection.getpeercert(binary_form=True)
    own = one.tls.paths()[1].read_text().strip()
    return shown is not None and ssl.DER_cert_to_PEM_cert(shown).strip() == own


def _connected(one: PlacedProcess, context: ssl.SSLContext) -> ssl.SSLSocket:
    plain = socket.create_connection((one.namespace.address, one.port), timeout=5)
    try:
        return context.wrap_socket(plain, server_hostname=one.namespace.address)
    except BaseException:
        plain.close()
        raise


FAULTS: dict[str, Fault] = {"rotate": rotate, "wrong_certificates": wrong_certificates}
