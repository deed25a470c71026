"""Parsers of files that services read: stores, backups, identities, secrets and certificates, damaged or foreign."""

from __future__ import annotations

import base64
import hashlib
import sqlite3
import tempfile
import warnings
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from functools import cache
from pathlib import Path

from stampede_rt.errors import StampedeError
from stampede_rt.security.credentials import read_secrets
from stampede_rt_channel_host.cluster.identity import HomeCluster, load_host_id
from stampede_rt_runtime.auth import load_secret
from stampede_rt_runtime.certificates import (
    CertificateError,
    IssuedCertificate,
    cluster_of,
    describe,
    issue,
    make_authority,
)
from stampede_rt_runtime.identity import Identity, Role
from stampede_rt_supernode.joining.founding import FoundingRecord, read_founding, write_founding
from stampede_rt_supernode.replication import Member
from stampede_rt_supernode.replication.configuration import Configuration
from stampede_rt_supernode.replication.log_entries import Entry
from stampede_rt_supernode.replication.storage.backups import MAGIC, BackupHeader, make_backup, read_backup
from stampede_rt_supernode.replication.storage.known_stores import FILE_NAME as KNOWN_STORES_NAME
from stampede_rt_supernode.replication.storage.known_stores import KnownStores
from stampede_rt_supernode.replication.storage.sqlite_store import DATABASE_NAME, SqliteStore, read_identity
from stampede_rt_supernode.replication.storage.store import StoreChanges, StoreDamaged, StoreRefused
from stampede_rt_supernode.replication.storage.watermark import Watermark
from stampede_rt_supernode.replication.wire.records import encode_configuration, encode_snapshot
from tests.robustness.fuzz import hostile_values
from tests.robustness.fuzz.drawing import ByteSource
from tests.robustness.fuzz.parsers.target import Target

MEMBER = Member(member_id="s1", address="localhost:1")
MADE, IDENTITY = datetime(2026, 1, 1, tzinfo=UTC), Identity("cluster", Role.CLIENT, "fuzz")
NESTED = b"[" * 100_000
TOKENS = (b"", b"null", b"[]", b"{}", b"\xff", b"-1", b"1e999", b'"')


def content(source: ByteSource, sound: bytes) -> bytes:
    """The content of a valid file, changed, cut or replaced."""
    kind = source.below(10)
    if kind == 0:
        return source.choice((b"", NESTED, b"\xff\xfe", b"\0" * 100, hostile_values.text(source).encode()))
    at, length = source.below(len(sound) + 1), source.choice((1, 0, 2, 10))
    put = source.take(length) if kind < 5 else source.choice(TOKENS)
    return sound[:at] + put + sound[at + length :]


@contextmanager
def folder() -> Iterator[Path]:
    """An empty folder, in memory if the system has /dev/shm."""
    place = Path("/dev/shm")
    with tempfile.TemporaryDirectory(dir=place if place.is_dir() else None) as name:
        yield Path(name)


def _entries() -> list[Entry]:
    return [Entry(encode_configuration(Configuration.of([MEMBER])), 1, 1), Entry(b"\0second", 2, 1)]


def _record() -> bytes:
    previous, last = _entries()
    return encode_snapshot(previous=previous, last=last, configuration=Configuration.of([MEMBER]), state=b"")


def backup(source: ByteSource) -> None:
    """Half of the inputs have the right checksum, because an attacker can compute it."""
    header = BackupHeader(member_id="s1", cluster_id="c", log_index=2, time_unix_nano=1)
    sound = b"".join(make_backup(header, _record()).parts())
    data = content(source, sound)
    if source.chance(50):
        body = data[:-32] if data.startswith(MAGIC) else MAGIC + data
        data = body + hashlib.sha256(body).digest()
    with folder() as place:
        (place / "backup").write_bytes(data)
        read_backup(place / "backup")


def founding(source: ByteSource) -> None:
    with folder() as place:
        write_founding(place, FoundingRecord(supernode_id="s1", address="localhost:1", members={"s1": "localhost:1"}))
        (file,) = place.iterdir()
        file.write_bytes(content(source, file.read_bytes()))
        found = read_founding(place)
        assert found is not None
        found.replication_settings(place)


def known_stores(source: ByteSource) -> None:
    with folder() as place:
        stores = KnownStores.open(place, had_store=False)
        stores.note("s2", "ab" * 8, ["s1", "s2"])
        body = content(source, (place / KNOWN_STORES_NAME).read_bytes())
        if source.chance(50):
            _, _, facts = body.rstrip(b"\n").partition(b" ")
            body = b"%08x " % zlib.crc32(facts) + facts
        (place / KNOWN_STORES_NAME).write_bytes(body)
        reopened = KnownStores.open(place, had_store=True)
        reopened.admits("s2", "x")
        reopened.note("s3", "cd" * 8, ["s1"])


