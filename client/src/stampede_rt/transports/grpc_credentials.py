"""Certificates in the form that gRPC takes.

Client and server both show a certificate. A server's certificate must name the server's address.
"""

from __future__ import annotations

import grpc

from stampede_rt.security.tls import TlsMaterial


def channel_credentials(tls: TlsMaterial) -> grpc.ChannelCredentials:
    """Return the credentials for one new connection. gRPC keeps them as long as the connection lives."""
    return grpc.ssl_channel_credentials(
        root_certificates=tls.ca, private_key=tls.key, certificate_chain=tls.certificate
    )
