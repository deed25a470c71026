"""The contract of a store, for each kind: one in memory, a folder, and a real S3 server."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from stampede_rt_channel_host.archive.objects.opened_store import OpenedStore
from stampede_rt_channel_host.archive.objects.segment_store import FoundObject, SegmentStore, StoreError, check_store
from stampede_rt_runtime.settings import SettingsError
from tests.support.channel_host.object_stores import FakeStore
from tests.support.channel_host.s3_server import BUCKET, S3Server, s3_server


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[S3Server]:
    with s3_server(tmp_path_factory.mktemp("s3")) as running:
        yield running


@pytest.fixture(params=["memory", "folder", "s3"])
def store(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> SegmentStore:
    if request.param == "memory":
        return FakeStore()
    if request.param == "folder":
        return OpenedStore(f"file://{tmp_path}/a folder")
    return opened(request.getfixturevalue("server"), monkeypatch, tmp_path.name)


def opened(server: S3Server, monkeypatch: pytest.MonkeyPatch, prefix: str) -> OpenedStore:
    for name, value in server.environment.items():
        monkeypatch.setenv(name, value)
    return OpenedStore(f"s3://{BUCKET}/{prefix}")


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
async def test_a_store_with_conditional_puts_passes_the_check_again_and_again(store: SegmentStore) -> None:
    await check_store(store)
    await check_store(store)


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


@pytest.mark.asyncio
async def test_the_error_for_a_missing_bucket_is_clear(server: S3Server, monkeypatch: pytest.MonkeyPatch) -> None:
    opened(server, monkeypatch, "x")
    with pytest.raises(SettingsError, match="s3://no-such-bucket/x"):
        await check_store(OpenedStore("s3://no-such-bucket/x"))


@pytest.mark.asyncio
async def test_a_store_that_cannot_be_reached_is_logged_and_does_not_end_the_host(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    store = FakeStore()
    store.failure = "connection refused"
    await check_store(store)
    assert "cannot be reached" in caplog.text


@pytest.mark.asyncio
async def test_a_store_that_overwrites_is_refused() -> None:
    class Overwriting(FakeStore):
        async def create(self, name: str, content: bytes | bytearray) -> bool:
            self.objects[name] = bytes(content)
            return True

    with pytest.raises(SettingsError, match="If-None-Match"):
        await check_store(Overwriting())


@pytest.mark.asyncio
async def test_the_error_for_a_folder_without_write_permission_is_clear(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("no folder")
    with pytest.raises(StoreError, match=r"file://.*file"):
        OpenedStore(f"file://{tmp_path}/file/below")
