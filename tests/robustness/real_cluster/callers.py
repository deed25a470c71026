"""Callers that record their calls, and hosts that keep leases and act on the directory's answers."""

from __future__ import annotations

import asyncio
import random
import time
from typing import Any

import grpc

from stampede_rt.errors import LeaseExpired, StampedeError
from stampede_rt.status import DETAILS_KEY, from_rpc_error
from stampede_rt.v1 import channel_pb2, directory_pb2
from stampede_rt.v1 import directory_service_pb2 as pb
from stampede_rt_channel_host.cluster.host_lease import HostLease
from stampede_rt_runtime.identity import Role
from tests.robustness.histories.channel_model import Delete, DeletedChannel, Open, Refusal, Resolve, SeenChannel, Update
from tests.robustness.histories.operations import Recorder
from tests.robustness.real_cluster.cluster import Cluster, request_id

ATTEMPT_SECONDS, CALL_SECONDS = 1.5, 8.0
FINAL_REASONS = frozenset(("CHANNEL_NOT_FOUND", "WRONG_EPOCH"))
NAMES_IN_USE, NAMES_CHANGE_SECONDS = 6, 4.0


class TwoOwners(AssertionError):
    """Two hosts acted as the owner of one channel at the same moment."""


class NotDone(Exception):
    """The call certainly had no effect."""


class Unknown(Exception):
    """The call may have had its effect."""


async def persist(
    cluster: Cluster,
    method: str,
    request: Any,
    rng: random.Random,
    *,
    seconds: float = CALL_SECONDS,
    who: tuple[Role, str] = (Role.CLIENT, "caller"),
) -> Any:
    """Make one call at one supernode after the other, each time with the same request.

    Raises StampedeError if the directory refuses the call with one of FINAL_REASONS, otherwise NotDone or Unknown.
    """
    deadline, unknown = time.monotonic() + seconds, False
    nodes = rng.sample(cluster.supernodes, len(cluster.supernodes))
    turn = 0
    while (left := deadline - time.monotonic()) > 0:
        node, turn = nodes[turn % len(nodes)], turn + 1
        try:
            return await getattr(node.stub_for(*who), method)(request, timeout=min(left, ATTEMPT_SECONDS))
        except grpc.aio.AioRpcError as error:
            answered = any(key == DETAILS_KEY for key, _ in error.trailing_metadata() or ())
            refusal = from_rpc_error(error, node.name)
            if answered and refusal.reason in FINAL_REASONS:
                raise refusal from error
            unknown |= not answered or refusal.reason not in ("NO_QUORUM", "NO_HOST", "NOT_LEADER")
        await asyncio.sleep(rng.uniform(0.02, 0.3))
    raise Unknown if unknown else NotDone


class Caller:
    """One caller, which makes one call at a time. It knows only the answers to its own calls."""

    def __init__(self, number: int, cluster: Cluster, recorder: Recorder, hosts: list[HostActor], seed: int) -> None:
        self._cluster, self._recorder, self._hosts = cluster, recorder, hosts
        self._random_source = random.Random(f"{seed}-{number}")
        self._value = 1_000_000 * (number + 1)
        self._seen: dict[str, SeenChannel] = {}
        self.not_done = 0

    async def run(self, began: float, pause_s: float = 0.05) -> None:
        """Call until cancelled."""
        while True:
            age = int((time.monotonic() - began) / NAMES_CHANGE_SECONDS)
            await self.once(f"robust/{age}-{self._random_source.randrange(NAMES_IN_USE)}")
            await asyncio.sleep(self._random_source.uniform(0, 2 * pause_s))

    async def once(self, name: str) -> None:
        """Make one random call about a name. Record the call, unless it certainly had no effect."""
        call, invoked = self._choose(name), time.monotonic()
        try:
            answer = await self._answer(name, call)
        except StampedeError as error:
            self._recorder.done(name, call, invoked, Refusal(error.reason))
            self._seen.pop(name, None)
        except NotDone:
            self.not_done += 1
        except (Unknown, asyncio.CancelledError) as error:
            self._recorder.ambiguous(name, call, invoked)
            if isinstance(error, asyncio.CancelledError):
                raise
        else:
            self._recorder.done(name, call, invoked, answer)
            if isinstance(answer, SeenChannel):
                self._seen[name] = answer
            else:
                self._seen.pop(name, None)

    def _choose(self, name: str) -> Open | Resolve | Update | Delete:
        chance, seen = self._random_source.random(), self._seen.get(name)
        if seen is None or chance < 0.15:
            return Open(0) if chance < 0.7 else Resolve()
        if chance < 0.5:
            return Resolve()
        if chance > 0.95:
            return Delete(seen.channel_id)
        self._value += 1
        return Update(seen.channel_id, seen.epoch, self._value)

    async def _answer(self, name: str, call: Open | Resolve | Update | Delete) -> SeenChannel | DeletedChannel:
        invoked = time.monotonic()
        match call:
            case Open():
                request = pb.OpenChannelRequest(request_id=request_id(), name=name, create=True)
                opened = await persist(self._cluster, "OpenChannel", request, self._random_source)
                self._check_owner(opened, invoked)
                return seen_in(opened.channel, created=opened.created)
            case Resolve():
                found = await persist(
                    self._cluster, "ResolveChannel", pb.ResolveChannelRequest(name=name), self._random_source
                )
                self._check_owner(found, invoked)
                return seen_in(found.channel)
            case Update(channel_id=channel_id, epoch=epoch, value=value):
                spec = channel_pb2.ChannelSpec(retention=channel_pb2.RetentionPolicy(max_items=value))
                change = pb.UpdateChannelRequest(request_id=request_id(), channel_id=channel_id, epoch=epoch, spec=spec)
                return seen_in((await persist(self._cluster, "UpdateChannel", change, self._random_source)).channel)
            case Delete(channel_id=channel_id):
                forget = pb.DeleteChannelRequest(request_id=request_id(), channel_id=channel_id)
                await persist(self._cluster, "DeleteChannel", forget, self._random_source)
                return DeletedChannel()

    def _check_owner(self, answer: Any, invoked: float) -> None:
        for host in self._hosts:
            host.note_owner(answer.channel, invoked)


