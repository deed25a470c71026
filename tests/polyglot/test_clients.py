"""A client that knows only proto/ can do the same as the Python client (contract: docs/wire.md)."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import stampede_rt as st
from stampede_rt_local.cluster import LocalCluster
from tests.polyglot.toolchains import SOURCES, Client

LANGUAGES = ["go", "node"]
LINES_MAX = 150

# The first run on a machine fetches and compiles; later ones take seconds.
pytestmark = pytest.mark.timeout(600)

ClientIn = Callable[[str], Client]


def report(client: Client, cluster: LocalCluster, channel: str, *texts: str) -> dict[str, Any]:
    """The output of the client: the seqs of its puts, the items of the last 30 s, and the items of its subscription."""
    done = client.run(cluster.address, str(cluster.secret_file), channel, *texts)
    assert done.returncode == 0, done.stderr
    printed: dict[str, Any] = json.loads(done.stdout)
    return printed


def texts_of(items: list[dict[str, Any]]) -> list[str]:
    return [item["Text"] for item in items]


@pytest.mark.parametrize("language", LANGUAGES)
def test_a_client_puts_gets_the_last_30_s_and_subscribes(
    language: str, client_in: ClientIn, cluster: LocalCluster
) -> None:
    began = time.time_ns()
    facts = report(client_in(language), cluster, f"polyglot/{language}", "one", "two", "drei ≠ trois")
    first, *_ = seqs = facts["put"]
    assert seqs == [first, first + 1, first + 2]
    assert texts_of(facts["last"]) == texts_of(facts["subscribed"]) == ["one", "two", "drei ≠ trois"]
    assert [item["Seq"] for item in facts["last"]] == [item["Seq"] for item in facts["subscribed"]] == seqs
    # Node's clock reading has milliseconds, so that an item may seem to be a little older than the test.
    assert all(began - 1_000_000 <= int(item["Time"]) <= time.time_ns() for item in facts["last"])


def test_items_of_a_client_in_one_language_are_read_by_clients_in_the_others(
    client_in: ClientIn, cluster: LocalCluster
) -> None:
    clients = [client_in(language) for language in LANGUAGES]
    expected = ["from python", *(f"from {client.language}" for client in clients)]
    with st.connect(cluster.address, name="polyglot") as rt:
        channel = rt.channel("polyglot/shared", max_age="60s")  # as the clients state it
        channel.put(b"from python")
        for client in clients:
            facts = report(client, cluster, "polyglot/shared", f"from {client.language}")
            assert texts_of(facts["subscribed"]) == [f"from {client.language}"]
        assert texts_of(facts["last"]) == expected
        assert [item.payload.decode() for item in channel.get(*st.last("30s"))] == expected


def test_a_client_in_node_reads_as_of_an_earlier_instant(client_in: ClientIn, cluster: LocalCluster) -> None:
    client = client_in("node")
    with st.connect(cluster.address, name="polyglot") as rt:
        channel = rt.channel("polyglot/recorded", max_age="60s", archive="1h")
        channel.put(b"known")
        then = channel.stats().host_time
        channel.put(b"not known yet")
    client = replace(client, environment={**client.environment, "AS_OF": str(then)})
    assert texts_of(report(client, cluster, "polyglot/recorded")["last"]) == ["known"]


@pytest.mark.parametrize("language", LANGUAGES)
def test_a_wrong_secret_is_refused_with_its_reason(
    language: str, client_in: ClientIn, cluster: LocalCluster, tmp_path: Path
) -> None:
    wrong = tmp_path / "secret"
    wrong.write_text("not the secret of this cluster\n")
    done = client_in(language).run(cluster.address, str(wrong), "polyglot/refused", "never")
    assert done.returncode == 1
    assert "UNAUTHENTICATED:" in done.stderr


@pytest.mark.parametrize("language", LANGUAGES)
def test_a_malformed_name_is_refused_with_its_reason(language: str, client_in: ClientIn, cluster: LocalCluster) -> None:
    done = client_in(language).run(cluster.address, str(cluster.secret_file), "Not A Name", "never")
    assert done.returncode == 1
    assert "INVALID_NAME:" in done.stderr


@pytest.mark.parametrize("source", ["go/main.go", "node/client.js"])
def test_a_client_is_short_enough_to_be_read_as_documentation(source: str) -> None:
    assert len((SOURCES / source).read_text().splitlines()) < LINES_MAX
