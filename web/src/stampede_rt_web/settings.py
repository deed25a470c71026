"""The settings of `stampede web`."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from stampede_rt_runtime.service_settings import log_format_field, log_level_field
from stampede_rt_runtime.settings import setting
from stampede_rt_runtime.values import parse_address_text


@dataclass(frozen=True, kw_only=True)
class WebSettings:
    """Serves a page that shows the streams of a cluster on one time line. The page only reads."""

    listen: str = field(
        default="localhost:7581",
        metadata=setting(
            metavar="HOST:PORT", parse=parse_address_text, help="the address of the page; port 0: any free one"
        ),
    )
    url: str = field(
        default="",
        metadata=setting(metavar="HOST:PORT", help="the front-ends of the cluster; default: localhost:7580"),
    )
    secret_file: Path | None = field(
        default=None,
        metadata=setting(
            metavar="FILE",
            help="the file of the cluster's secret; default: the page looks for the secret where all clients do",
        ),
    )
    channels: str = field(
        default="*", metadata=setting(metavar="GLOB", shared=False, help="the channels that the page lists")
    )
    token_file: Path | None = field(
        default=None,
        metadata=setting(
            metavar="FILE",
            shared=False,
            help="the file of the login token, made if absent; needed on addresses beyond loopback",
        ),
    )
    tls_certificate: Path | None = field(
        default=None,
        metadata=setting(
            metavar="FILE", shared=False, help="the page's certificate (PEM); needed on addresses beyond loopback"
        ),
    )
    tls_key: Path | None = field(
        default=None, metadata=setting(metavar="FILE", shared=False, help="the private key (PEM) of the certificate")
    )

    log_level: str = log_level_field()
    log_format: str = log_format_field()

    def __post_init__(self) -> None:
        if (self.tls_certificate is None) != (self.tls_key is None):
            raise ValueError("--tls-certificate and --tls-key belong together; give both or none")

    @property
    def may_listen_anywhere(self) -> bool:
        """Whether other machines may see the page: it has TLS and a login."""
        return self.token_file is not None and self.tls_certificate is not None