def seen_in(record: channel_pb2.ChannelRecord, *, created: bool = False) -> SeenChannel:
    """The facts about a channel that an answer showed."""
    value = record.spec.retention.max_items  # 0: no limit is stated; the directory refuses a limit of 0
    return SeenChannel(record.channel_id, record.epoch, value, record.spec_version, created)


class HostActor:
    """A host without items: it registers, keeps its lease by the product's rules, and acts on the answers that it gets.

    It runs in the process of the callers. So `note_owner` can compare an answer with the host's lease at the same
    moment.
    """

    def __init__(self, number: int, cluster: Cluster, seed: int) -> None:
        self.host_id = (number + 1).to_bytes(16, "big")
        self._name = f"robust-host-{number}"
        self._boot = random.Random(f"boot-{seed}-{number}").getrandbits(64) | 1
        self._cluster = cluster
        self._random_source = random.Random(f"host-{seed}-{number}")
        self._lease = HostLease()
        self._owned: dict[bytes, int] = {}
        self._entered = 0.0
        self.registrations = self.renewals = self.fenced = 0

    def note_owner(self, record: channel_pb2.ChannelRecord, asked_s: float) -> None:
        """Process a record that a caller got from the directory. `asked_s`: the beginning of the call.

        Raises TwoOwners if the record names another owner while this host still serves the channel. The host takes a
        channel over only if the call began after its registration, because earlier answers may be out of date.
        """
        epoch = self._owned.get(record.channel_id)
        if record.host_id != self.host_id and epoch is not None and epoch < record.epoch and self._held():
            raise TwoOwners(f"{self._name} still serves {record.name} at epoch {epoch}, not at epoch {record.epoch}")
        newer = epoch is None or epoch < record.epoch
        if record.host_id == self.host_id and newer and self._held() and self._entered <= asked_s:
            self._owned[record.channel_id] = record.epoch

    def _held(self) -> bool:
        return self._lease.is_held(_boottime())

    async def run(self) -> None:
        """Register and renew until cancelled. Sometimes miss renewals for longer than a lease lasts."""
        while True:
            try:
                await (self._renew() if self.registrations and self._held() else self._enter())
            except LeaseExpired:
                self._lease.give_up()
            except (NotDone, Unknown, StampedeError, grpc.aio.AioRpcError):
                self.fenced += not self._held()
            absent = self._random_source.random() < 0.01
            pause_s = (
                self._random_source.uniform(2.5, 5.0) if absent else self._lease.renewal_in_nanos(_boottime()) / 1e9
            )
            await asyncio.sleep(max(0.05, pause_s))

    async def _enter(self) -> None:
        request = pb.RegisterHostRequest(
            request_id=request_id(),
            host_id=self.host_id,
            name=self._name,
            gatekeepers=[directory_pb2.Endpoint(target="localhost:1")],
            boot_incarnation=self._boot,
        )
        sent = _boottime()
        who = (Role.HOST, self._name)
        entered = await persist(self._cluster, "RegisterHost", request, self._random_source, seconds=4.0, who=who)
        self._owned = {record.channel_id: record.epoch for record in entered.channels}
        self._lease.granted(sent_nanos=sent, ttl_nanos=entered.lease_ttl_nanos)
        self._entered = time.monotonic()
        self.registrations += 1

    async def _renew(self) -> None:
        request = pb.RenewHostLeaseRequest(host_id=self.host_id, boot_incarnation=self._boot)
        for node in self._random_source.sample(self._cluster.supernodes, len(self._cluster.supernodes)):
            sent = _boottime()
            try:
                renewed = await node.stub_for(Role.HOST, self._name).RenewHostLease(request, timeout=0.6)
            except grpc.aio.AioRpcError as error:
                refusal = from_rpc_error(error, node.name)
                if isinstance(refusal, LeaseExpired):
                    raise refusal from error
                continue
            self._lease.granted(sent_nanos=sent, ttl_nanos=renewed.lease_ttl_nanos)
            self.renewals += 1
            return


def _boottime() -> int:
    return time.clock_gettime_ns(time.CLOCK_BOOTTIME)
