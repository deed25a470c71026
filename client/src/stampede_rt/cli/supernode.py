"""`stampede supernode status|add|remove|snapshot`: look at a running cluster's supernodes, and take care of them."""

from __future__ import annotations

import argparse
import os
import secrets
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import grpc

from stampede_rt._sync.ports import Ports
from stampede_rt.cli.backup_file import write_backup
from stampede_rt.cli.output import print_facts, print_rows
from stampede_rt.connecting import parse_target
from stampede_rt.errors import NotLeader, Overloaded, StampedeError, Unavailable
from stampede_rt.status import from_rpc_error
from stampede_rt.timeline import format_duration, format_instant
from stampede_rt.tls_diagnosis import explain_refusal
from stampede_rt.transports.grpc_sync import Port
from stampede_rt.v1 import directory_service_pb2 as directory_pb
from stampede_rt.v1 import frontend_service_pb2 as frontend_pb
from stampede_rt.v1 import membership_service_pb2 as pb
from stampede_rt.v1 import membership_service_pb2_grpc
from stampede_rt.v1.directory_pb2 import SupernodeRecord
from stampede_rt.version import PROTOCOL_VERSION, VERSION

ADMINISTERING = ("status", "add", "remove", "snapshot")
FAILED = 1
LEADER, FOLLOWER = SERVING = ("leader", "follower")
CALL_SECONDS = 3.0
CHANGE_SECONDS = 30.0
LEADERLESS_SECONDS = 8.0  # an election takes 4 s at most
SNAPSHOT_SECONDS = 120.0
BACKOFF_SECONDS = 0.5


def add_place(parser: argparse.ArgumentParser) -> None:
    """The options that say where the cluster is."""
    place = parser.add_mutually_exclusive_group()
    place.add_argument("--url", "--frontend", metavar="HOST:PORT,...", help="front-ends; default $STAMPEDE_URL")
    place.add_argument("--member", metavar="HOST:PORT,...", help="supernodes, if no front-end runs")


def administer(argv: Sequence[str]) -> int:
    """Run one of ADMINISTERING; returns the exit code."""
    parser = argparse.ArgumentParser(prog="stampede supernode", description=__doc__)
    verbs = parser.add_subparsers(required=True, metavar="VERB")
    status = _verb(verbs, "status", "who is a member, who leads, and how they do", _run_status)
    add = _verb(verbs, "add", "make a token that lets one supernode in, and say how to use it", _run_add)
    add.add_argument("--valid-hours", type=float, default=1.0, metavar="HOURS", help="how long it can be used; 1")
    remove = _verb(verbs, "remove", "remove a supernode for ever", _run_remove)
    remove.add_argument("id", help="its id, see `stampede supernode status`")
    snapshot = _verb(verbs, "snapshot", "have a supernode write a snapshot now, and fetch it as a backup", run_snapshot)
    snapshot.add_argument("id", nargs="?", help="the supernode; left out: the leader")
    snapshot.add_argument("--out", type=Path, metavar="FILE", help="write a backup there, for `init --restore`")
    snapshot.add_argument(
        "--stale-ok", action="store_true", help="what this replica holds will do; works without a majority, too"
    )
    for each in (status, add, remove, snapshot):
        add_place(each)
    parsed = parser.parse_args(argv)
    try:
        return int(parsed.run(parsed))
    except StampedeError as error:
        print(f"stampede supernode: {error.message}", file=sys.stderr)
        return FAILED
    except OSError as error:
        print(f"stampede supernode: {error.filename} cannot be written: {error.strerror}", file=sys.stderr)
        return FAILED


def _verb(verbs: Any, name: str, text: str, run: Callable[[argparse.Namespace], int]) -> argparse.ArgumentParser:
    parser: argparse.ArgumentParser = verbs.add_parser(name, help=text, description=text)
    parser.set_defaults(run=run)
    parser.add_argument("-o", "--output", choices=("table", "json"), default="table", help="the form")
    return parser


