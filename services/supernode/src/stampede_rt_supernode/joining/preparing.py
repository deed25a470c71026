"""`stampede supernode init` and `join`: prepare the data folder of a supernode, once."""

from __future__ import annotations

import argparse
import os
import secrets
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from stampede_rt.administration.options import add_cluster_options
from stampede_rt.administration.output_forms import add_output, json_text
from stampede_rt.administration.running_cluster import reached
from stampede_rt.cluster.addresses import is_loopback
from stampede_rt.errors import StampedeError
from stampede_rt.escaping import TerminalParser, escaped
from stampede_rt.security.tls import CLIENT_VARIABLES
from stampede_rt.values.policy import parse_name
from stampede_rt_runtime.values import parse_address, parse_address_text, parse_target
from stampede_rt_runtime.written import naming
from stampede_rt_supernode.joining.founding import ANYWHERE, FoundingRecord, check_unused, restoring, write_founding
from stampede_rt_supernode.joining.join_tokens import VALID_NANOS_DEFAULT, log_cluster_of
from stampede_rt_supernode.replica import DirectoryReplica
from stampede_rt_supernode.replication import Member, ReleaseTooOld, StoreDamaged, StoreRefused, restore_from

# The verbs of this module.
PREPARING = ("init", "join")
# The exit codes of a failure, and of wrong arguments.
FAILED, MISUSED = 1, 2
# The length of the random part of an id that the user did not choose.
ID_BYTES = 4


def prepare(argv: Sequence[str]) -> int:
    """Run one of the verbs in PREPARING. Returns the exit code."""
    parser = TerminalParser(prog="stampede supernode", description=__doc__)
    verbs = parser.add_subparsers(required=True, metavar="VERB")
    init = verbs.add_parser(
        "init", help="found a cluster of one supernode", description="Found a cluster of one supernode. Do this once."
    )
    init.set_defaults(run=_run_init)
    init.add_argument(
        "--restore",
        type=Path,
        metavar="PATH",
        help="take over the directory of a backup (see `stampede supernode snapshot`), or a lost member's folder",
    )
    init.add_argument(
        "--take-over",
        action="store_true",
        help="with --restore: the former cluster will never run again; its hosts and front-ends join the new one",
    )
    join = verbs.add_parser("join", help="join a cluster", description="Join a running cluster under a new id.")
    join.set_defaults(run=_run_join)
    add_cluster_options(join)
    join.add_argument("--token", help="the token of `stampede supernode add`; without it the command asks for one")
    for verb in (init, join):
        verb.add_argument("--data-dir", type=Path, required=True, metavar="DIR", help="the new folder of the log")
        verb.add_argument("--listen", required=True, metavar="HOST:PORT", help="the supernode listens at this address")
        verb.add_argument(
            "--advertise", metavar="HOST:PORT", help="others reach the supernode at this address; default: --listen"
        )
        verb.add_argument("--id", help="the supernode's id, never used before; default: a random id")
        add_output(verb)
    parsed = parser.parse_args(argv)
    try:
        return int(parsed.run(parsed))
    except (StampedeError, ValueError) as error:
        sys.stderr.write(f"stampede supernode: {escaped(str(error))}\n")
        return FAILED if isinstance(error, StampedeError) else MISUSED
    except OSError as error:  # after StampedeError, because Unavailable is an OSError, too
        if error.filename is None:
            raise  # the caller explains errors of the output
        sys.stderr.write(f"stampede supernode: {escaped(str(error.filename))} cannot be used: {error.strerror}\n")
        return FAILED


def _run_init(arguments: argparse.Namespace) -> int:
    check_unused(arguments.data_dir)
    name, address = _name(arguments), _address(arguments)
    cluster_id = secrets.token_hex(16)
    founding = FoundingRecord(supernode_id=name, address=address, members={name: address}, log_cluster_id=cluster_id)
    if arguments.take_over and arguments.restore is None:
        raise ValueError("--take-over needs --restore: without it there is no former cluster")
    if arguments.restore is not None:
        with naming(arguments.data_dir), restoring(arguments.data_dir):
            founding = _restored(arguments, founding)
            write_founding(arguments.data_dir, founding)
    else:
        write_founding(arguments.data_dir, founding)
    _done(arguments, founding, f"Cluster {cluster_id} is founded, with supernode {name}.")
    return 0


