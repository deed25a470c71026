"""Questions to what the directory holds about access. Pure."""

from __future__ import annotations

from functools import lru_cache

from stampede_rt_runtime.access import tokens
from stampede_rt_runtime.access.state import AccessState
from stampede_rt_supernode.core.state import DirectoryState


def access_state(directory: DirectoryState) -> AccessState:
    """What ports must know to judge callers. Without what signs tokens."""
    access = directory.access
    return AccessState(
        version=access.version,
        cluster_id=directory.cluster_id,
        rules=access.rules,
        token_keys=(_public_key(access.token_key),) if access.token_key else (),
    )


@lru_cache(4)
def _public_key(token_key: bytes) -> bytes:
    return tokens.public_key(token_key)
