"""Certificates as gRPC takes them. Both sides must prove themselves; the server's address must be in its own."""

from __future__ import annotations

import grpc

from stampede_rt.security.tls import TlsMaterial


def channel_credentials(tls: TlsMaterial) -> grpc.ChannelCredentials:
    """For one new connection; gRPC keeps them for as long as that lives."""
    return grpc.ssl_channel_credentials(
        root_certificates=tls.ca, private_key=tls.key, certificate_chain=tls.certificate
    )
