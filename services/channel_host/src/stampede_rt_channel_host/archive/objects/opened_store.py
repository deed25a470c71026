"""One object store (S3, Google Cloud Storage, Azure, a folder), as an archive uses it. Needs the extra `objects`.

obstore was chosen because it reaches all these stores by one interface, creates objects without overwriting, and its
wheels need no other package.
"""

from __future__ import annotations

import asyncio
import errno
import os
import re
from collections.abc import Iterator, Sequence
from datetime import timedelta
from pathlib import Path
from urllib.parse import unquote, urlsplit

import obstore
from obstore import exceptions
from obstore.store import ObjectStore, from_url

from stampede_rt_channel_host.archive.objects.segment_store import FoundObject, StoreError

CONNECT_SECONDS_MAX = 5
READ_SECONDS_MAX = 10  # for one request, and for its retries
UPLOAD_SECONDS_MAX = 600
OBJECTS_PER_PAGE = 1000
_TEXT_MAX = 300
# client_options replace these variables, which obstore reads
_ALLOW_HTTP = {"s3": "AWS_ALLOW_HTTP", "gs": "GOOGLE_ALLOW_HTTP", "az": "AZURE_ALLOW_HTTP"}
_NO_OBJECT = ("NoSuchKey", "BlobNotFound", "PathNotFound", "ResourceNotFound")
_REFUSED = (
    exceptions.PermissionDeniedError, exceptions.UnauthenticatedError, exceptions.UnknownConfigurationKeyError,
    FileNotFoundError,  # no such bucket or user
)  # fmt: skip


class OpenedStore:
    """The objects below a URL such as `s3://bucket/prefix`. The credentials come from the environment of the store.

    Raises StoreError if the URL or a variable of the environment is not valid.
    """

    def __init__(self, url: str) -> None:
        self.url = url
        self._folder = Path(unquote(urlsplit(url).path)) if urlsplit(url).scheme == "file" else None
        self._reading, self._writing = self._opened(READ_SECONDS_MAX), self._opened(UPLOAD_SECONDS_MAX)

    def _opened(self, seconds_max: int) -> ObjectStore:
        try:
            if self._folder is not None:
                return from_url(self.url, mkdir=True)
            retries = 2 if seconds_max == READ_SECONDS_MAX else 0
            return from_url(
                self.url,
                client_options={
                    "timeout": timedelta(seconds=seconds_max),
                    "connect_timeout": timedelta(seconds=CONNECT_SECONDS_MAX),
                    "allow_http": any(_is_set(name) for name in _ALLOW_HTTP.values()),
                },
                retry_config={"max_retries": retries, "retry_timeout": timedelta(seconds=READ_SECONDS_MAX)},
            )  # fmt: skip
        except (exceptions.BaseError, ValueError, OSError) as error:
            raise self._failed(error, is_refusal=True) from None

    def _failed(self, error: BaseException, *, is_refusal: bool = False) -> StoreError:
        return StoreError(
            f"the object store {self.url} says: {_short(error, self.url)}", is_refusal=is_refusal or _refuses(error)
        )

    async def create(self, name: str, content: bytes | bytearray) -> bool:
        """See `SegmentStore`."""
        try:
            await obstore.put_async(self._writing, name, content, mode="create", use_multipart=False)
        except exceptions.AlreadyExistsError:
            return False
        except (exceptions.BaseError, OSError, ValueError) as error:
            raise self._failed(error) from None
        if self._folder is not None:
            await asyncio.to_thread(_sync, self._folder / name)
        return True

    def read(self, name: str, offset: int, size: int) -> bytes:
        """See `SegmentStore`."""
        if not size:
            return b""
        try:
            return bytes(obstore.get_range(self._reading, name, start=offset, length=size))
        except FileNotFoundError as error:
            if not _lacks_object(error):
                raise self._failed(error) from None
            raise FileNotFoundError(errno.ENOENT, f"the object store {self.url} has no object {name}") from error
        except (exceptions.BaseError, OSError, ValueError) as error:
            raise self._failed(error) from None

    def find(self, prefix: str) -> Iterator[FoundObject]:
        """See `SegmentStore`."""
        try:
            for page in obstore.list(self._reading, prefix, chunk_size=OBJECTS_PER_PAGE):
                yield from (FoundObject(one["path"], one["size"]) for one in page)
        except (exceptions.BaseError, OSError, ValueError) as error:
            raise self._failed(error) from None

    def delete(self, names: Sequence[str]) -> None:
        """See `SegmentStore`."""
        for name in names:  # not all stores can delete several objects with one request
            try:
                obstore.delete(self._reading, name)
            except FileNotFoundError as error:
                if not _lacks_object(error):
                    raise self._failed(error) from None
            except (exceptions.BaseError, OSError, ValueError) as error:
                raise self._failed(error) from None


def _is_set(name: str) -> bool:
    return os.environ.get(name, "").lower() in ("true", "1")


def _refuses(error: BaseException) -> bool:
    words = ("InvalidAccessKeyId", "SignatureDoesNotMatch", "AccessDenied", "NoSuchBucket", "builder error")
    return isinstance(error, _REFUSED) or any(word in str(error) for word in words)


def _code_and_message(error: BaseException) -> tuple[str, str] | None:
    """The code and the message in the answer of a store; None: the error has no such answer."""
    found = re.search(r"<Code>(.*?)</Code>.*?<Message>(.*?)</Message>", str(error), re.DOTALL)
    return None if found is None else (found[1], found[2].partition("\n")[0].rstrip(". "))


def _lacks_object(error: FileNotFoundError) -> bool:
    """Whether the store has no such object. False: it has no such bucket, or does not know the caller."""
    answer = _code_and_message(error)
    return answer is None or answer[0] in _NO_OBJECT


def _short(error: BaseException, url: str) -> str:
    """The text of an error: one line, without queries of URLs, which may have credentials, and without long paths."""
    text, answer = str(error).partition("\n\n")[0], _code_and_message(error)
    place = re.search(r"https?://[^/\s]+", text)
    if answer is not None:
        text = f"{answer[0]}: {answer[1]}{'' if place is None else f' ({place[0]})'}"
    text = re.sub(r"(https?://[^/\s]+/)[^\s\"')]*", r"\1...", text)
    text = re.sub(r"\?[^\s\"')]*", "?...", text)
    allow = _ALLOW_HTTP.get(url.partition("://")[0], "AWS_ALLOW_HTTP")
    text = text.replace("builder error", f"the endpoint is http://, and {allow} is not true")
    return " ".join(text.split())[:_TEXT_MAX]


def _sync(path: Path) -> None:
    """Bring a file and its name to stable storage. Blocks for a moment."""
    for one in (path, path.parent):
        handle = os.open(one, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
