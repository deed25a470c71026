"""Client tokens in a running cluster."""

from __future__ import annotations

from pathlib import Path

import pytest

import stampede_rt as st
from stampede_rt import aio
from stampede_rt.administration.running_cluster import Cluster
from stampede_rt.cli.commands import run
from stampede_rt.errors import PermissionDenied
from stampede_rt_local.cluster import LocalCluster
from tests.support.cluster import cluster_fixture

pytestmark = pytest.mark.without_rules("it acts as an operator")
cluster = cluster_fixture(hosts=1, supernodes=1)


def issued(cluster: LocalCluster, folder: Path, name: str, *options: str) -> str:
    file = folder / f"{name}.token"
    assert run(["token", "issue", name, "--url", cluster.address, "--out", str(file), *options]) == 0
    assert file.stat().st_mode & 0o077 == 0
    return file.read_text().strip()


def test_a_client_with_a_token_puts_reads_and_subscribes(cluster: LocalCluster, tmp_path: Path) -> None:
    token = issued(cluster, tmp_path, "cam-1")
    with st.connect(cluster.address, secret=token) as rt:
        channel = rt.channel("tokens/video")
        channel.put(b"frame")
        assert channel.newest().payload == b"frame"
        with rt.queue("tokens/jobs") as queue:
            queue.put(b"job")


def test_a_client_token_can_neither_make_tokens_nor_change_members(
    cluster: LocalCluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("STAMPEDE_SECRET_FILE", str(tmp_path / "cam.token"))
    with monkeypatch.context() as as_member:
        as_member.setenv("STAMPEDE_SECRET_FILE", str(cluster.secret_file))
        issued(cluster, tmp_path, "cam")
    for words in (["token", "issue", "root"], ["supernode", "add", "localhost:1"]):
        assert run([*words, "--url", cluster.address]) == 1
        assert "client cam may not call" in capsys.readouterr().err


def test_an_operator_token_can_make_tokens(
    cluster: LocalCluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    issued(cluster, tmp_path, "ops", "--role", "operator")
    monkeypatch.setenv("STAMPEDE_SECRET_FILE", str(tmp_path / "ops.token"))
    capsys.readouterr()
    assert run(["token", "issue", "cam-2", "--url", cluster.address]) == 0
    assert capsys.readouterr().out.startswith("stampede-token-1.")


def test_an_expired_or_damaged_token_is_refused(cluster: LocalCluster, tmp_path: Path) -> None:
    over = issued(cluster, tmp_path, "short", "--ttl", "1ns")
    with pytest.raises(PermissionDenied, match="the token of short has ended"):
        st.connect(cluster.address, secret=over)
    with pytest.raises(PermissionDenied, match="this cluster has not signed the token"):
        st.connect(cluster.address, secret=over[:-9])


async def test_a_stream_ends_with_its_token(cluster: LocalCluster, tmp_path: Path) -> None:
    token = issued(cluster, tmp_path, "brief", "--ttl", "4s")
    async with await aio.connect(cluster.address, secret=token) as rt:
        channel = await rt.channel("tokens/brief")
        subscription = channel.subscribe()
        with pytest.raises(PermissionDenied, match="the token of brief has ended"):
            await anext(subscription)


def test_a_token_is_revoked_by_its_file_or_its_serial_number_and_other_texts_are_refused(
    cluster: LocalCluster, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """In an earlier version, `token issue` printed no serial number, and `token revoke` accepted every number."""
    token = issued(cluster, tmp_path, "leaked")
    assert run(["token", "revoke", str(tmp_path / "leaked.token"), "--url", cluster.address]) == 0
    with pytest.raises(PermissionDenied, match="of client leaked was revoked"):
        st.connect(cluster.address, secret=token)
    capsys.readouterr()
    assert run(["token", "issue", "printed", "--url", cluster.address]) == 0
    printed = capsys.readouterr()
    serial = printed.err.split()[1]
    assert run(["token", "revoke", serial.upper(), "--url", cluster.address]) == 0
    assert f"{serial} is revoked" in capsys.readouterr().out
    with pytest.raises(PermissionDenied, match="of client printed was revoked"):
        st.connect(cluster.address, secret=printed.out.strip())
    (tmp_path / "other").write_text("no.token")
    for text in ("abc", "f" * 40, str(tmp_path / "other"), str(tmp_path / "missing")):
        assert run(["token", "revoke", text, "--url", cluster.address]) == 1
        assert "is neither the file of a token nor the serial number of a token" in capsys.readouterr().err


def refuse(*_: object, **settings: object) -> None:
    raise PermissionDenied("refused")


def test_the_command_makes_no_token_if_it_cannot_write_the_file(
    cluster: LocalCluster, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "there.token"
    file.write_text("another")
    requests: list[object] = []
    monkeypatch.setattr(Cluster, "issue_client_token", lambda *arguments, **settings: requests.append(arguments))
    assert run(["token", "issue", "cam-3", "--url", cluster.address, "--out", str(file)]) == 1
    assert "there.token cannot be written: File exists; name a new file with --out" in capsys.readouterr().err
    assert (requests, file.read_text()) == ([], "another")
    unmade = tmp_path / "unmade.token"
    monkeypatch.setattr(Cluster, "issue_client_token", refuse)
    assert run(["token", "issue", "cam-3", "--url", cluster.address, "--out", str(unmade)]) == 1
    assert not unmade.exists()


def test_an_operator_that_revokes_its_own_token_gets_a_warning(
    cluster: LocalCluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    issued(cluster, tmp_path, "leaver", "--role", "operator")
    own = tmp_path / "leaver.token"
    monkeypatch.setenv("STAMPEDE_SECRET_FILE", str(own))
    capsys.readouterr()
    assert run(["token", "revoke", str(own), "--url", cluster.address]) == 0
    printed = capsys.readouterr()
    assert "is revoked" in printed.out
    assert "this command used the revoked credential, and services refuse it now" in printed.err
    assert "not in force" not in printed.err
