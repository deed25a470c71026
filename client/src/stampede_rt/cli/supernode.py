"""`stampede supernode status|add|remove|snapshot`: look at a running cluster's supernodes, and take care of them."""

from __future__ import annotations

import argparse
import secrets
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from stampede_rt.administration.options import add_cluster_options
from stampede_rt.administration.running_cluster import Cluster, is_there, no_member, reached
from stampede_rt.cli.backup_file import write_backup
from stampede_rt.cli.diagnosis import gathered, level_finding, refusal
from stampede_rt.cli.output import print_facts, print_rows
from stampede_rt.errors import StampedeError, Unavailable
from stampede_rt.v1.directory_pb2 import SupernodeRecord
from stampede_rt.values.timeline import format_duration, format_instant

FAILED = 1
LEADER, FOLLOWER = SERVING = ("leader", "follower")
TOKEN_HOURS_MAX = 24
ID_BYTES = 4


def administer(argv: Sequence[str]) -> int:
    """Run one of ADMINISTRATIVE_VERBS; returns the exit code."""
    parser = argparse.ArgumentParser(prog="stampede supernode", description=__doc__)
    verbs = parser.add_subparsers(required=True, metavar="VERB")
    status = _verb(verbs, "status", "who is a member, who leads, and how they do", _run_status)
    add = _verb(verbs, "add", "make a token that lets one supernode in, and say how to use it", _run_add)
    add.add_argument("address", metavar="HOST:PORT", help="where it will listen, and the members will reach it")
    add.add_argument("--id", help="its name among the members, never used before; left out: a random one")
    add.add_argument("--valid-hours", type=_hours, default=1.0, metavar="HOURS", help="how long it can be used; 1")
    remove = _verb(verbs, "remove", "remove a supernode for ever", _run_remove)
    remove.add_argument("id", help="its id, see `stampede supernode status`")
    snapshot = _verb(verbs, "snapshot", "have a supernode write a snapshot now, and fetch it as a backup", run_snapshot)
    snapshot.add_argument("id", nargs="?", help="the supernode; left out: the leader")
    snapshot.add_argument("--out", type=Path, metavar="FILE", help="write a backup there, for `init --restore`")
    snapshot.add_argument(
        "--stale-ok", action="store_true", help="what this replica holds will do; works without a majority, too"
    )
    for each in (status, add, remove, snapshot):
        add_cluster_options(each)
    parsed = parser.parse_args(argv)
    try:
        return int(parsed.run(parsed))
    except StampedeError as error:
        print(f"stampede supernode: {error.message}", file=sys.stderr)
        return FAILED
    except OSError as error:
        file = error.filename or parsed.out  # an open file does not know its name
        print(f"stampede supernode: {file} cannot be written: {error.strerror}", file=sys.stderr)
        return FAILED


def _hours(text: str) -> float:
    try:
        hours = float(text)
    except ValueError:
        hours = 0.0
    if not 0 < hours <= TOKEN_HOURS_MAX:  # not a number is neither
        raise argparse.ArgumentTypeError(f"{text!r}; allowed: more than 0, and at most {TOKEN_HOURS_MAX}")
    return hours


def _verb(verbs: Any, name: str, text: str, run: Callable[[argparse.Namespace], int]) -> argparse.ArgumentParser:
    parser: argparse.ArgumentParser = verbs.add_parser(name, help=text, description=text)
    parser.set_defaults(run=run)
    parser.add_argument("-o", "--output", choices=("table", "json"), default="table", help="the form")
    return parser


