"""The TLS of one connection, without its socket. The owner moves the encrypted bytes.

Both clients and the host's port use this module. Python's `SSLSocket` lets no thread send while another one reads.
asyncio's own TLS keeps buffers of several 100 KiB for each connection, and limits no handshakes.
"""

from __future__ import annotations

import ssl
import threading
from collections.abc import Iterable, Sequence

_CERTIFICATE = "x509_pem_cert"
_URIS = "peer_uri"


class TlsLayer:
    """Encrypts and decrypts. One thread may call `encrypt` while another one calls `feed` and `read`."""

    def __init__(self, context: ssl.SSLContext, *, server_name: str | None = None) -> None:
        """`server_name`: the name or address that the server's certificate must have; None: this is the server."""
        self._incoming, self._outgoing = ssl.MemoryBIO(), ssl.MemoryBIO()
        self._tls = context.wrap_bio(
            self._incoming, self._outgoing, server_side=server_name is None, server_hostname=server_name
        )
        self._mutex = threading.Lock()

    def continue_handshake(self) -> bool:
        """Take a step of the handshake. Then send `to_send`. Returns whether this side is done. Raises ssl.SSLError."""
        try:
            self._tls.do_handshake()
        except ssl.SSLWantReadError:
            return False
        return True

    def to_send(self) -> bytes:
        """Return the encrypted bytes of the handshake that the peer must get, also after an error."""
        return self._outgoing.read()

    def feed(self, received: bytes | memoryview) -> None:
        """Take encrypted bytes of the peer. Then call `read` until it returns 0."""
        with self._mutex:
            self._incoming.write(received)

    def read(self, place: memoryview) -> int:
        """Write the next bytes of the peer to `place`. Returns their number; 0: the layer needs more bytes.

        Raises ssl.SSLError, also if the peer has ended its TLS.
        """
        with self._mutex:
            if not self._has_more:
                return 0
            try:
                return int(self._tls.read(len(place), place))  # type: ignore[arg-type, unused-ignore]  # see ssl.SSLObject
            except ssl.SSLWantReadError:
                return 0

    @property
    def has_more(self) -> bool:
        """Whether `read` may return bytes without another `feed`."""
        with self._mutex:
            return self._has_more

    @property
    def _has_more(self) -> bool:
        return bool(self._tls.pending() or self._incoming.pending)

    def encrypt(self, parts: Iterable[bytes | memoryview]) -> bytes:
        """Return the encrypted bytes for the peer. They must be sent in the order of the calls. Raises ssl.SSLError."""
        with self._mutex:
            for part in parts:
                left = memoryview(part)
                while left:
                    left = left[self._tls.write(left) :]  # type: ignore[arg-type, unused-ignore]
            return self._outgoing.read()

    def peer_certificate(self) -> dict[str, Sequence[bytes]]:
        """Return the peer's certificate, with the keys of gRPC's `auth_context`, after the handshake."""
        raw = self._tls.getpeercert(binary_form=True)
        if raw is None:
            return {}
        names = (self._tls.getpeercert() or {}).get("subjectAltName", ())
        uris = [str(name[1]).encode() for name in names if name[0] == "URI"]  # type: ignore[union-attr, unused-ignore]
        return {_CERTIFICATE: (ssl.DER_cert_to_PEM_cert(raw).encode(),), _URIS: tuple(uris)}
