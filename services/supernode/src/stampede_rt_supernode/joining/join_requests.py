"""Asks the members to let this supernode join, until it is a member. Runs after `stampede supernode join`."""

from __future__ import annotations

import asyncio
import logging
import random
from collections.abc import Awaitable, Callable
from dataclasses import replace
from pathlib import Path

import grpc

from stampede_rt.errors import InvalidArgument, NotLeader, PermissionDenied, StampedeError, VersionMismatch
from stampede_rt.status import from_rpc_error
from stampede_rt.v1 import directory_pb2, membership_service_pb2_grpc
from stampede_rt.v1 import membership_service_pb2 as pb
from stampede_rt_runtime.version import software_version
from stampede_rt_supernode.core.cluster.feature_levels import HIGHEST_LEVEL
from stampede_rt_supernode.joining.founding import FoundingRecord, read_founding, write_founding
from stampede_rt_supernode.replication import ReplicatedLog

logger = logging.getLogger(__name__)

# The time in which a member must answer one request.
ATTEMPT_SECONDS = 30.0
# The pause between two requests. It doubles after each failure, up to the maximum.
PAUSE_SECONDS, PAUSE_SECONDS_MAX = 0.5, 10.0
# The longest wait before a supernode that the members have refused asks again.
REFUSED_SECONDS_MAX = 300
# The errors after which another attempt would fail, too.
_HOPELESS = (PermissionDenied, InvalidArgument, VersionMismatch)
NEWER_RELEASE = "start it with the release of the others and the same data folder; it then catches up with them"


async def ask_to_join(
    founding: FoundingRecord,
    data_dir: Path,
    log: ReplicatedLog,
    dial: Callable[[str], grpc.aio.Channel],
    *,
    zone: str,
    sleep: Callable[[float], Awaitable[None]] = asyncio.sleep,
) -> None:
    """Ask one member after the other until this supernode is a member. If a member names the leader, ask the leader.

    If the members have refused this supernode before, it first waits. The wait doubles with each refusal, because a
    supervisor may restart the process again and again. Raises StampedeError if a member refuses for a reason that
    another attempt would not change.
    """
    await _wait_after_refusals(founding, sleep)
    addresses = list(founding.members.values())
    pause_seconds, logged_message = PAUSE_SECONDS, ""
    while not _is_member(log):
        try:
            await _ask(addresses[0], founding, dial, zone=zone)
        except NotLeader as error:
            leader, pause_seconds = error.metadata.get("leader_endpoint", ""), PAUSE_SECONDS
            addresses = [leader, *(one for one in addresses if one != leader)] if leader else _next(addresses)
        except _HOPELESS as error:
            _note_refusal(data_dir, founding, error.message)
            raise _refused_for_good(error, data_dir) from error
        except StampedeError as error:
            if logged_message != error.message:
                logged_message = error.message
                logger.info(
                    "waiting for the members to let this supernode join",
                    extra={"event": "join_waits", "asked": addresses[0], "cause": logged_message},
                )
            addresses = _next(addresses)
            pause_seconds = min(2 * pause_seconds, PAUSE_SECONDS_MAX)
        await sleep(pause_seconds * random.uniform(0.5, 1.0))
    write_founding(data_dir, replace(founding, token="", started=True, refused="", refusals=0))
    logger.info("joined", extra={"event": "joined", "supernode": founding.supernode_id})


async def _wait_after_refusals(founding: FoundingRecord, sleep: Callable[[float], Awaitable[None]]) -> None:
    if founding.refused:
        pause_seconds = seconds_before_asking(founding.refusals)
        logger.warning(
            "the members refused this supernode before; it asks again in %.0f s: %s",
            pause_seconds,
            founding.refused,
            extra={"event": "join_refused"},
        )
        await sleep(pause_seconds)


def _refused_for_good(error: StampedeError, data_dir: Path) -> StampedeError:
    is_too_old = isinstance(error, VersionMismatch)
    remedy = NEWER_RELEASE if is_too_old else f"mend this, then empty {data_dir}, and join again"
    return StampedeError(f"this supernode cannot join: {error.message}; {remedy}")


def seconds_before_asking(refusals: int) -> float:
    """The seconds that a supernode with this number of refusals waits before it asks again."""
    return float(min(2 ** min(refusals - 1, 30), REFUSED_SECONDS_MAX)) if refusals else 0.0


def _note_refusal(data_dir: Path, founding: FoundingRecord, why: str) -> None:
    noted = read_founding(data_dir) or founding
    write_founding(data_dir, replace(noted, refused=why, refusals=founding.refusals + 1))


def _next(addresses: list[str]) -> list[str]:
    return [*addresses[1:], addresses[0]]


def _is_member(log: ReplicatedLog) -> bool:
    status = log.status()
    return any(member.member_id == status.self_id for member in status.members)


async def _ask(address: str, founding: FoundingRecord, dial: Callable[[str], grpc.aio.Channel], *, zone: str) -> None:
    request = pb.AddSupernodeRequest(
        supernode_id=founding.supernode_id,
        endpoint=directory_pb2.Endpoint(target=founding.address, zone=zone),
        token=founding.token,
        protocol_version=1,
        version=software_version(),
        highest_feature_level=HIGHEST_LEVEL,
    )
    channel = dial(address)
    try:
        stub = membership_service_pb2_grpc.MembershipServiceStub(channel)
        await stub.AddSupernode(request, timeout=ATTEMPT_SECONDS)
    except grpc.aio.AioRpcError as error:
        raise from_rpc_error(error, f"the supernode at {address}") from error
    finally:
        await channel.close()