class Cluster:
    """The supernodes of a running cluster, reached by any of the addresses given."""

    def __init__(self, ports: Ports, addresses: list[str]) -> None:
        self._ports = ports
        self._addresses = addresses

    @property
    def is_secured(self) -> bool:
        """Whether the caller has a certificate."""
        return self._ports.credentials.tls is not None

    def members(self) -> directory_pb.ListSupernodesResponse:
        """The members, as the first supernode that answers knows them. Raises Unavailable."""
        listed: directory_pb.ListSupernodesResponse = self._first(
            lambda port: port.call(port.directory.ListSupernodes, _LIST, CALL_SECONDS)
        )
        return listed

    def ping(self, address: str) -> Any:
        """What a supernode says of itself; None if it says nothing."""
        port = self._ports.to(address)
        try:
            return port.call(port.directory.Ping, directory_pb.DirectoryServicePingRequest(), CALL_SECONDS)
        except StampedeError:
            return None

    def make_token(self, *, valid_nanos: int) -> pb.CreateJoinTokenResponse:
        """A token that lets one supernode in."""
        request = pb.CreateJoinTokenRequest(request_id=secrets.token_bytes(16), valid_nanos=valid_nanos)
        made: pb.CreateJoinTokenResponse = self._first(
            lambda port: port.call(_membership(port).CreateJoinToken, request, CALL_SECONDS)
        )
        return made

    def remove(self, supernode_id: str) -> pb.RemoveSupernodeResponse:
        """Remove a member by whoever leads. Raises what the leader refuses it with, or Unavailable if none does."""
        request, began = pb.RemoveSupernodeRequest(supernode_id=supernode_id), time.monotonic()
        known, patience = self.members().supernodes, LEADERLESS_SECONDS
        if supernode_id not in {one.supernode_id for one in known}:
            raise _no_member(supernode_id, known)
        waiting = self._leader_first(known)
        while waiting:
            port = self._ports.to(waiting[0])
            try:
                removed: pb.RemoveSupernodeResponse = port.call(
                    _membership(port).RemoveSupernode, request, CALL_SECONDS
                )
            except (NotLeader, Overloaded, Unavailable) as error:
                leader = error.metadata.get("leader_endpoint")
                patience = CHANGE_SECONDS if leader or isinstance(error, Overloaded) else patience
                if time.monotonic() - began > patience:
                    raise _leaderless(known) if patience == LEADERLESS_SECONDS else error from error
                waiting = [*waiting[1:], waiting[0]]
                if leader:
                    waiting = [leader, *(one for one in waiting if one != leader)]
                time.sleep(BACKOFF_SECONDS)
            else:
                return removed
        raise _leaderless(known)

    def _leader_first(self, known: Sequence[SupernodeRecord]) -> list[str]:
        """Where the members are that answer there."""
        there = [one for one in known if _is_there(one, self.ping(one.endpoint.target))]
        return [one.endpoint.target for one in sorted(there, key=lambda one: not one.is_leader)]

    def snapshot(self, address: str, *, include_data: bool, stale_ok: bool) -> Iterator[pb.TakeSnapshotResponse]:
        """What the supernode at `address` answers, part by part. Raises StampedeError."""
        port = self._ports.to(address)
        request = pb.TakeSnapshotRequest(include_data=include_data, stale_ok=stale_ok)
        responses = port.call(_membership(port).TakeSnapshot, request, SNAPSHOT_SECONDS)
        try:
            yield from responses
        except grpc.RpcError as error:
            raise from_rpc_error(error, f"the supernode at {address}") from error

    def _first(self, ask: Callable[[Port], Any]) -> Any:
        return _first(self._ports, self._addresses, ask)


_LIST = directory_pb.ListSupernodesRequest()


def _first(ports: Ports, addresses: Sequence[str], ask: Callable[[Port], Any]) -> Any:
    """What the first of them that answers says. Raises why the last one does not, certificates among the reasons."""
    failure: StampedeError = Unavailable("no supernode is known")
    for address in addresses:
        try:
            return ask(ports.to(address))
        except Unavailable as error:
            failure = explain_refusal(address, ports.credentials.tls, seconds=CALL_SECONDS) or error
        except StampedeError as error:
            failure = error
    raise failure


def _is_there(record: SupernodeRecord, pong: Any) -> bool:
    """Whether that member has answered, and not another one at its address."""
    return pong is not None and pong.supernode_id == record.supernode_id


def _no_member(supernode_id: str, known: Sequence[SupernodeRecord]) -> StampedeError:
    names = ", ".join(one.supernode_id for one in known)
    return StampedeError(f"no member is called {supernode_id}; there are {names}")


def _leaderless(known: Sequence[SupernodeRecord]) -> Unavailable:
    return Unavailable(
        f"nobody leads, and only a leader lets a member go: start supernodes until {len(known) // 2 + 1} of "
        f"{', '.join(one.supernode_id for one in known)} serve"
    )


@contextmanager
def reached(frontend: str | None, member: str | None) -> Iterator[Cluster]:
    """The cluster behind front-ends or supernodes. Raises StampedeError."""
    target = parse_target(member or frontend or os.environ.get("STAMPEDE_URL"), name=None, secret=None, zone=None)
    ports = Ports(target.credentials)
    try:
        addresses = list(target.frontends) if member else _bound(ports, target.frontends)
        yield Cluster(ports, addresses)
    finally:
        ports.close()


def _bound(ports: Ports, frontends: Sequence[str]) -> list[str]:
    request = frontend_pb.BindRequest(protocol_version=PROTOCOL_VERSION, version=VERSION)
    bound = _first(ports, frontends, lambda port: port.call(port.frontend.Bind, request, CALL_SECONDS))
    return [one.endpoint.target for one in bound.supernodes]


