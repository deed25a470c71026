"""Makes the TLS contexts of the standard library from certificates, for streams over TCP. They allow only TLS 1.3.

Client and server both show a certificate. A server's certificate must name the server's address.
"""

from __future__ import annotations

import os
import ssl

from stampede_rt.security.tls import TlsMaterial


def client_context(material: TlsMaterial) -> ssl.SSLContext:
    """Return the context of the connections of a client. Linux only."""
    return _context(ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT), material)


def server_context(material: TlsMaterial) -> ssl.SSLContext:
    """Return the context of the connections of a service. Its callers must present a certificate. Linux only."""
    context = _context(ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER), material)
    context.verify_mode = ssl.CERT_REQUIRED
    context.num_tickets = 0  # each connection proves its certificate anew
    return context


def _context(context: ssl.SSLContext, material: TlsMaterial) -> ssl.SSLContext:
    context.minimum_version = ssl.TLSVersion.TLSv1_3
    context.load_verify_locations(cadata=material.ca.decode("ascii", "replace"))
    # the standard library reads a key only from a file; this file is in memory, so nobody changes it meanwhile
    file = os.memfd_create("stampede-tls", os.MFD_CLOEXEC)
    try:
        with open(file, "wb", closefd=False) as own:
            own.write(material.key + b"\n" + material.certificate)
        context.load_cert_chain(f"/proc/self/fd/{file}", password=lambda: "-")
    finally:
        os.close(file)
    return context
