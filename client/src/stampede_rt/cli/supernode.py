"""`stampede supernode status|add|remove|snapshot`: shows and changes the supernodes of a running cluster."""

from __future__ import annotations

import argparse
import secrets
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from stampede_rt.administration.options import add_cluster_options
from stampede_rt.administration.output_forms import add_output
from stampede_rt.administration.running_cluster import Cluster, is_there, no_member, reached
from stampede_rt.cli.backup_file import write_backup
from stampede_rt.cli.exit_statuses import FAILED
from stampede_rt.cli.instants import instant_text
from stampede_rt.cli.output import print_done, print_facts, print_rows
from stampede_rt.cli.supernode_findings import IN_DOUBT, WAITS_FOR_DISK, gathered, level_finding, refusal
from stampede_rt.cluster.cluster_ids import IN_MEMORY
from stampede_rt.errors import StampedeError, Unavailable
from stampede_rt.escaping import TerminalParser, escaped
from stampede_rt.v1.directory_pb2 import SupernodeRecord
from stampede_rt.values.timeline import format_duration

LEADER, FOLLOWER = SERVING = ("leader", "follower")
TOKEN_HOURS_MAX = 24  # the longest validity of a token for a joining supernode
IN_MEMORY_ADVICE = (
    "This cluster is kept only in memory, and ends with its processes. If {names} should be of another cluster, start "
    "{names} again with --data-dir."
)
ID_BYTES = 4  # the length of a random supernode id


def administer(argv: Sequence[str]) -> int:
    """Run one of ADMINISTRATIVE_VERBS and return the exit status."""
    parser = TerminalParser(prog="stampede supernode", description=__doc__)
    verbs = parser.add_subparsers(required=True, metavar="VERB")
    status = _verb(verbs, "status", "list the supernodes, which one leads, and their state", _run_status)
    add = _verb(verbs, "add", "make a token that lets one supernode join, and print the command for it", _run_add)
    add.add_argument("address", metavar="HOST:PORT", help="the new supernode's address; the others must reach it there")
    add.add_argument("--id", help="the supernode's id, never used before; default: a random id")
    add.add_argument(
        "--valid-hours",
        type=_hours,
        default=1.0,
        metavar="HOURS",
        help="the hours for which the token is valid; default 1",
    )
    remove = _verb(verbs, "remove", "remove a supernode permanently; its id is never used again", _run_remove)
    remove.add_argument("id", help="the supernode's id, see `stampede supernode status`")
    snapshot = _verb(
        verbs, "snapshot", "make a supernode write a snapshot now; with --out fetch it as a backup", run_snapshot
    )
    snapshot.add_argument("id", nargs="?", help="the supernode's id; default: the leader")
    snapshot.add_argument(
        "--out", type=Path, metavar="FILE", help="write a backup to FILE, for `stampede supernode init --restore`"
    )
    snapshot.add_argument(
        "--stale-ok", action="store_true", help="take this supernode's own state; works without a majority"
    )
    for each in (status, add, remove, snapshot):
        add_cluster_options(each)
    parsed = parser.parse_args(argv)
    try:
        return int(parsed.run(parsed))
    except StampedeError as error:
        print(f"stampede supernode: {escaped(error.message)}", file=sys.stderr)
        return FAILED
    except OSError as error:
        if error.filename is None:
            raise  # the caller explains errors of the output
        print(escaped(f"stampede supernode: {error.filename} cannot be written: {error.strerror}"), file=sys.stderr)
        return FAILED


def _hours(text: str) -> float:
    try:
        hours = float(text)
    except ValueError:
        hours = 0.0
    if not 0 < hours <= TOKEN_HOURS_MAX:  # also refuses NaN
        raise argparse.ArgumentTypeError(
            f"{text!r} cannot be used; write a number of hours above 0, at most {TOKEN_HOURS_MAX}"
        )
    return hours


def _verb(verbs: Any, name: str, text: str, run: Callable[[argparse.Namespace], int]) -> argparse.ArgumentParser:
    parser: argparse.ArgumentParser = verbs.add_parser(name, help=text, description=text)
    parser.set_defaults(run=run)
    add_output(parser)
    return parser


def _run_status(arguments: argparse.Namespace) -> int:
    with reached(arguments.url, arguments.member) as cluster:
        listed = cluster.members()
        own_id = cluster.cluster_id
        pongs = {record.supernode_id: _ping(cluster, record) for record in listed.supernodes}
    # Leave out an answer at a member's address that comes from a copy of another member's folder.
    own_pongs = (pong for name, (pong, _) in pongs.items() if pong and pong.supernode_id == name)
    own_pongs = (pong for pong in own_pongs if pong.cluster_id in ("", own_id))
    refused = gathered(pong.refused_supernodes for pong in own_pongs)
    rows = [
        _row(record, *pongs[record.supernode_id], refused, own_id, arguments.output) for record in listed.supernodes
    ]
    print_rows(rows, arguments.output, none="no supernode")
    serving = sum(row["state"] in (*SERVING, IN_DOUBT) for row in rows)
    enough = 2 * serving > len(rows)
    if arguments.output == "table":
        verdict = "a majority serves" if enough else f"no majority: start supernodes until {len(rows) // 2 + 1} serve"
        cluster_id = escaped(own_id) or "not founded yet"
        print(f"\n{serving} of {len(rows)} serve; {verdict}. Term {listed.term}. Cluster {cluster_id}.")
        if own_id.startswith(IN_MEMORY):
            print(IN_MEMORY_ADVICE.format(names=escaped(", ".join(sorted(pongs)))))
        levels = {row["supernode"]: row["highest_feature_level"] for row in rows}
        print(escaped(_level_line(max(_cluster_levels(pongs), default=listed.feature_level), levels)))
        for name, why in sorted(refused.items()):
            state, advice = refusal(why)
            shown = state if state in (IN_DOUBT, WAITS_FOR_DISK) else "refused"
            print(escaped(f"{name} is {shown}: {advice}."))
        if serving < len(rows):
            print("`stampede doctor` says why the others do not.")
    return 0 if enough else FAILED


