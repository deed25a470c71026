"""A whole cluster on this machine: front-ends, supernodes and hosts as real processes, for `stampede dev` and tests."""

from __future__ import annotations

import shutil
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from stampede_rt.security.tls import TlsFiles
from stampede_rt_local.certificates import ClusterCertificates
from stampede_rt_local.kept_directory import members_in
from stampede_rt_local.namespaces import NetworkNamespace
from stampede_rt_local.ports import free_ports
from stampede_rt_local.process import ServiceFailed, ServiceProcess
from stampede_rt_runtime.archive_places import default_folder
from stampede_rt_runtime.auth import Secret, make_secret_file
from stampede_rt_runtime.identity import Role
from stampede_rt_runtime.values import Address, parse_address

_TITLES = {Role.SUPERNODE: "supernode", Role.FRONTEND: "front-end", Role.HOST: "host"}
READY_SECONDS = 40.0  # an idle machine needs 1 to 2 s, and a busy machine may need 10 s


class LocalCluster:
    """A cluster of processes. A context manager: all services are ready inside the block, and ended after it.

    `listen` is the first front-end's address. All other services take free ports of the same host. If `durable`,
    supernodes keep their log and hosts their identity in `folder`, and can be restarted. By default `folder` is a
    temporary one; it is None if no service needs it. By default the cluster makes `secret_file` in `folder`. With `tls`
    all ports ask for certificates (`certificates`, `tls_files`), and for the secret only if `secret_file` is given. The
    first hosts run in the namespaces `host_namespaces`, which must reach `listen`. Namespaces exclude `tls`, because
    the certificates are for one address. `metrics`: where the first supernode serves its metrics. The other supernodes,
    the front-ends and the hosts take the next ports in this order, or any free ports if this port is 0. The attribute
    `metrics` has the address of each service, by its title. `archive`: the folder in which each host has a folder for
    recorded channels, or the URL of an object store; then the folders are in `archive_folder`. `directory`: the folder
    in which the supernodes keep the directory over restarts, if not `durable`. `data_ports`: whether hosts serve TCP
    sockets. `feed_transport`: the transport of the feeds between hosts. `multicast`: the multicast group of the hosts.
    `on_line`, `on_exit`: see ServiceProcess.
    """

    def __init__(
        self,
        *,
        hosts: int = 2,
        supernodes: int = 3,
        frontends: int = 1,
        listen: str = "localhost:0",
        durable: bool = True,
        folder: Path | None = None,
        secret_file: Path | None = None,
        tls: bool = False,
        allow_insecure_anywhere: bool = False,
        host_namespaces: Sequence[NetworkNamespace] = (),
        log_level: str = "info",
        log_format: str = "text",
        reflection: bool = False,
        metrics: str = "",
        archive: Path | str | None = None,
        archive_folder: Path | None = None,
        directory: Path | None = None,
        data_ports: bool = False,
        feed_transport: str = "best",
        multicast: str = "",
        on_line: Callable[[ServiceProcess, str], None] | None = None,
        on_exit: Callable[[ServiceProcess], None] | None = None,
    ) -> None:
        _check(hosts, supernodes, frontends, has_namespaces=bool(host_namespaces), tls=tls)
        # A cluster in memory with the user's own secret writes no files. So even after SIGKILL no folder is left.
        self._temporary = folder is None and (durable or tls or secret_file is None)
        self.folder = Path(tempfile.mkdtemp(prefix="stampede-")) if self._temporary else folder
        self.secret: Secret = make_secret_file(secret_file or self._inside("secret"))
        self._listen, self._archive, self._data_ports = parse_address(listen), archive, data_ports
        self._archive_folder, self._feed_transport = archive_folder or default_folder(), feed_transport
        self._durable, self._host_namespaces, self._directory = durable, tuple(host_namespaces), directory
        self._on_line, self._on_exit, self._multicast = on_line, on_exit, multicast
        self.certificates = ClusterCertificates(self._inside("certs"), host=self._listen.host) if tls else None
        self._shared = ["--log-level", log_level, "--log-format", log_format, *(["--reflection"] if reflection else [])]
        self._shared += ["--secret-file", str(self.secret.path)] if secret_file is not None or not tls else []
        self._shared += ["--allow-insecure-anywhere"] if allow_insecure_anywhere else []
        self._metrics_place = parse_address(metrics) if metrics else None
        self.metrics: dict[str, str] = {}
        ports = free_ports(supernodes + frontends, self._listen.host, excluded=self._listen.port)
        self.supernodes = self._plan_supernodes(ports[:supernodes])
        self.frontends = self._plan_frontends(ports[supernodes:])
        self.hosts = [self._plan_host(number) for number in range(1, hosts + 1)]

    @property
    def address(self) -> str:
        """The address for clients: the front-ends, comma-separated."""
        return ",".join(self._frontend_addresses)

    @property
    def secret_file(self) -> Path:
        """The file of the secret, for clients (`$STAMPEDE_SECRET_FILE`)."""
        return self.secret.path

    def tls_files(self, name: str = "somebody", role: Role = Role.CLIENT) -> TlsFiles | None:
        """Return a new certificate for a caller; None without `tls`."""
        return self.certificates.issue(role, name) if self.certificates else None

    def processes(self) -> Iterator[ServiceProcess]:
        """Yield all processes, hosts first. In this order they can be stopped without errors in their logs."""
        yield from (*self.hosts, *self.frontends, *self.supernodes)

    def start(self, timeout: float = READY_SECONDS) -> None:
        """Start all services, and wait until they are ready. If one fails, ends all and raises ServiceFailed."""
        deadline = time.monotonic() + timeout
        try:
            for process in reversed(list(self.processes())):
                process.start()
            for process in self.processes():
                process.wait_ready(max(0.0, deadline - time.monotonic()), unless=self._has_lost_one)
        except BaseException as error:
            culprit = self._first_dead()
            self.stop()
            if isinstance(error, ServiceFailed) and culprit is not None:
                raise ServiceFailed(culprit.describe_end()) from error
            raise

    def stop(self) -> None:
        """Stop all services, hosts first, and remove the temporary folder. Takes a limited time. Idempotent."""
        for group in (self.hosts, self.frontends, self.supernodes):
            for process in group:
                process.ask_to_stop()
            for process in group:
                process.stop()
        if self._temporary and self.folder is not None:
            shutil.rmtree(self.folder, ignore_errors=True)

    def add_host(self, timeout: float = READY_SECONDS) -> ServiceProcess:
        """Start one more host and wait until it is ready."""
        host = self._plan_host(len(self.hosts) + 1)
        self.hosts.append(host)
        host.start()
        host.wait_ready(timeout)
        return host

    def __enter__(self) -> LocalCluster:
        self.start()
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.stop()

    def _inside(self, name: str) -> Path:
        assert self.folder is not None, "there is a folder whenever something is written"
        return self.folder / name

    def _data_dir(self, name: str) -> list[str]:
        return ["--data-dir", str(self._inside(name))] if self._durable else []

    def _first_dead(self) -> ServiceProcess | None:
        """Return the first dead service, supernodes first, because a dead supernode may be the reason why a host is not
        ready."""
        return next((one for one in reversed(list(self.processes())) if one.ended), None)

    def _has_lost_one(self) -> bool:
        return self._first_dead() is not None

    def _at(self, port: int) -> str:
        return str(Address(self._listen.host, port))

    def _process(
        self, role: Role, name: str, module: str, *arguments: str, namespace: NetworkNamespace | None = None
    ) -> ServiceProcess:
        title = f"{_TITLES[role]} {name}"
        words = [*arguments, *self._tls_arguments(role, name), *self._metrics_arguments(title), *self._shared]
        return ServiceProcess(title, module, words, on_line=self._on_line, on_exit=self._on_exit, namespace=namespace)

    def _metrics_arguments(self, title: str) -> list[str]:
        first = self._metrics_place
        if first is None:
            return []
        port = first.port + len(self.metrics) if first.port else free_ports(1, first.host)[0]
        self.metrics[title] = str(Address(first.host, port))
        return ["--metrics", self.metrics[title]]

    def _tls_arguments(self, role: Role, name: str) -> list[str]:
        if self.certificates is None:
            return []
        ca, certificate, key = self.certificates.issue(role, name).paths()
        return ["--tls-ca", str(ca), "--tls-certificate", str(certificate), "--tls-key", str(key)]

    def _plan_supernodes(self, ports: list[int]) -> list[ServiceProcess]:
        members = {f"s{number}": self._at(port) for number, port in enumerate(ports, start=1)}
        if self._directory is not None:
            members = members_in(self._directory, len(ports), self._listen.host)
        self._members = ",".join(f"{name}={address}" for name, address in members.items())
        self._supernode_addresses = ",".join(members.values())
        return [self._plan_supernode(name, address) for name, address in members.items()]

    def _plan_supernode(self, name: str, address: str) -> ServiceProcess:
        arguments = ["--listen", address, "--id", name, "--members", self._members]
        arguments += self._data_dir(name) if self._directory is None else ["--data-dir", str(self._directory / name)]
        return self._process(Role.SUPERNODE, name, "stampede_rt_supernode", *arguments)

    def _plan_frontends(self, ports: list[int]) -> list[ServiceProcess]:
        ports = [self._listen.port or ports[0], *ports[1:]]
        self._frontend_addresses = [self._at(port) for port in ports]
        return [
            self._process(
                Role.FRONTEND,
                str(number),
                "stampede_rt_frontend",
                *("--listen", address, "--supernodes", self._supernode_addresses),
            )
            for number, address in enumerate(self._frontend_addresses, start=1)
        ]

    def _plan_host(self, number: int) -> ServiceProcess:
        name = f"h{number}"
        namespace = self._host_namespaces[number - 1] if number <= len(self._host_namespaces) else None
        listen = self._at(0) if namespace is None else str(Address(namespace.address, 0))
        arguments = ["--listen", listen, "--name", name, "--frontend", self.address, *self._data_dir(name)]
        arguments += ["--feed-transport", self._feed_transport]
        arguments += ["--drain-seconds", "0"]  # all hosts end together, so no host can take over channels
        if self._data_ports:
            arguments += ["--data-port", "0"]
        if self._multicast:
            arguments += ["--multicast", self._multicast]
        if isinstance(self._archive, Path):
            arguments += ["--archive", str(self._archive / name)]
        elif self._archive is not None:
            arguments += ["--archive", self._archive, "--archive-folder", str(self._archive_folder / name)]
        return self._process(Role.HOST, name, "stampede_rt_channel_host", *arguments, namespace=namespace)


def _check(hosts: int, supernodes: int, frontends: int, *, has_namespaces: bool, tls: bool) -> None:
    if min(supernodes, frontends) < 1 or hosts < 0:
        raise ValueError("a cluster needs at least one supernode and one front-end, and no negative number of hosts")
    if tls and has_namespaces:
        raise ValueError("local certificates name one address, and host_namespaces have several; leave one out")
