"""The store of objects as an archive sees it. `opened_store` has the stores of obstore."""

from __future__ import annotations

import asyncio
import errno
import logging
from collections.abc import Iterator, Sequence
from typing import NamedTuple, Protocol

from stampede_rt_runtime.settings import SettingsError

logger = logging.getLogger(__name__)

MARKER = "stampede-archive"
CHECK_SECONDS_MAX = 5.0
_VARIABLES = {
    "s3": "AWS_ACCESS_KEY_ID, AWS_SECRET_ACCESS_KEY, AWS_REGION and AWS_ENDPOINT_URL",
    "gs": "GOOGLE_SERVICE_ACCOUNT (the path of a key file) and GOOGLE_SERVICE_ACCOUNT_KEY (its content)",
    "az": "AZURE_STORAGE_ACCOUNT_NAME, AZURE_STORAGE_ACCOUNT_KEY and AZURE_STORAGE_SAS_TOKEN",
}


class StoreError(OSError):
    """The object store failed. `is_refusal`: a repetition would fail, too."""

    def __init__(self, text: str, *, is_refusal: bool = False) -> None:
        super().__init__(errno.EIO, text)
        self.is_refusal = is_refusal


class LaterOwner(StoreError):
    """The object store has files of a later owner of the channel."""


class FoundObject(NamedTuple):
    """An object of a store, with its whole name below the prefix."""

    name: str
    bytes: int


class SegmentStore(Protocol):
    """A store of objects below a prefix. Its methods raise StoreError. All of them block, except `create`."""

    url: str

    async def create(self, name: str, content: bytes | bytearray) -> bool:
        """Make an object; False: one with this name exists, and stays as it is."""
        ...

    def read(self, name: str, offset: int, size: int) -> bytes:
        """Bytes of an object; fewer at its end. Raises FileNotFoundError if there is no such object."""
        ...

    def find(self, prefix: str) -> Iterator[FoundObject]:
        """The objects below a prefix, a name that ends with "/"."""
        ...

    def delete(self, names: Sequence[str]) -> None:
        """Delete objects. Ignores missing ones."""
        ...


def advice(url: str) -> str:
    """The advice for an operator if the store at this URL refuses the host."""
    variables = _VARIABLES.get(url.partition("://")[0])
    if variables is None:
        return "look at the folder, and at the rights of this user"
    return f"look at the bucket, its policy, and the variables with the credentials, such as {variables}"


async def check_store(store: SegmentStore) -> None:
    """Check that the store makes and lists objects, and that it overwrites none.

    Raises SettingsError if the store refuses a request or overwrites an object. If the store cannot be reached now,
    only logs this.
    """
    try:
        async with asyncio.timeout(CHECK_SECONDS_MAX):
            await store.create(MARKER, b"Stampede RT keeps archives of channels here.\n")
            overwrites = await store.create(MARKER, b"")
            await asyncio.to_thread(lambda: next(store.find("channels/"), None))
    except (StoreError, TimeoutError) as error:
        why = f"the object store {store.url} does not answer" if isinstance(error, TimeoutError) else error.strerror
        if isinstance(error, StoreError) and error.is_refusal:
            raise SettingsError(f"--archive: {why}; {advice(store.url)}") from error
        logger.error(
            "the object store of the archive cannot be reached; the host tries again",
            extra={"event": "archive_store_failed", "why": why},
        )
        return
    if overwrites:
        raise SettingsError(
            f"--archive: the object store {store.url} overwrites objects although the host asks it not to "
            "(If-None-Match); use a store with conditional puts"
        )