def _cluster_levels(pongs: Mapping[str, tuple[Any, int | None]]) -> list[int]:
    """Return the cluster's feature level as each supernode that answers knows it.

    The highest one is the present level.
    """
    return [pong.feature_level for pong, _ in pongs.values() if pong is not None]


def _level_line(level: int, highest: Mapping[str, int | None]) -> str:
    state, advice = level_finding(level, highest)
    return f"Feature level {state}{'; ' if advice else ''}{advice}."


def _ping(cluster: Cluster, record: SupernodeRecord) -> tuple[Any, int | None]:
    """Return the supernode's answer and the round trip in nanoseconds; None for both if it does not answer."""
    began = time.monotonic_ns()
    pong = cluster.ping(record.endpoint.target)
    return pong, time.monotonic_ns() - began if pong is not None else None


def _row(
    record: SupernodeRecord, pong: Any, nanos: int | None, refused: Mapping[str, str], own_id: str, output_format: str
) -> dict[str, Any]:
    why = refused.get(record.supernode_id)
    return {
        "supernode": record.supernode_id,
        "address": record.endpoint.target,
        "state": refusal(why)[0] if why else _state(record, pong, own_id),
        "round_trip": format_duration(nanos) if nanos is not None and output_format == "table" else nanos,
        "version": pong.version if pong is not None else None,
        "highest_feature_level": _highest_level(record, pong),
    }


def _highest_level(record: SupernodeRecord, pong: Any) -> int | None:
    """Return the highest level of the supernode's release, from its own answer or from the list; None if not known."""
    level = pong.highest_feature_level if pong is not None and is_there(record, pong) else 0
    return level or record.highest_feature_level or None


def _is_stranger(pong: Any, own_id: str) -> bool:
    return bool(own_id) and pong.cluster_id not in ("", own_id)


def _state(record: SupernodeRecord, pong: Any, own_id: str) -> str:
    if pong is None:
        return "down"
    if not is_there(record, pong):
        return f"{pong.supernode_id} is there"
    if _is_stranger(pong, own_id):
        return "of another cluster"
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
    if arguments.output != "table":
        print_facts({"token": made.token, "id": name, "cluster_id": made.cluster_id, "join": command}, arguments.output)
        return 0
    valid_until = instant_text(made.valid_until_unix_nano // 10**9 * 10**9).replace(".000000000", "")
    print(escaped(f"The token lets supernode {name} join at {arguments.address}, once, until {valid_until}."))
    if is_secured:
        print("The supernode needs a certificate of its own. On its machine, name the certificate's files in")
        print("$STAMPEDE_TLS_CA, ..._CERTIFICATE and ..._KEY. This command makes the certificate:\n")
        host = arguments.address.rpartition(":")[0]
        print(f"  {escaped(f'stampede certs issue --role supernode --name {name} --address {host}')}\n")
    print(f"On the machine of the supernode, run:\n\n  {escaped(command)}")
    return 0


def _run_remove(arguments: argparse.Namespace) -> int:
    with reached(arguments.url, arguments.member) as cluster:
        removed = cluster.remove(arguments.id)
    remaining = [record.supernode_id for record in removed.supernodes]
    done = {"removed": arguments.id, "supernodes": remaining, "index": removed.index}
    text = f"{arguments.id} is no longer a member; the members are {', '.join(remaining)}."
    print_done(done, text, arguments.output)
    return 0


def run_snapshot(arguments: argparse.Namespace) -> int:
    """Make a supernode write a snapshot, and fetch it if the command names a file."""
    with reached(arguments.url, arguments.member) as cluster:
        address = _address_of(cluster.members().supernodes, arguments.id)
        responses = cluster.snapshot(address, include_data=arguments.out is not None, stale_ok=arguments.stale_ok)
        taken = next(responses) if arguments.out is None else write_backup(responses, arguments.out)
    facts = {
        "supernode": taken.supernode_id,
        "index": taken.log_index,
        "size_bytes": taken.size_bytes,
        "time": taken.time_unix_nano if arguments.output != "table" else instant_text(taken.time_unix_nano),
        "took": taken.took_nanos if arguments.output != "table" else format_duration(taken.took_nanos),
    }
    if arguments.out is not None:
        facts |= {"backup": str(arguments.out), "sha256": taken.sha256.hex()}
    print_facts(facts, arguments.output)
    return 0


def _address_of(members: Sequence[SupernodeRecord], supernode_id: str | None) -> str:
    """Return the address of the member `supernode_id`, or of the leader if the id is None. Raises StampedeError."""
    for member in members:
        if member.supernode_id == supernode_id or (supernode_id is None and member.is_leader):
            return member.endpoint.target
    if supernode_id is not None:
        raise no_member(supernode_id, members)
    known = ", ".join(member.supernode_id for member in members)
    raise Unavailable(f"no supernode leads; name one of {known} with --stale-ok to get its own state")
