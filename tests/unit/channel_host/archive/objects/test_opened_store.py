"""The contract of a store, for each kind: one in memory, a folder, a real S3 server, and a server of Azure blobs."""

from __future__ import annotations

import os
import socket
from base64 import b64encode
from collections.abc import Iterator
from pathlib import Path

import pytest

from stampede_rt_channel_host.archive.objects.opened_store import OpenedStore
from stampede_rt_channel_host.archive.objects.segment_store import (
    FoundObject,
    SegmentStore,
    StoreError,
    advice,
    check_store,
)
from stampede_rt_runtime.settings import SettingsError
from tests.support.channel_host.azure_server import CONTAINER, AzureServer, azure_server
from tests.support.channel_host.object_stores import FakeStore
from tests.support.channel_host.s3_server import BUCKET, S3Server, s3_server
from tests.unit.channel_host.archive.objects.test_moving_files import found_by, host, move, write_closed


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[S3Server]:
    with s3_server(tmp_path_factory.mktemp("s3")) as running:
        yield running


@pytest.fixture(scope="module")
def azure() -> Iterator[AzureServer]:
    with azure_server() as running:
        yield running


@pytest.fixture(params=["memory", "folder", "s3", "az"])
def store(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> SegmentStore:
    if request.param == "memory":
        return FakeStore()
    if request.param == "folder":
        return OpenedStore(f"file://{tmp_path}/a folder")
    if request.param == "az":
        return opened_in_azure(request.getfixturevalue("azure"), monkeypatch, tmp_path.name)
    return opened(request.getfixturevalue("server"), monkeypatch, tmp_path.name)


def opened(server: S3Server, monkeypatch: pytest.MonkeyPatch, prefix: str) -> OpenedStore:
    for name, value in server.environment.items():
        monkeypatch.setenv(name, value)
    return OpenedStore(f"s3://{BUCKET}/{prefix}")


def opened_in_azure(azure: AzureServer, monkeypatch: pytest.MonkeyPatch, prefix: str) -> OpenedStore:
    for name, value in azure.environment.items():
        monkeypatch.setenv(name, value)
    return OpenedStore(f"az://{CONTAINER}/{prefix}")


@pytest.mark.asyncio
async def test_an_object_is_made_once_read_by_range_listed_and_deleted(store: SegmentStore) -> None:
    name = "channels/00ff/000000001000000001_5_0_1_1_x_x_0.segment"
    assert await store.create(name, bytearray(b"0123456789"))
    assert not await store.create(name, b"other")
    assert store.read(name, 3, 4) == b"3456"
    assert store.read(name, 8, 100) == b"89"
    assert await store.create("channels/00ffa/of-another-channel", b"x")
    assert [*store.find("channels/00ff/")] == [FoundObject(name, 10)]
    store.delete([name, "channels/00ff/missing"])
    assert [*store.find("channels/00ff/")] == []
    with pytest.raises(FileNotFoundError):
        store.read(name, 0, 1)


@pytest.mark.asyncio
async def test_a_store_with_conditional_puts_passes_the_check_again_and_again(
    store: SegmentStore, caplog: pytest.LogCaptureFixture
) -> None:
    await check_store(store)
    await check_store(store)
    assert caplog.text == "", "the check logs a store that it cannot reach"


@pytest.mark.asyncio
async def test_a_listing_of_many_objects_is_complete(server: S3Server, monkeypatch: pytest.MonkeyPatch) -> None:
    store = opened(server, monkeypatch, "many")
    folder = server.folder / "many" / "channels" / "1"
    folder.mkdir(parents=True)
    for number in range(1200):  # more than one page
        (folder / str(number)).write_bytes(b"x")
    assert len([*store.find("channels/1/")]) == 1200


@pytest.mark.parametrize(("variable", "value"), [("AWS_SECRET_ACCESS_KEY", "wrong"), ("AWS_ACCESS_KEY_ID", "nobody")])
@pytest.mark.asyncio
async def test_the_error_for_wrong_credentials_is_clear_and_does_not_show_the_secret(
    server: S3Server, monkeypatch: pytest.MonkeyPatch, variable: str, value: str
) -> None:
    opened(server, monkeypatch, "x")
    monkeypatch.setenv(variable, value)
    with pytest.raises(SettingsError, match=r"--archive: .*s3://archives/x.*AWS_ACCESS_KEY_ID") as caught:
        await check_store(OpenedStore(f"s3://{BUCKET}/x"))
    assert server.environment["AWS_SECRET_ACCESS_KEY"] not in str(caught.value)
    assert "<" not in str(caught.value), "the error has the code and the message of the store, and no XML"


LONG_NAME = f"channels/{'0' * 32}/{'9' * 150}.segment"


@pytest.mark.parametrize(
    ("variable", "value", "bucket", "why"),
    [
        ("AWS_SECRET_ACCESS_KEY", "wrong", BUCKET, "SignatureDoesNotMatch"),
        ("AWS_ACCESS_KEY_ID", "nobody", BUCKET, "No user exists"),
        ("AWS_REGION", "us-east-1", "missing", "NoSuchBucket"),
    ],
)
@pytest.mark.asyncio
async def test_a_store_that_refuses_the_caller_or_has_no_such_bucket_says_why_and_not_that_objects_are_missing(
    server: S3Server, monkeypatch: pytest.MonkeyPatch, variable: str, value: str, bucket: str, why: str
) -> None:
    right = opened(server, monkeypatch, "refusing")
    await right.create(LONG_NAME, b"x")
    monkeypatch.setenv(variable, value)
    store = OpenedStore(f"s3://{bucket}/refusing")
    with pytest.raises(StoreError, match=why) as caught:
        await store.create(LONG_NAME, b"y")
    assert caught.value.is_refusal
    with pytest.raises(StoreError, match=why) as caught:
        store.read(LONG_NAME, 0, 1)
    assert caught.value.is_refusal
    with pytest.raises(StoreError, match=why):
        store.delete([LONG_NAME])
    with pytest.raises(StoreError, match=why):
        [*store.find("channels/")]
    assert right.read(LONG_NAME, 0, 1) == b"x"


@pytest.mark.asyncio
async def test_a_container_that_azure_does_not_have_is_not_a_missing_object(
    azure: AzureServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened_in_azure(azure, monkeypatch, "x")
    store = OpenedStore("az://missing/x")
    with pytest.raises(StoreError, match="ContainerNotFound"):
        store.read(LONG_NAME, 0, 1)


@pytest.mark.usefixtures("no_credentials")
def test_the_error_of_a_store_that_cannot_be_reached_ends_with_the_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.create_server(("127.0.0.1", 0)) as listening:
        port = listening.getsockname()[1]  # no server answers there once the socket is closed
    for name, value in {
        "ENDPOINT_URL": f"http://127.0.0.1:{port}",
        "ACCESS_KEY_ID": "a",
        "SECRET_ACCESS_KEY": "b",
    }.items():
        monkeypatch.setenv(f"AWS_{name}", value)
    monkeypatch.setenv("AWS_ALLOW_HTTP", "true")
    with pytest.raises(StoreError, match=r"HTTP error: error sending request$"):
        OpenedStore(f"s3://{BUCKET}/x").read(LONG_NAME, 0, 1)


@pytest.mark.parametrize("variable", ["AZURE_STORAGE_ACCOUNT_KEY", "AZURE_STORAGE_ACCOUNT_NAME"])
@pytest.mark.asyncio
async def test_the_error_of_azure_for_wrong_credentials_is_clear_and_does_not_show_the_key(
    azure: AzureServer, monkeypatch: pytest.MonkeyPatch, variable: str
) -> None:
    opened_in_azure(azure, monkeypatch, "x")
    monkeypatch.setenv(variable, KEY if variable.endswith("KEY") else "nobody")
    with pytest.raises(SettingsError, match=r"--archive: .*az://archives/x.*AZURE_STORAGE_ACCOUNT_NAME") as caught:
        await check_store(OpenedStore(f"az://{CONTAINER}/x"))
    assert KEY not in str(caught.value)


@pytest.mark.asyncio
async def test_a_container_of_azure_that_does_not_exist_is_named(
    azure: AzureServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened_in_azure(azure, monkeypatch, "x")
    with pytest.raises(SettingsError, match=r"--archive: .*az://missing/x"):
        await check_store(OpenedStore("az://missing/x"))


@pytest.mark.asyncio
async def test_a_segment_goes_to_azure_and_is_read_from_there(
    azure: AzureServer, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    store = opened_in_azure(azure, monkeypatch, tmp_path.name)
    former = host(tmp_path, "a", store, 1)
    write_closed(former, 1)
    await move(former, store)
    assert [one.bytes > 0 for one in store.find("channels/")] == [True]
    assert found_by(host(tmp_path, "b", store, 2)) == [1, 2, 3, 4]


@pytest.fixture
def no_credentials(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [one for one in os.environ if one.startswith(("AWS_", "GOOGLE_", "AZURE_"))]:
        monkeypatch.delenv(name)


KEY = b64encode(b"k" * 32).decode()
AZURE = {"AZURE_STORAGE_ACCOUNT_NAME": "rig", "AZURE_STORAGE_ACCOUNT_KEY": KEY}


@pytest.mark.parametrize(
    ("url", "environment", "why"),
    [
        ("gs://b/p", {"GOOGLE_SERVICE_ACCOUNT": "/no/such/file"}, "/no/such/file"),
        ("gs://b/p", {"GOOGLE_SERVICE_ACCOUNT_KEY": "secret-nonsense"}, "service account"),
        ("az://c/p", {}, "Account must be specified"),
        ("az://c/p", {**AZURE, "AZURE_STORAGE_ACCOUNT_KEY": "secret-nonsense!"}, "Invalid Access Key"),
    ],
)
@pytest.mark.usefixtures("no_credentials")
def test_the_error_for_unusable_credentials_of_google_and_azure_is_clear_and_does_not_show_them(
    monkeypatch: pytest.MonkeyPatch, url: str, environment: dict[str, str], why: str
) -> None:
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    with pytest.raises(StoreError, match=why) as caught:
        OpenedStore(url)
    assert caught.value.is_refusal
    assert str(caught.value.strerror).startswith(f"the object store {url} says: ")
    assert "secret" not in str(caught.value)


@pytest.mark.usefixtures("no_credentials")
@pytest.mark.asyncio
async def test_an_unencrypted_endpoint_of_azure_needs_its_own_variable(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    with socket.create_server(("127.0.0.1", 0)) as listening:
        port = listening.getsockname()[1]  # no server answers there once the socket is closed
    for name, value in {**AZURE, "AZURE_STORAGE_ENDPOINT": f"http://127.0.0.1:{port}"}.items():
        monkeypatch.setenv(name, value)
    refused = r"--archive: .*az://c/p says: .*AZURE_ALLOW_HTTP is not true; .*AZURE_STORAGE_ACCOUNT_NAME"
    with pytest.raises(SettingsError, match=refused) as caught:
        await check_store(OpenedStore("az://c/p"))
    assert KEY not in str(caught.value)
    assert "AWS_" not in str(caught.value)
    monkeypatch.setenv("AZURE_ALLOW_HTTP", "true")
    await check_store(OpenedStore("az://c/p"))
    assert "cannot be reached" in caplog.text


@pytest.mark.parametrize(
    ("url", "names"),
    [("s3://b", "AWS_REGION"), ("gs://b", "GOOGLE_SERVICE_ACCOUNT "), ("az://c", "AZURE_"), ("file:///x", "folder")],
)
def test_the_advice_for_a_refusal_names_the_variables_of_its_store(url: str, names: str) -> None:
    assert names in advice(url)
    assert ("AWS_" in advice(url)) == (names == "AWS_REGION")


@pytest.mark.asyncio
async def test_the_error_for_a_missing_bucket_is_clear(server: S3Server, monkeypatch: pytest.MonkeyPatch) -> None:
    opened(server, monkeypatch, "x")
    with pytest.raises(SettingsError, match="s3://no-such-bucket/x"):
        await check_store(OpenedStore("s3://no-such-bucket/x"))


@pytest.mark.asyncio
async def test_a_store_that_cannot_be_reached_is_logged_and_does_not_end_the_host(
    caplog: pytest.LogCaptureFixture,
) -> None:
    store = FakeStore()
    store.failure = "connection refused"
    await check_store(store)
    assert "cannot be reached" in caplog.text


@pytest.mark.asyncio
async def test_a_store_that_overwrites_is_refused() -> None:
    class OverwritingStore(FakeStore):
        async def create(self, name: str, content: bytes | bytearray) -> bool:
            self.objects[name] = bytes(content)
            return True

    with pytest.raises(SettingsError, match="If-None-Match"):
        await check_store(OverwritingStore())


@pytest.mark.asyncio
async def test_the_error_for_a_folder_without_write_permission_is_clear(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("no folder")
    with pytest.raises(StoreError, match=r"file://.*file"):
        OpenedStore(f"file://{tmp_path}/file/below")
