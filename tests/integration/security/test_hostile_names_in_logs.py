"""Callers write control characters and forged lines into every text of every method. Each log shows them escaped."""

from __future__ import annotations

import contextlib
import json
import re
import socket
from concurrent.futures import ThreadPoolExecutor
from typing import Any
from urllib.parse import quote, urlparse

import grpc
import pytest

from stampede_rt.security.credentials import call_metadata
from stampede_rt_local.cluster import LocalCluster
from stampede_rt_local.process import ServiceProcess
from tests.robustness.fuzz.ports.methods import Method, methods_of
from tests.support.cluster import running_cluster
from tests.support.command_line.hostile_text import HOSTILE, hostile_message
from tests.support.operator import operating
from tests.support.waiting import wait_until

READY_SECONDS, CALL_SECONDS, PARALLEL_CALLS = 40.0, 2.0, 32
REQUESTS = (
    b"GET / HTTP/1.1\r\nHost: evil\xe2\x80\xae\x9b31m.example\r\n\r\n",
    b"GET /\x1b]0;title\x07 HTTP/1.1\r\nHost: localhost\r\n\r\n",
    f"GET /api/at?channel={quote(HOSTILE)}&time=1 HTTP/1.1\r\nHost: localhost\r\n\r\n".encode(),
    f"GET /api/{quote(HOSTILE)} HTTP/1.1\r\nHost: localhost\r\nUpgrade: \x1b[2J\r\n\r\n".encode(),
    HOSTILE.encode() + b"\r\n\r\n",
)
Logs = dict[str, list[str]]


@pytest.fixture(scope="module", params=["text", "json"])
def logs(request: pytest.FixtureRequest) -> Logs:
    """The lines of each service after all hostile calls, by its kind."""
    lines: Logs = {}

    def keep(process: ServiceProcess, line: str) -> None:
        lines.setdefault(process.name.split()[0], []).append(line)

    form = {"log_level": "debug", "log_format": request.param}
    with running_cluster(LocalCluster(hosts=1, supernodes=1, on_line=keep, **form)) as cluster:
        ask_everything(cluster)
        ask_the_page(cluster, keep, request.param)
    return lines


def ask_everything(cluster: LocalCluster) -> None:
    """Call every method of every port: as an operator, as a client with few rights, and with a wrong secret."""
    ports = {"host": cluster.hosts, "supernode": cluster.supernodes, "frontend": cluster.frontends}
    with operating(cluster) as operator:
        operator.add("cam", "put", "video/*", "--kind", "channel")
        credentials = (cluster.secret.text, operator.token("cam"), "wrong" * 8)
        with contextlib.ExitStack() as stack, ThreadPoolExecutor(PARALLEL_CALLS) as pool:
            for port, processes in ports.items():
                channel = stack.enter_context(grpc.insecure_channel(processes[0].address))
                for secret in credentials:
                    for method in methods_of(port):
                        pool.submit(call, channel, method, secret)
            pool.shutdown()
        operator.keep_rules()  # the calls above may have replaced or removed them


def call(channel: grpc.Channel, method: Method, secret: str) -> None:
    """Make one call, and take its first answer."""
    takes, answers = ("stream" if one else "unary" for one in (method.takes_stream, method.answers_stream))
    make: Any = getattr(channel, f"{takes}_{answers}")
    rpc = make(method.path, request_serializer=bytes, response_deserializer=bytes)
    sent = hostile_message(method.request).SerializeToString()
    settings: Any = {"metadata": call_metadata(secret), "timeout": CALL_SECONDS}
    with contextlib.suppress(grpc.RpcError, StopIteration):
        answer = rpc(iter([sent]) if method.takes_stream else sent, **settings)
        if method.answers_stream:
            next(answer)
            answer.cancel()


def ask_the_page(cluster: LocalCluster, keep: Any, form: str) -> None:
    words = ["--listen", "localhost:0", "--url", cluster.address, "--secret-file", str(cluster.secret_file)]
    words += ["--log-level", "debug", "--log-format", form]
    page = ServiceProcess("web", "stampede_rt_web", words, on_line=keep)
    try:
        page.start()
        where = urlparse(page_url := page.wait_ready(READY_SECONDS))
        assert where.hostname, page_url
        for request in REQUESTS:
            with socket.create_connection((where.hostname, where.port), CALL_SECONDS) as connection:
                connection.sendall(request)
                connection.settimeout(CALL_SECONDS)
                with contextlib.suppress(TimeoutError, ConnectionError):
                    connection.recv(1000)
        wait_until(lambda: any("evil" in line for line in list(page.last_lines)))
    finally:
        page.stop()


@pytest.mark.parametrize("service", ["host", "supernode", "front-end", "web"])
def test_no_hostile_text_reaches_a_log_as_it_is(logs: Logs, service: str) -> None:
    lines = logs[service]
    assert any("access_denied" in line for line in lines)
    for line in lines:
        assert line.isprintable(), line
        assert re.match(r'\d{4}-\d\d-\d\dT[\d:.]+Z level=\w+ logger=|\{"time": "', line), line
        if line.startswith("{"):
            assert json.loads(line)["event"]


@pytest.mark.parametrize(("service", "part"), [("supernode", "forged"), ("web", "evil")])
def test_a_log_shows_the_name_that_a_caller_invented_escaped(logs: Logs, service: str, part: str) -> None:
    (*_, line) = [one for one in logs[service] if "event" in one and part in one]
    assert "\\x9b" in line or "\\u009b" in line, line
