"""Bytes at every port that are not calls of the product: random bytes, pickles, HTTP/1, half TLS hellos, giant frames
and messages.
"""

from __future__ import annotations

import asyncio
import contextlib
import pickle
import socket
import ssl
import subprocess
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import grpc

from stampede_rt.security.tls import TlsFiles
from stampede_rt.v1 import (
    channel_service_pb2,
    directory_service_pb2,
    frontend_service_pb2,
    gatekeeper_service_pb2,
    membership_service_pb2,
    raft_service_pb2,
)
from stampede_rt_runtime.identity import Role
from tests.robustness.faults.scene import RECOVERY_SECONDS_MAX, Fault, Scene
from tests.robustness.real_cluster.placed_process import FaultHadNoEffect, PlacedProcess

PREFACE = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n"
SETTINGS = bytes((0, 0, 0, 4, 0, 0, 0, 0, 0))
HTTP1 = b"GET / HTTP/1.1\r\nHost: stampede\r\nContent-Length: 1000000000\r\n\r\n" + b"a" * 4096
RANDOM_PAYLOADS, RANDOM_BYTES = 8, 3000
HALF_HELLOS = 40
GIANT_MESSAGE_BYTES = 64 * 2**20
FRAME_BYTES_MAX = 2**24 - 1
MEMORY_BYTES_MAX = 96 * 2**20  # the limit of one message is 20 MiB, and several may be under way
SERVICES = (
    channel_service_pb2,
    directory_service_pb2,
    frontend_service_pb2,
    gatekeeper_service_pb2,
    membership_service_pb2,
    raft_service_pb2,
)


class _Trap:
    """A pickle of this object makes a file when a program loads the pickle."""

    def __init__(self, canary: Path) -> None:
        self._canary = canary

    def __reduce__(self) -> tuple[object, tuple[list[str]]]:
        return subprocess.check_call, (["touch", str(self._canary)],)


async def malformed_traffic(scene: Scene) -> None:
    """Send malformed bytes of every kind to every port, without TLS and, if there are certificates, also with TLS."""
    began = time.monotonic()
    canary = scene.folder / "canary"
    trap = pickle.dumps(_Trap(canary))
    insider = scene.cluster.caller_files(Role.SUPERNODE, scene.cluster.supernodes[0].name)
    payloads = [trap, HTTP1, *(scene.rng.randbytes(RANDOM_BYTES) for _ in range(RANDOM_PAYLOADS))]
    payloads += [PREFACE + payload for payload in payloads] + [giant_frame(), giant_headers()]
    victims = scene.cluster.processes()
    before = {one.name: _memory_from_now(one) for one in victims}
    refused = 0
    for one in victims:
        with half_hellos(one):
            refused += await asyncio.to_thread(_send_all, one, payloads, insider)
            for payload in (trap, scene.rng.randbytes(2000), b"\0" * GIANT_MESSAGE_BYTES):
                refused += await _send_as_messages(one, payload, insider)
    recovery = await scene.recovery(began)
    _check_unharmed(victims, canary)
    grown = {one.name: one.memory_peak_bytes() - before[one.name] for one in victims}
    worst = max(grown, key=lambda name: grown[name])
    if grown[worst] > MEMORY_BYTES_MAX:
        raise AssertionError(f"{worst} grew by {grown[worst] / 2**20:.0f} MiB for malformed traffic")
    evidence = f"{refused} connections and calls were refused at {len(victims)} ports"
    note = f"the memory of {worst} grew the most, by {grown[worst] / 2**20:.0f} MiB"
    kind = "malformed traffic at every port: random bytes, pickles, HTTP/1, half TLS hellos, giant frames"
    scene.ended(kind, began, recovery, limit_s=RECOVERY_SECONDS_MAX, evidence=evidence, note=note)


def _memory_from_now(one: PlacedProcess) -> int:
    one.forget_memory_peak()
    return one.memory_peak_bytes()


def _check_unharmed(victims: Sequence[PlacedProcess], canary: Path) -> None:
    """Check that the services still run and unpickled nothing. Raises AssertionError."""
    if canary.exists():
        raise AssertionError("a pickle that came from the network was loaded")
    for one in victims:
        if not one.running:
            raise AssertionError(f"{one.name} ended because of bytes from the network: {one.last_log_line()!r}")


def giant_frame() -> bytes:
    """An HTTP/2 DATA frame whose header states the greatest possible length. Only the first 4 MiB follow."""
    header = FRAME_BYTES_MAX.to_bytes(3, "big") + bytes((0, 0)) + (1).to_bytes(4, "big")
    return PREFACE + SETTINGS + header + b"\0" * (4 * 2**20)