def _restored(arguments: argparse.Namespace, founding: FoundingRecord) -> FoundingRecord:
    """Take over the directory of a backup or of a lost member's folder."""
    founder = Member(member_id=founding.supernode_id, address=founding.address)
    try:
        index = restore_from(
            arguments.restore,
            arguments.data_dir,
            DirectoryReplica(),
            founder=founder,
            cluster_id=founding.log_cluster_id,
        )
    except ReleaseTooOld as error:
        raise StampedeError(
            f"{arguments.restore} holds a directory at feature level {error.cluster_level}, and this release knows "
            f"level {error.highest_level}: restore it with the release that wrote it, or a later one"
        ) from error
    except (StoreDamaged, StoreRefused) as error:
        raise StampedeError(str(error)) from error
    if arguments.output == "table":
        _print(f"Everything that {arguments.restore} holds is taken over, up to log position {index}.")
    return replace(founding, started=True, takes_over=arguments.take_over)


def _run_join(arguments: argparse.Namespace) -> int:
    check_unused(arguments.data_dir)
    name, address = _name(arguments), _address(arguments)
    with reached(arguments.url, arguments.member) as cluster:
        listed = cluster.members().supernodes
        token = arguments.token or cluster.make_token(name, address, valid_nanos=VALID_NANOS_DEFAULT).token
    members = {record.supernode_id: record.endpoint.target for record in listed}
    if name in members:
        raise StampedeError(f"{name} is a member already; give a new id, also to a supernode that has lost its folder")
    _check_callable(address, members)
    founding = FoundingRecord(
        supernode_id=name,
        address=address,
        members=members,
        log_cluster_id=log_cluster_of(token),
        joining=True,
        token=token,
    )
    write_founding(arguments.data_dir, founding)
    others = ", ".join(members)
    text = f"Supernode {name} is ready to join the cluster of {others}. They check its token when it starts."
    _done(arguments, founding, text)
    return 0


def _done(arguments: argparse.Namespace, founding: FoundingRecord, text: str) -> None:
    """Print the outcome and the command that starts the supernode."""
    if arguments.output == "table":
        _print(f"{text} Start this supernode:", "", _start(arguments))
        if not (_is_secured() or is_loopback(arguments.listen)):
            _print(
                "", "Add its certificate (--tls-ca ...), or, on a network that you trust, --allow-insecure-anywhere."
            )
        return
    facts = {"supernode": founding.supernode_id, "address": founding.address, "cluster_id": founding.log_cluster_id}
    facts |= {"data_dir": str(arguments.data_dir), "start": _start(arguments)}
    sys.stdout.write(json_text(facts, arguments.output) + "\n")


def _check_callable(address: str, members: Mapping[str, str]) -> None:
    """Raises ValueError if members on other machines could not call the newcomer, or the newcomer could not
    call them.
    """
    on_other_machines = [f"{name} at {target}" for name, target in members.items() if not is_loopback(target)]
    if on_other_machines and is_loopback(address):
        raise ValueError(
            f"{address} can be called only from its own machine, and other members are on "
            f"other machines ({', '.join(on_other_machines)}); give --listen or --advertise the address at which they "
            "reach this supernode"
        )
    here = [f"{name} at {target}" for name, target in members.items() if is_loopback(target)]
    if here and not is_loopback(address):
        raise ValueError(
            f"{', '.join(here)} can be called only from its own machine, so a supernode at {address} cannot reach it; "
            "create the cluster again, with an address that all machines can call (stampede supernode init --advertise)"
        )


def _print(*lines: str) -> None:
    sys.stdout.write("".join(escaped(line) + "\n" for line in lines))


def _name(arguments: argparse.Namespace) -> str:
    return parse_name(arguments.id or f"supernode-{secrets.token_hex(ID_BYTES)}", "supernode")


def _address(arguments: argparse.Namespace) -> str:
    """The address at which others reach the supernode. Raises ValueError."""
    listen = _read("--listen", parse_address_text, arguments.listen)
    option = "--advertise" if arguments.advertise else "--listen"
    address = _read(option, parse_target, arguments.advertise or listen)
    if parse_address(address).host in ANYWHERE:
        raise ValueError(
            f"no caller can reach {address}; say with --advertise HOST:PORT where others reach this supernode"
        )
    return address


def _read(option: str, parse: Callable[[str], str], text: str) -> str:
    try:
        return parse(text)
    except ValueError as error:
        raise ValueError(f"{option} must be {error}") from error


def _start(arguments: argparse.Namespace) -> str:
    advertise = f" --advertise {arguments.advertise}" if arguments.advertise else ""
    # The service reads other environment variables than this command, so the text names the flags.
    tls = " --tls-ca FILE --tls-certificate FILE --tls-key FILE" if _is_secured() else ""
    return f"  stampede supernode --listen {arguments.listen}{advertise} --data-dir {arguments.data_dir}{tls}"


def _is_secured() -> bool:
    return any(os.environ.get(name) for name in CLIENT_VARIABLES)
