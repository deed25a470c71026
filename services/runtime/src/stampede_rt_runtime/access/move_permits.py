"""The permit with which the owner of a channel or queue lets one other host become its owner. Pure.

The owner and the directory know the key (`RegisterHostRequest.move_key`). No other host can make a permit of the owner.
A permit is for one epoch. The next owner has another epoch, and so has the same owner after a failed move.
"""

from __future__ import annotations

import hmac

KEY_BYTES = 32
PERMIT_BYTES = 32
_PURPOSE = b"stampede move"


def move_permit(key: bytes, subject_id: bytes, epoch: int, to_host_id: bytes) -> bytes:
    """The permit for the host `to_host_id` to own that channel or queue after this epoch.

    Both ids have 16 bytes. `epoch` is the epoch of the present owner.
    """
    return hmac.digest(key, _PURPOSE + subject_id + epoch.to_bytes(8, "big") + to_host_id, "sha256")


def is_permit(permit: bytes, key: bytes, subject_id: bytes, epoch: int, to_host_id: bytes) -> bool:
    """Whether `move_permit` makes the same permit."""
    return hmac.compare_digest(permit, move_permit(key, subject_id, epoch, to_host_id))