def giant_headers() -> bytes:
    """Frames that open a stream whose headers do not end: 4 MiB of CONTINUATION frames."""

    def frame(kind: int, payload: bytes) -> bytes:
        return len(payload).to_bytes(3, "big") + bytes((kind, 0)) + (1).to_bytes(4, "big") + payload

    return PREFACE + SETTINGS + frame(1, b"\x82\x86") + b"".join(frame(9, b"\0" * 16384) for _ in range(256))


@contextlib.contextmanager
def half_hellos(one: PlacedProcess) -> Iterator[None]:
    """Keep connections open that sent half of a TLS hello. Raises OSError if the service accepts no connection."""
    outgoing = ssl.MemoryBIO()
    hello = ssl.create_default_context().wrap_bio(ssl.MemoryBIO(), outgoing, server_hostname="stampede")
    with contextlib.suppress(ssl.SSLWantReadError):
        hello.do_handshake()
    half = outgoing.read()[:100]
    with contextlib.ExitStack() as stack:
        for _ in range(HALF_HELLOS):
            address = (one.namespace.address, one.port)
            connection = stack.enter_context(socket.create_connection(address, timeout=5))
            connection.sendall(half)
        yield


def _send_all(one: PlacedProcess, payloads: Sequence[bytes], insider: TlsFiles | None) -> int:
    """Send each payload over a connection.

    Returns how many connections the service ended. Raises FaultHadNoEffect if it ended none.
    """
    contexts: list[ssl.SSLContext | None] = [None] if insider is None else [None, tls_context(insider)]
    ended = sum(_send(one, payload, context) for payload in payloads for context in contexts)
    if not ended:
        raise FaultHadNoEffect(f"{one.name} ended none of {len(payloads)} connections with malformed bytes")
    return ended


def tls_context(files: TlsFiles) -> ssl.SSLContext:
    """The TLS context of a caller with these files."""
    ca, certificate, key = map(str, files.paths())
    context = ssl.create_default_context(cafile=ca)
    context.load_cert_chain(certificate, key)
    context.set_alpn_protocols(["h2"])
    return context


def _send(one: PlacedProcess, payload: bytes, context: ssl.SSLContext | None) -> bool:
    """Whether the service ended the connection soon."""
    plain = socket.create_connection((one.namespace.address, one.port), timeout=5)
    try:
        with plain, _wrapped(plain, one, context) as connection:
            connection.settimeout(0.2)
            connection.sendall(payload)
            while connection.recv(65536):
                pass
    except TimeoutError:
        return False  # the service waits for the rest, and leaves the end to the caller
    except OSError:
        return True
    return True


def _wrapped(plain: socket.socket, one: PlacedProcess, context: ssl.SSLContext | None) -> socket.socket:
    return plain if context is None else context.wrap_socket(plain, server_hostname=one.namespace.address)


async def _send_as_messages(one: PlacedProcess, payload: bytes, insider: TlsFiles | None) -> int:
    """Send the payload as the message of every RPC. Returns how many calls were refused."""
    options = [("grpc.max_send_message_length", 2 * GIANT_MESSAGE_BYTES)]
    methods = [
        f"/{service.full_name}/{method.name}"
        for module in SERVICES
        for service in module.DESCRIPTOR.services_by_name.values()
        for method in service.methods
    ]
    if len(payload) == GIANT_MESSAGE_BYTES:
        methods = methods[:: len(methods) // 3]  # about three methods are enough for each port; more would take long
    async with _unlimited(one, insider, options) as channel:
        return sum([await _refused(channel, method, payload) for method in methods])


def _unlimited(one: PlacedProcess, insider: TlsFiles | None, options: Any) -> grpc.aio.Channel:
    """A connection that sends messages which the product's clients would not send."""
    if insider is None:
        return grpc.aio.insecure_channel(one.address, options=options)
    ca, certificate, key = (path.read_bytes() for path in insider.paths())
    return grpc.aio.secure_channel(one.address, grpc.ssl_channel_credentials(ca, key, certificate), options=options)


async def _refused(channel: Any, method: str, payload: bytes) -> bool:
    call = channel.stream_stream(method)(iter([payload]), timeout=0.3 if len(payload) < 2**20 else 5)
    try:
        async for _ in call:
            pass
    except grpc.aio.AioRpcError:
        return True  # every refusal counts; the caller checks the rest
    return False


FAULTS: dict[str, Fault] = {"malformed_traffic": malformed_traffic}