def watermark(source: ByteSource) -> None:
    with folder() as place:
        (place / "mark").write_bytes(source.rest())
        mark = Watermark(place / "mark")
        assert mark.read() >= 0
        mark.close()


def host_identity(source: ByteSource) -> None:
    with folder() as place:
        load_host_id(place)
        HomeCluster(place).note("cluster")
        for file in sorted(place.iterdir()):
            file.write_bytes(content(source, file.read_bytes()))
        load_host_id(place)
        HomeCluster(place)


def secret(source: ByteSource) -> None:
    with folder() as place:
        file = place / "secret"
        file.touch(0o600)
        file.write_bytes(content(source, b"secret-of-the-cluster\nanother\n"))
        values = read_secrets(file)
        assert all(value.isprintable() for value in values or ()), (
            "a secret must be printable, because it travels in a header"
        )
        load_secret(file)


@cache
def _authority() -> IssuedCertificate:
    return make_authority("cluster", now=MADE, lifetime=timedelta(days=1))


def _reencoded(source: ByteSource, pem: bytes) -> bytes:
    """The same file with changed bytes below the PEM encoding. That finds the errors of the inner parser."""
    der = bytearray(base64.b64decode(b"".join(pem.splitlines()[1:-1])))
    for _ in range(1 + source.below(3)):
        der[source.below(len(der))] = source.below(256)
    return b"-----BEGIN CERTIFICATE-----\n" + base64.encodebytes(der) + b"-----END CERTIFICATE-----\n"


def certificate(source: ByteSource) -> None:
    authority = _authority()
    data = _reencoded(source, authority.certificate) if source.chance(60) else content(source, authority.certificate)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the library warns about numbers that a standard forbids
        for read in (describe, cluster_of):
            read(data)
        issue(IssuedCertificate(data, authority.key), IDENTITY, (), now=MADE, lifetime=timedelta(days=1))


@cache
def _database() -> bytes:
    with folder() as place:
        store = SqliteStore(place, cluster_id="c", member_id="s1", create=True)
        entries = _entries()
        changes = StoreChanges(
            replace_from=0,
            entries=entries,
            first_index=1,
            last_index=2,
            last_term=1,
            term=1,
            voted_for=None,
            commit_index=2,
        )
        store.commit(changes)
        store.close()
        with sqlite3.connect(place / DATABASE_NAME) as database:
            database.execute("PRAGMA journal_mode=DELETE")
        database.close()
        return (place / DATABASE_NAME).read_bytes()


def store(source: ByteSource) -> None:
    """The database of a member with bytes or rows changed."""
    with folder() as place:
        path = place / DATABASE_NAME
        path.write_bytes(_database() if source.chance(60) else content(source, _database()))
        if source.chance(70):
            _change_rows(source, path)
        read_identity(place)
        opened = SqliteStore(place, cluster_id="c", member_id="s1", create=False)
        try:
            state = opened.load()
            assert [entry.log_index for entry in state.entries] == [1, 2]
        finally:
            opened.close()


def _change_rows(source: ByteSource, path: Path) -> None:
    database = sqlite3.connect(path)
    try:
        tables = [name for (name,) in database.execute("SELECT name FROM sqlite_master WHERE type='table'")]
        table = source.choice(sorted(tables))
        columns = [row[1] for row in database.execute(f"PRAGMA table_info({table})")]
        value = source.choice((None, -1, 2**63 - 1, "text", b"\xff", 1.5, hostile_values.text(source)))
        with database:
            if source.chance(20):
                database.execute(f"DELETE FROM {table}")
            else:
                database.execute(f"UPDATE {table} SET {source.choice(columns)} = ?", (value,))
    except (sqlite3.Error, ZeroDivisionError, ValueError):
        pass  # the file was damaged already, or the change is not possible
    finally:
        database.close()


DAMAGED = (StoreDamaged, StoreRefused)
TARGETS = (
    Target("backup", backup, DAMAGED),
    Target("founding", founding, (StampedeError,)),
    Target("known_stores", known_stores, DAMAGED),
    Target("watermark", watermark, ()),
    Target("host_identity", host_identity, (StampedeError,)),
    Target("secret", secret, (StampedeError,)),
    Target("certificate", certificate, (CertificateError,)),
    Target("store", store, DAMAGED),
)