def _run_status(arguments: argparse.Namespace) -> int:
    with reached(arguments.url, arguments.member) as cluster:
        listed = cluster.members()
        pongs = {record.supernode_id: _ping(cluster, record) for record in listed.supernodes}
    # Not what a copy of a member says at the address of another one.
    heard = (pong for name, (pong, _) in pongs.items() if pong and pong.supernode_id == name)
    refused = gathered(pong.refused_supernodes for pong in heard)
    rows = [_row(record, *pongs[record.supernode_id], refused, arguments.output) for record in listed.supernodes]
    print_rows(rows, arguments.output, none="no supernode")
    serving = sum(row["state"] in SERVING for row in rows)
    enough = 2 * serving > len(rows)
    if arguments.output == "table":
        verdict = "a majority serves" if enough else f"no majority: start supernodes until {len(rows) // 2 + 1} serve"
        print(f"\n{serving} of {len(rows)} serve; {verdict}. Term {listed.term}.")
        levels = {row["supernode"]: row["highest_feature_level"] for row in rows}
        print(_level_line(max(_cluster_levels(pongs), default=listed.feature_level), levels))
        for name, why in sorted(refused.items()):
            print(f"{name} is refused: {refusal(why)[1]}.")
        if serving < len(rows):
            print("`stampede doctor` says why the others do not.")
    return 0 if enough else FAILED


def _cluster_levels(pongs: Mapping[str, tuple[Any, int | None]]) -> list[int]:
    """The cluster's feature level, as each one that answers has it; it never falls, so that the highest holds."""
    return [pong.feature_level for pong, _ in pongs.values() if pong is not None]


def _level_line(level: int, highest: Mapping[str, int | None]) -> str:
    state, advice = level_finding(level, highest)
    return f"Feature level {state}{'; ' if advice else ''}{advice}."


def _ping(cluster: Cluster, record: SupernodeRecord) -> tuple[Any, int | None]:
    """What it says of itself, and how long that took; None if it says nothing."""
    began = time.monotonic_ns()
    pong = cluster.ping(record.endpoint.target)
    return pong, time.monotonic_ns() - began if pong is not None else None


def _row(
    record: SupernodeRecord, pong: Any, nanos: int | None, refused: Mapping[str, str], form: str
) -> dict[str, Any]:
    return {
        "supernode": record.supernode_id,
        "address": record.endpoint.target,
        "state": refusal(refused[record.supernode_id])[0] if record.supernode_id in refused else _state(record, pong),
        "round_trip": format_duration(nanos) if nanos is not None and form == "table" else nanos,
        "version": pong.version if pong is not None else None,
        "highest_feature_level": _highest_level(record, pong),
    }


def _highest_level(record: SupernodeRecord, pong: Any) -> int | None:
    """What it says itself, or has told the one that lists it; None: it has not told."""
    said = pong.highest_feature_level if pong is not None and is_there(record, pong) else 0
    return said or record.highest_feature_level or None


def _state(record: SupernodeRecord, pong: Any) -> str:
    if pong is None:
        return "down"
    if not is_there(record, pong):
        return f"{pong.supernode_id} is there"
    if not pong.ready:
        return "no leader"
    return LEADER if record.is_leader else FOLLOWER


def _run_add(arguments: argparse.Namespace) -> int:
    with reached(arguments.url, arguments.member) as cluster:
        name = arguments.id or f"supernode-{secrets.token_hex(ID_BYTES)}"
        made = cluster.make_token(name, arguments.address, valid_nanos=round(arguments.valid_hours * 3600 * 1e9))
        known = ",".join(one.endpoint.target for one in cluster.members().supernodes)
        is_secured = cluster.is_secured
    command = (
        f"stampede supernode join --member {known} --token {made.token} --id {name} --listen {arguments.address} "
        "--data-dir DIR"
    )
    if arguments.output == "json":
        print_facts({"token": made.token, "id": name, "cluster_id": made.cluster_id, "join": command}, "json")
        return 0
    until = format_instant(made.valid_until_unix_nano // 10**9 * 10**9).replace(".000000000", "")
    print(f"The token lets supernode {name} in, at {arguments.address}, once, until {until}.")
    if is_secured:
        print("It needs a certificate of its own, named there in $STAMPEDE_TLS_CA, ..._CERTIFICATE and ..._KEY:\n")
        host = arguments.address.rpartition(":")[0]
        print(f"  stampede certs issue --role supernode --name {name} --address {host}\n")
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
        raise no_member(supernode_id, members)
    known = ", ".join(member.supernode_id for member in members)
    raise Unavailable(f"nobody leads; name one of {known}, and say --stale-ok, for what it holds by itself")
