"""A process that runs from a copy of a supernode's data folder finds that out at the supernode's own address."""

from __future__ import annotations

from typing import Any

import pytest

from stampede_rt.errors import StampedeError
from stampede_rt.v1 import directory_service_pb2 as pb
from stampede_rt.v1 import directory_service_pb2_grpc
from stampede_rt_runtime.dial import dial
from stampede_rt_runtime.server import serving
from stampede_rt_supernode.joining.copied_folder import FINDINGS_NEEDED, OwnAddress


class AnsweringSupernode(directory_service_pb2_grpc.DirectoryServiceServicer):
    """Answers each ping with the next of `pongs`, and repeats the last one."""

    def __init__(self, *pongs: tuple[str, str, int]) -> None:
        self._pongs = list(pongs)
        self.pings = 0

    async def Ping(self, request: Any, context: Any) -> pb.DirectoryServicePingResponse:  # noqa: N802
        supernode_id, cluster_id, boot = self._pongs[min(self.pings, len(self._pongs) - 1)]
        self.pings += 1
        return pb.DirectoryServicePingResponse(supernode_id=supernode_id, cluster_id=cluster_id, boot_incarnation=boot)


async def watched(one: AnsweringSupernode, looks_max: int = 20) -> str:
    """Return the finding of a process with boot incarnation 7, of supernode s1 in cluster "c".

    "itself": the process reaches itself. "copy": it runs from a copy. "looks": it has found nothing yet.
    """
    looks = 0

    async def count(seconds: float) -> None:
        nonlocal looks
        looks += 1
        if looks >= looks_max:
            raise TimeoutError

    add = directory_service_pb2_grpc.add_DirectoryServiceServicer_to_server
    async with serving(lambda server: add(one, server)) as server:
        own = OwnAddress("s1", server.address, 7, lambda target: dial(target, secret=None))
        try:
            await own.watch(lambda: "c", sleep=count)
        except StampedeError as error:
            return "copy" if f"supernode s1 runs at {server.address} already" in error.message else error.message
        except TimeoutError:
            return "looks"
    return "itself"


ITSELF, ORIGINAL = ("s1", "c", 7), ("s1", "c", 8)
OTHER_MEMBER, OTHER_CLUSTER = ("s2", "c", 9), ("s1", "d", 10)


@pytest.mark.parametrize(
    ("pongs", "outcome"),
    [
        ([ITSELF], "itself"),
        ([ORIGINAL], "copy"),
        ([ORIGINAL] * (FINDINGS_NEEDED - 1) + [ITSELF], "itself"),
        ([OTHER_MEMBER], "looks"),
        ([OTHER_CLUSTER], "looks"),
        ([ORIGINAL, OTHER_MEMBER] * 4 + [ITSELF], "itself"),
        ([OTHER_MEMBER, ORIGINAL], "copy"),
    ],
)
async def test_the_process_that_answers_at_the_supernodes_address_is_the_supernode(
    pongs: list[tuple[str, str, int]], outcome: str
) -> None:
    assert await watched(AnsweringSupernode(*pongs)) == outcome


async def test_a_supernode_starts_even_if_its_address_does_not_answer() -> None:
    async with serving(lambda server: None) as server:
        address = server.address
    await OwnAddress("s1", address, 7, lambda target: dial(target, secret=None)).check()


async def test_a_copy_ends_before_its_start_after_one_answer_of_the_supernode() -> None:
    add = directory_service_pb2_grpc.add_DirectoryServiceServicer_to_server
    async with serving(lambda server: add(AnsweringSupernode(ORIGINAL), server)) as server:
        with pytest.raises(StampedeError, match="another process with a copy of its folder; delete this copy"):
            await OwnAddress("s1", server.address, 0, lambda target: dial(target, secret=None)).check()
