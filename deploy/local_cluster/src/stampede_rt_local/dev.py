"""`stampede dev`: the whole system on this machine, in memory, with one command."""

from __future__ import annotations

import os
import queue
import re
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from stampede_rt.cli.interrupts import unwinding
from stampede_rt.errors import PermissionDenied
from stampede_rt.escaping import escaped
from stampede_rt.security.credentials import secret_file
from stampede_rt_local.cluster import LocalCluster
from stampede_rt_local.kept_directory import check_hosts
from stampede_rt_local.process import ServiceFailed, ServiceProcess
from stampede_rt_local.settings import DEFAULT_ADDRESS, PAGE_MODULE, DevSettings
from stampede_rt_runtime.listen import AddressNotAllowed, CannotListen, check_listen
from stampede_rt_runtime.settings import EXIT_BAD_SETTINGS, HelpRequested, SettingsError, load_settings

PAGE_SECONDS = 20.0  # for the start of the page
ABOUT_ARCHIVE = re.compile(r'\bevent(=|": ")archive_')  # in a line of a log, as text or as JSON


def main(argv: Sequence[str] | None = None) -> int:
    """Run `stampede dev` until Ctrl-C. Returns the exit code: 0 stopped, 1 a service failed, 2 bad settings."""
    began = time.monotonic()
    words = sys.argv[1:] if argv is None else argv
    try:
        settings = load_settings(DevSettings, service="dev", argv=words, environ=os.environ)
        check_listen(settings.listen, allow_insecure_anywhere=settings.allow_insecure_anywhere)
    except HelpRequested as help_request:
        print(help_request, end="")
        return 0
    except (SettingsError, AddressNotAllowed) as error:
        return _complain(error, EXIT_BAD_SETTINGS)
    except CannotListen as error:
        return _complain(error, 1)
    try:
        return _run(settings, began)
    except (ServiceFailed, PermissionDenied, OSError) as error:
        return _complain(error, 1)


def _complain(error: Exception, code: int) -> int:
    print(f"stampede dev: {_shown(str(error))}", file=sys.stderr)
    return code


def _shown(text: str) -> str:
    """The text with escaped control characters, except the ends of its lines."""
    return "\n".join(map(escaped, text.splitlines()))


def _run(settings: DevSettings, began: float) -> int:
    ended: queue.SimpleQueue[ServiceProcess] = queue.SimpleQueue()
    ready = threading.Event()

    def pass_on(process: ServiceProcess, line: str) -> None:
        # during the start, services log errors about each other
        if ready.is_set() or ABOUT_ARCHIVE.search(line):
            shown = line if line.startswith("{") else f"{process.name}: {line}"  # a line of JSON stays one line
            print(escaped(shown), file=sys.stderr)

    if settings.directory is not None:
        check_hosts(settings.directory, settings.hosts)
    cluster = LocalCluster(
        hosts=settings.hosts,
        supernodes=settings.supernodes,
        listen=settings.listen,
        durable=False,
        secret_file=settings.secret_file or secret_file(),
        allow_insecure_anywhere=settings.allow_insecure_anywhere,
        log_level=settings.log_level,
        log_format=settings.log_format,
        reflection=settings.reflection,
        metrics=settings.metrics,
        archive=settings.archive,
        archive_folder=settings.archive_folder,
        directory=settings.directory,
        on_line=pass_on,
        on_exit=ended.put,
    )
    try:
        with (
            unwinding(signal.SIGINT, signal.SIGTERM, signal.SIGHUP),
            cluster,
            _page(settings, cluster, pass_on) as page,
        ):
            print(_welcome(cluster, settings, time.monotonic() - began, page), flush=True)
            ready.set()
            story = _last_story(cluster, ended)
    except KeyboardInterrupt:
        print("\nstopped; nothing is left running")
        return 0
    print(f"stampede dev: {_shown(story)}\neverything else was stopped", file=sys.stderr)
    return 1


@contextmanager
def _page(
    settings: DevSettings, cluster: LocalCluster, on_line: Callable[[ServiceProcess, str], None]
) -> Iterator[str | None]:
    """Run the page and yield its URL; None without --web. If the page ends, the cluster goes on."""
    if not settings.web:
        yield None
        return
    words = ["--listen", settings.web_listen, "--url", cluster.address, "--secret-file", str(cluster.secret_file)]
    words += ["--log-level", settings.log_level, "--log-format", settings.log_format]
    page = ServiceProcess("the page", PAGE_MODULE, words, on_line=on_line)
    try:
        page.start()
        yield page.wait_ready(PAGE_SECONDS)
    finally:
        page.stop()


def _last_story(cluster: LocalCluster, ended: queue.SimpleQueue[ServiceProcess]) -> str:
    """Wait until the cluster cannot serve any more, and return why. Meanwhile, report parts that end."""
    while True:  # ends with Ctrl-C, or when too many parts have ended
        process = ended.get()
        if not _can_serve_without(process, cluster):
            return process.describe_end()
        print(f"stampede dev: {_shown(process.describe_end())}\nthe others go on", file=sys.stderr, flush=True)


def _can_serve_without(process: ServiceProcess, cluster: LocalCluster) -> bool:
    """Whether the rest of the cluster can still serve: a majority of the supernodes, and a host."""
    supernodes = [one for one in cluster.supernodes if not one.ended and one is not process]
    hosts = [one for one in cluster.hosts if not one.ended and one is not process]
    is_frontend = process not in (*cluster.supernodes, *cluster.hosts)
    return not is_frontend and bool(hosts) and 2 * len(supernodes) > len(cluster.supernodes)


def _welcome(cluster: LocalCluster, settings: DevSettings, seconds: float, page: str | None) -> str:
    address = cluster.address
    default = address == os.environ.get("STAMPEDE_URL", DEFAULT_ADDRESS) == DEFAULT_ADDRESS
    where = "" if default else f'"{address}"'
    export = "" if default else f"  export STAMPEDE_URL={address}\n"
    export += f"  export STAMPEDE_SECRET_FILE={cluster.secret_file}\n" if settings.secret_file else ""
    metrics = "".join(f"  {title}: http://{where}/metrics\n" for title, where in cluster.metrics.items())
    metrics = f"Metrics for Prometheus:\n\n{metrics}\n" if metrics else ""
    see = f"\nSee all streams on one time line: {page}\n" if page else ""
    parts = f"{_count(settings.supernodes, 'supernode')}, {_count(settings.hosts, 'host')}, 1 front-end"
    return f"""\
Stampede RT is ready at {address} ({parts}; {seconds:.1f} s).
{_kept(settings.archive)}
Callers need the secret in {cluster.secret_file}, which programs of this user find by themselves.
{see}
In another terminal:

{export}  stampede put cam/left "hello"
  stampede get cam/left
  stampede ls

In Python:

  import stampede_rt as st

  with st.connect({where}) as rt:
      left = rt.channel("cam/left", max_age="10s")
      left.put(b"hello")
      print(left.newest())

{metrics}Ctrl-C stops it."""


def _kept(archive: Path | str | None) -> str:
    if archive is None:
        return "Everything is held in memory."
    return (
        f"Archives of channels are in {escaped(str(archive))}. The names of channels, groups and queues are on disk, "
        "too; everything else is held in memory."
    )


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"
