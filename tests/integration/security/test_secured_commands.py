"""The command line with a cluster that asks for certificates."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

import stampede_rt as st
from stampede_rt.cli.main import main as stampede
from stampede_rt_local.cluster import LocalCluster
from stampede_rt_runtime.identity import Role
from tests.support.cluster import secured_cluster_fixture

cluster = secured_cluster_fixture(hosts=1, supernodes=1)


def test_the_command_line_reads_the_paths_of_certificates_from_the_environment(cluster: LocalCluster) -> None:
    files = cluster.tls_files("shell")
    assert files is not None
    named = dict(zip(("CA", "CERTIFICATE", "KEY"), map(str, files.paths()), strict=True))
    plain = {name: value for name, value in os.environ.items() if not name.startswith("STAMPEDE_")}
    command = [sys.executable, "-m", "stampede_rt.cli", "ls", "--url", cluster.address]
    secured = plain | {f"STAMPEDE_TLS_{name}": value for name, value in named.items()}
    done = subprocess.run(command, env=secured, capture_output=True, text=True, timeout=20)
    assert (done.returncode, done.stderr) == (0, "")
    refused = subprocess.run(command, env=plain, capture_output=True, text=True, timeout=20)
    assert refused.returncode == 1
    assert refused.stderr.startswith(f"stampede: {cluster.address} asks for certificates (TLS)")
    assert refused.stderr.count("\n") == 1


def supernode_command(cluster: LocalCluster, files: st.TlsFiles | None, *words: str) -> tuple[int, str]:
    """Run `stampede supernode ...` with that certificate. Returns its exit code and its output."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith("STAMPEDE_")}
    if files is not None:
        named = zip(("CA", "CERTIFICATE", "KEY"), map(str, files.paths()), strict=True)
        environment |= {f"STAMPEDE_TLS_{name}": path for name, path in named}
    command = [sys.executable, "-m", "stampede_rt.cli", "supernode", *words, "--member", cluster.supernodes[0].address]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=30)
    return done.returncode, done.stdout + done.stderr


def test_a_new_supernode_joins_with_an_operator_token_and_its_own_certificate(
    cluster: LocalCluster, tmp_path: Path
) -> None:
    newcomer = cluster.tls_files("s9", Role.SUPERNODE)
    words = ("join", "--data-dir", str(tmp_path / "s9"), "--listen", "localhost:7599", "--id", "s9")
    code, printed = supernode_command(cluster, newcomer, *words)
    assert (code, "may not call MembershipService/CreateJoinToken, which is for operator" in printed) == (1, True)
    boss = cluster.tls_files("boss", Role.OPERATOR)
    code, printed = supernode_command(cluster, boss, "add", "localhost:7599", "--id", "s9", "-o", "json")
    assert code == 0, printed
    code, printed = supernode_command(cluster, newcomer, *words, "--token", json.loads(printed)["token"])
    assert (code, "Supernode s9 is ready to join the cluster of s1" in printed) == (0, True), printed


@pytest.mark.parametrize("verb", ["status", "add", "remove", "snapshot", "join"])
def test_every_verb_of_supernode_tells_a_caller_that_it_needs_a_certificate(
    verb: str, cluster: LocalCluster, tmp_path: Path
) -> None:
    joining = ("--data-dir", str(tmp_path / "x"), "--listen", "localhost:7599")
    words = {"remove": ("s1",), "add": ("localhost:7599",), "join": joining}.get(verb, ())
    code, printed = supernode_command(cluster, None, verb, *words)
    address = cluster.supernodes[0].address
    expected = f"stampede supernode: {address} asks for certificates (TLS), and this caller has none"
    assert (code, printed.count("\n")) == (1, 1)
    assert printed.startswith(expected)


def test_doctor_finds_a_secured_cluster_healthy_and_names_the_missing_certificate_of_a_caller(
    cluster: LocalCluster, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert stampede(["doctor", "--url", cluster.address]) == 1
    assert f"{cluster.address} asks for certificates (TLS), and this caller has none" in capsys.readouterr().out
    files = cluster.tls_files("doctor")
    assert files is not None
    for variable, path in zip(("CA", "CERTIFICATE", "KEY"), files.paths(), strict=True):
        monkeypatch.setenv(f"STAMPEDE_TLS_{variable}", str(path))
    assert stampede(["doctor", "--url", cluster.address]) == 0
    assert "Everything is well." in capsys.readouterr().out
    monkeypatch.setattr("stampede_rt.cli.doctor.CERTIFICATE_S_MIN", 365 * 86400.0)
    monkeypatch.setattr("stampede_rt.cli.diagnosis.SHORT_PART", 0.1)
    assert stampede(["doctor", "--url", cluster.address]) == 1
    printed = capsys.readouterr().out
    for process in cluster.processes():
        assert f"{process.address}: its certificate ends in 30.0 days; issue it anew" in printed
