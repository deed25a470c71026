"""Writes a backup to a file. If the backup is incomplete or damaged, writes no file."""

from __future__ import annotations

import hashlib
import os
import secrets
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from stampede_rt.errors import StampedeError
from stampede_rt.v1 import membership_service_pb2 as pb

SHA256_BYTES = 32


def write_backup(responses: Iterator[pb.TakeSnapshotResponse], out: Path) -> pb.TakeSnapshotResponse:
    """Write the backup in `responses` to `out`. Only the user who owns the file can read it.

    Returns the first response, which describes the backup. If `out` exists, the function replaces it when the new file
    is complete and on the disk. Raises OSError, StampedeError for a damaged backup, and the errors of `responses`.
    """
    if out.exists() and not out.is_file():
        raise StampedeError(f"{out} is not a regular file, and a backup would replace it; name a file with --out")
    draft = out.parent / f".{out.name}.{secrets.token_hex(4)}"
    descriptor = os.open(draft, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    try:
        with os.fdopen(descriptor, "wb") as file:
            facts = next(responses)
            _copy(responses, facts, file)
            file.flush()
            os.fsync(file.fileno())
        draft.replace(out)
    except StampedeError:  # some of these are OSErrors, too
        raise
    except OSError as error:  # an error of an open file has no file name
        raise OSError(error.errno, error.strerror, str(out)) from error
    finally:
        draft.unlink(missing_ok=True)
    return facts


def _copy(responses: Iterator[pb.TakeSnapshotResponse], facts: pb.TakeSnapshotResponse, file: BinaryIO) -> None:
    # The file ends with the SHA-256 of the bytes before it.
    digest, tail, size_bytes = hashlib.sha256(), b"", 0
    for response in responses:
        file.write(response.data)
        size_bytes += len(response.data)
        joined = tail + response.data
        digest.update(joined[:-SHA256_BYTES])
        tail = joined[-SHA256_BYTES:]
    if size_bytes != facts.size_bytes or not digest.digest() == tail == facts.sha256:
        raise StampedeError(
            f"the received backup is damaged: it has {size_bytes} of {facts.size_bytes} bytes, or a wrong checksum; "
            "try again"
        )