def _membership(port: Port) -> Any:
    return port.stub(membership_service_pb2_grpc.MembershipServiceStub)


def _run_status(arguments: argparse.Namespace) -> int:
    with reached(arguments.url, arguments.member) as cluster:
        listed = cluster.members()
        rows = [_row(cluster, record, arguments.output) for record in listed.supernodes]
    print_rows(rows, arguments.output, none="no supernode")
    serving = sum(row["state"] in SERVING for row in rows)
    enough = 2 * serving > len(rows)
    if arguments.output == "table":
        verdict = "a majority serves" if enough else f"no majority: start supernodes until {len(rows) // 2 + 1} serve"
        print(f"\n{serving} of {len(rows)} serve; {verdict}. Term {listed.term}.")
        if serving < len(rows):
            print("`stampede doctor` says why the others do not.")
    return 0 if enough else FAILED


def _row(cluster: Cluster, record: Any, form: str) -> dict[str, Any]:
    began = time.monotonic_ns()
    pong = cluster.ping(record.endpoint.target)
    nanos = time.monotonic_ns() - began if pong is not None else None
    return {
        "supernode": record.supernode_id,
        "address": record.endpoint.target,
        "state": _state(record, pong),
        "round_trip": format_duration(nanos) if nanos is not None and form == "table" else nanos,
        "version": pong.version if pong is not None else None,
    }


def _state(record: SupernodeRecord, pong: Any) -> str:
    if pong is None:
        return "down"
    if not _is_there(record, pong):
        return f"{pong.supernode_id} is there"
    if not pong.ready:
        return "no leader"
    return LEADER if record.is_leader else FOLLOWER


def _run_add(arguments: argparse.Namespace) -> int:
    with reached(arguments.url, arguments.member) as cluster:
        made = cluster.make_token(valid_nanos=round(arguments.valid_hours * 3600 * 1e9))
        known = ",".join(one.endpoint.target for one in cluster.members().supernodes)
        is_secured = cluster.is_secured
    command = f"stampede supernode join --member {known} --token {made.token} --data-dir DIR --listen HOST:PORT"
    command += " --id ID" if is_secured else ""
    if arguments.output == "json":
        print_facts({"token": made.token, "cluster_id": made.cluster_id, "join": command}, "json")
        return 0
    print(f"The token lets one supernode in, until {format_instant(made.valid_until_unix_nano)}.")
    if is_secured:
        print("It needs a certificate of its own, named there in $STAMPEDE_TLS_CA, ..._CERTIFICATE and ..._KEY:\n")
        print("  stampede certs issue --role supernode --name ID --address HOST\n")
    print(f"On its machine, run:\n\n  {command}")
    return 0


def _run_remove(arguments: argparse.Namespace) -> int:
    with reached(arguments.url, arguments.member) as cluster:
        removed = cluster.remove(arguments.id)
    remaining = [record.supernode_id for record in removed.supernodes]
    if arguments.output == "json":
        print_facts({"removed": arguments.id, "supernodes": remaining, "index": removed.index}, "json")
    else:
        print(f"{arguments.id} is no member any more; there remain {', '.join(remaining)}.")
    return 0


def run_snapshot(arguments: argparse.Namespace) -> int:
    """Have a snapshot written, and fetch it if a file is named."""
    with reached(arguments.url, arguments.member) as cluster:
        address = _address_of(cluster.members().supernodes, arguments.id)
        responses = cluster.snapshot(address, include_data=arguments.out is not None, stale_ok=arguments.stale_ok)
        taken = next(responses) if arguments.out is None else write_backup(responses, arguments.out)
    facts = {
        "supernode": taken.supernode_id,
        "index": taken.log_index,
        "size_bytes": taken.size_bytes,
        "time": taken.time_unix_nano if arguments.output == "json" else format_instant(taken.time_unix_nano),
        "took": taken.took_nanos if arguments.output == "json" else format_duration(taken.took_nanos),
    }
    if arguments.out is not None:
        facts |= {"backup": str(arguments.out), "sha256": taken.sha256.hex()}
    print_facts(facts, arguments.output)
    return 0


def _address_of(members: Sequence[SupernodeRecord], supernode_id: str | None) -> str:
    """Where to ask: at the member with that id, or the leader. Raises StampedeError."""
    for member in members:
        if member.supernode_id == supernode_id or (supernode_id is None and member.is_leader):
            return member.endpoint.target
    if supernode_id is not None:
        raise _no_member(supernode_id, members)
    known = ", ".join(member.supernode_id for member in members)
    raise Unavailable(f"nobody leads; name one of {known}, and say --stale-ok, for what it holds by itself")
