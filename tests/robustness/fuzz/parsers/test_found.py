"""The earlier findings of the targets, each with its original input.

They are damaged files, hostile values, and answers of newer services.
"""

from __future__ import annotations

import base64
import contextlib
import hashlib
import zlib
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import grpc
import pytest

from stampede_rt.cli.arguments import parse_time
from stampede_rt.cli.commands import run
from stampede_rt.cluster.addresses import parse_addresses
from stampede_rt.errors import InvalidArgument, PermissionDenied, StampedeError
from stampede_rt.security.credentials import read_secret
from stampede_rt.status import DETAILS_KEY, from_rpc_error
from stampede_rt.v1 import channel_service_pb2, directory_pb2, peer_pb2
from stampede_rt.wire import peers, reads, records
from stampede_rt_channel_host.cluster.identity import HomeCluster, load_host_id
from stampede_rt_runtime.certificates import (
    CertificateError,
    IssuedCertificate,
    cluster_of,
    describe,
    issue,
    make_authority,
)
from stampede_rt_runtime.identity import Identity, Role
from stampede_rt_runtime.settings import SettingsError, load_settings
from stampede_rt_supernode.joining.founding import FILE_NAME as FOUNDING_NAME
from stampede_rt_supernode.joining.founding import FoundingRecord, read_founding, write_founding
from stampede_rt_supernode.replication.storage.backups import MAGIC, read_backup
from stampede_rt_supernode.replication.storage.known_stores import FILE_NAME as KNOWN_STORES_NAME
from stampede_rt_supernode.replication.storage.known_stores import KnownStores
from stampede_rt_supernode.replication.storage.store import StoreDamaged
from stampede_rt_supernode.settings import SupernodeSettings

NESTED = b"[" * 100_000
NO_TEXT = b"\xff\xfe"
MADE = datetime(2026, 1, 1, tzinfo=UTC)
HOSTILE = "a\x1b[2J\r\nforged"


@pytest.mark.parametrize(
    "address",
    [
        *(
            "rig:٣",
            "rig:" + "1" * 5000,
            "a b:1",
            HOSTILE,
            f"{HOSTILE}:1",
            "[[::1]]:1",
            "[::1",
            "a[b]:1",
            "[]:1",
            "::]:1",
        ),
        *("[a\x1b[2J]:1", "rig:+1", "[", ":", "a\ufeff:1"),
    ],
)
def test_an_address_that_no_service_takes_is_refused_by_the_client(address: str) -> None:
    with pytest.raises(InvalidArgument):
        parse_addresses(address)


@pytest.mark.parametrize(
    ("address", "target"), [("rig", "rig:7580"), ("::1", "[::1]:7580"), ("[::1]:5", "[::1]:5"), ("a:1", "a:1")]
)
def test_an_address_as_people_write_it_is_accepted(address: str, target: str) -> None:
    assert parse_addresses(address) == (target,)


def test_a_time_with_very_many_digits_is_refused() -> None:
    with pytest.raises(InvalidArgument):
        parse_time("1" * 5000)


