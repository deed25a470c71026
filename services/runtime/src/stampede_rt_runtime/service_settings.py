"""The settings that all services share.

The help of a service comes only from its settings. Therefore no module of settings loads gRPC. The methods of this
module import it only when they run.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from stampede_rt_runtime.logs import FORMATS, LEVELS
from stampede_rt_runtime.settings import SettingsError, setting
from stampede_rt_runtime.values import Address, parse_address, parse_address_text

if TYPE_CHECKING:
    from stampede_rt_runtime.auth import Secret
    from stampede_rt_runtime.dial import Dialer
    from stampede_rt_runtime.identity import Role
    from stampede_rt_runtime.tls import ServiceTls


def log_level_field() -> str:
    """Return the field of a settings class for the least level of the log."""
    level: str = field(
        default="info", metadata=setting(metavar="LEVEL", choices=LEVELS, help="log messages of this level and above")
    )
    return level


def log_format_field() -> str:
    """Return the field of a settings class for the form of the log."""
    form: str = field(
        default="text",
        metadata=setting(
            metavar="FORMAT",
            choices=FORMATS,
            help="the form of the log: lines of key=value, or one JSON object in each line",
        ),
    )
    return form


@dataclass(frozen=True, kw_only=True)
class ServiceSettings:
    """The settings that all services share. Each service also has its own `listen`."""

    secret_file: Path | None = field(
        default=None,
        metadata=setting(
            metavar="FILE",
            help="the file of the shared secret; default: stampede/secret in the user's config folder, if it exists",
        ),
    )
    client_secret_file: Path | None = field(
        default=None,
        metadata=setting(
            metavar="FILE",
            help="the file of the clients' secret; a caller with this secret may make clients' calls, but not join",
        ),
    )
    allow_insecure_anywhere: bool = field(
        default=False,
        metadata=setting(
            help="listen beyond this machine without encryption, although the whole network can read the items"
        ),
    )
    tls_ca: Path | None = field(
        default=None,
        metadata=setting(
            metavar="FILE",
            shared=False,
            help="the certificates of the cluster's authorities (PEM); if set, every caller needs a certificate",
        ),
    )
    tls_certificate: Path | None = field(
        default=None, metadata=setting(metavar="FILE", shared=False, help="this service's own certificate (PEM)")
    )
    tls_key: Path | None = field(
        default=None,
        metadata=setting(
            metavar="FILE",
            shared=False,
            help="the private key (PEM) of the certificate; only this service's user may read it",
        ),
    )
    log_level: str = log_level_field()
    reflection: bool = field(
        default=False,
        metadata=setting(
            help="describe the services of this port to every caller with a credential, for tools such as grpcurl"
        ),
    )
    log_format: str = log_format_field()
    metrics: str = field(
        default="",
        metadata=setting(
            metavar="HOST:PORT",
            parse=parse_address_text,
            help="serve metrics for Prometheus at http://HOST:PORT/metrics; everybody who can reach this address can "
            "read them, so name a loopback address, such as localhost:9464, or one on a private network",
        ),
    )

    def metrics_address(self) -> Address | None:
        """The address for metrics; None: the service serves none."""
        return parse_address(self.metrics) if self.metrics else None

    def load_secret(self) -> Secret | None:
        """The secret, or None if there is none. Reads a file. Raises PermissionDenied.

        With certificates the secret is read only if a setting names its file, because certificates suffice.
        """
        from stampede_rt_runtime.auth import load_secret

        if self.tls_ca is not None and self.secret_file is None and "STAMPEDE_SECRET_FILE" not in os.environ:
            return None
        return load_secret(self.secret_file)

    def load_tls(self, role: Role) -> ServiceTls | None:
        """The certificates, or None if no setting names them. Reads files. Raises SettingsError or PermissionDenied."""
        named = {"--tls-ca": self.tls_ca, "--tls-certificate": self.tls_certificate, "--tls-key": self.tls_key}
        missing = [flag for flag, path in named.items() if path is None]
        if len(missing) == len(named):
            return None
        if self.tls_ca is None or self.tls_certificate is None or self.tls_key is None:
            raise SettingsError(f"{' and '.join(missing)} must be given, too: certificates need {', '.join(named)}")
        from stampede_rt.security.tls import TlsFiles
        from stampede_rt_runtime.tls import load_tls

        return load_tls(TlsFiles(ca=self.tls_ca, certificate=self.tls_certificate, key=self.tls_key), role)

    def load_credentials(self, role: Role) -> Dialer:
        """The secrets and certificates, as the service's server and its outgoing connections need them."""
        from stampede_rt_runtime.auth import load_client_secret
        from stampede_rt_runtime.dial import Dialer

        secret = self.load_secret()
        clients = load_client_secret(self.client_secret_file, secret)
        return Dialer(secret=secret, client_secret=clients, tls=self.load_tls(role))