@pytest.mark.parametrize("words", [["doctor", HOSTILE], ["ls", "--" + HOSTILE], [HOSTILE], ["ls", "-o", HOSTILE]])
def test_wrong_arguments_are_escaped_on_the_terminal(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert _status_of(words) == 2
    last = capsys.readouterr().err.rstrip("\n").splitlines()[-1]
    assert last.isprintable()
    assert "forged" in last, "the forged text does not look like a line of its own"


def _status_of(words: list[str]) -> object:
    try:
        return run(words)
    except SystemExit as ended:
        return ended.code


@pytest.mark.parametrize("text", [NO_TEXT, "geheimnüs".encode(), b"with\x1bescape"])
def test_a_secret_that_no_header_carries_is_refused(text: bytes, tmp_path: Path) -> None:
    file = tmp_path / "secret"
    file.touch(0o600)
    file.write_bytes(text)
    with pytest.raises(PermissionDenied, match="copy the file"):
        read_secret(file)


@pytest.mark.parametrize("read", [load_host_id, HomeCluster])
def test_notes_of_a_host_that_are_not_text_are_refused(read: Callable[[Path], Any], tmp_path: Path) -> None:
    load_host_id(tmp_path)
    HomeCluster(tmp_path).note("cluster")
    for file in tmp_path.iterdir():
        file.write_bytes(NO_TEXT)
    with pytest.raises(InvalidArgument, match="remove it"):
        read(tmp_path)


@pytest.mark.parametrize("body", [b"{}", b"null", NESTED, NO_TEXT, b'{"own": 1, "known": {}}', b'{"known": {"a": 1}}'])
def test_malformed_notes_of_stores_are_refused(body: bytes, tmp_path: Path) -> None:
    (tmp_path / KNOWN_STORES_NAME).write_bytes(b"%08x " % zlib.crc32(body) + body)
    with pytest.raises(StoreDamaged):
        KnownStores.open(tmp_path, had_store=True)


@pytest.mark.parametrize(("old", "new"), [('"s1"', '"s2"'), ('"localhost:1"', "1"), ("{", "[" * 100_000), ("{", "")])
def test_a_members_file_that_contradicts_itself_is_refused(old: str, new: str, tmp_path: Path) -> None:
    write_founding(tmp_path, FoundingRecord(supernode_id="s1", address="localhost:1", members={"s1": "localhost:1"}))
    file = tmp_path / FOUNDING_NAME
    file.write_text(file.read_text().replace(old, new, 1))
    with pytest.raises(StampedeError, match=r"supernode\.json"):
        read_founding(tmp_path)


@pytest.mark.parametrize("line", [NESTED, b"{}", b"null", NO_TEXT])
def test_a_backup_with_a_malformed_first_line_is_refused(line: bytes, tmp_path: Path) -> None:
    body = MAGIC + line + b"\nrecord"
    (tmp_path / "backup").write_bytes(body + hashlib.sha256(body).digest())
    with pytest.raises(StoreDamaged):
        read_backup(tmp_path / "backup")


@pytest.mark.parametrize("text", [b"a = " + NESTED, NO_TEXT])
def test_a_file_without_settings_is_refused(text: bytes, tmp_path: Path) -> None:
    (tmp_path / "settings.toml").write_bytes(text)
    with pytest.raises(SettingsError, match="cannot be read"):
        load_settings(
            SupernodeSettings, service="supernode", argv=["--config", str(tmp_path / "settings.toml")], environ={}
        )


def test_a_change_of_a_kind_that_a_newer_directory_knows_is_reported_as_an_update() -> None:
    newer: Any = 99
    assert records.change(directory_pb2.DirectoryChange(kind=newer), {}).kind == "updated"
    assert peers.peer_change(peer_pb2.PeerChange(kind=newer)).kind == "updated"


def test_a_reason_that_a_newer_host_knows_is_reported_with_its_detail() -> None:
    newer: Any = 99
    reason = reads.summary_reason(channel_service_pb2.GetSummary(reason=newer, detail="it moved"))
    assert (reason, reason and reason.detail) == ("UNKNOWN", "it moved")


def test_details_of_a_status_that_cannot_be_read_leave_its_code() -> None:
    trailers = grpc.aio.Metadata((DETAILS_KEY, b"\xff\xff"))
    failed = grpc.aio.AioRpcError(grpc.StatusCode.PERMISSION_DENIED, grpc.aio.Metadata(), trailers, details="no")
    assert isinstance(from_rpc_error(failed, "localhost:1"), PermissionDenied)


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_a_certificate_with_any_byte_changed_is_read_or_refused() -> None:
    authority = make_authority("cluster", now=MADE, lifetime=timedelta(days=1))
    sound = base64.b64decode(b"".join(authority.certificate.splitlines()[1:-1]))
    client = Identity("cluster", Role.CLIENT, "a")
    for place in range(len(sound)):
        der = sound[:place] + bytes((sound[place] ^ 0x1C,)) + sound[place + 1 :]
        pem = b"-----BEGIN CERTIFICATE-----\n" + base64.encodebytes(der) + b"-----END CERTIFICATE-----\n"
        with contextlib.suppress(CertificateError):
            describe(pem)
        with contextlib.suppress(CertificateError):
            cluster_of(pem)
        with contextlib.suppress(CertificateError):
            issue(IssuedCertificate(pem, authority.key), client, (), now=MADE, lifetime=timedelta(days=1))
