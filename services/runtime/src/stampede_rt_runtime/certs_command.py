"""`stampede certs`: makes the authority of a cluster and the certificates of its parts, and shows their contents."""

from __future__ import annotations

import argparse
import os
import re
import secrets
import socket
import sys
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, NamedTuple

from stampede_rt.administration.output_forms import json_text
from stampede_rt.errors import PermissionDenied, StampedeError
from stampede_rt.escaping import escaped
from stampede_rt_runtime.certificates import (
    CertificateContents,
    CertificateError,
    IssuedCertificate,
    cluster_of,
    describe,
    issue,
    make_authority,
    serial_text,
)
from stampede_rt_runtime.certs_parser import CERTIFICATE_DAYS, DEFAULT_FOLDER, parser_of
from stampede_rt_runtime.identity import SERVICES, Identity, Role
from stampede_rt_runtime.settings import EXIT_BAD_SETTINGS
from stampede_rt_runtime.written import naming

EXIT_FAILED = 1
_SOON = timedelta(days=30)  # `show` points out certificates that end within this time


def main(argv: Sequence[str] | None = None) -> int:
    """Run `stampede certs`. Returns the exit code: 0 done, 1 failed, 2 wrong usage."""
    try:
        arguments = parser_of(RUNS).parse_args(argv)
    except SystemExit as end:  # argparse has printed the reason
        return int(end.code or 0)
    try:
        _print(arguments.run(arguments), arguments.output)
    except (CertificateError, StampedeError, ValueError) as error:
        sys.stderr.write(f"stampede certs: {escaped(str(error))}\n")
        return EXIT_BAD_SETTINGS if isinstance(error, ValueError) else EXIT_FAILED
    except OSError as error:
        if error.filename is None:
            raise  # the caller explains errors of the output
        sys.stderr.write(f"stampede certs: {escaped(str(error.filename))} cannot be used: {error.strerror}\n")
        return EXIT_FAILED
    return 0


class VerbResult(NamedTuple):
    """The outcome of a verb: `lines` for people, and `facts` for programs."""

    lines: list[str]
    facts: dict[str, Any]


def _print(done: VerbResult, form: str) -> None:
    if form == "table":
        sys.stdout.writelines(escaped(line) + "\n" for line in done.lines)
    else:
        sys.stdout.write(json_text(done.facts, form) + "\n")


def _init(arguments: argparse.Namespace) -> VerbResult:
    folder: Path = arguments.folder
    Identity(arguments.cluster, Role.CLIENT, "any")  # checks the cluster's name
    made = make_authority(arguments.cluster, now=datetime.now(UTC), lifetime=timedelta(days=arguments.days))
    if (folder / "ca.key").exists():
        raise CertificateError(
            f"{folder} already has the key of an authority (ca.key); to make another authority, name another folder"
        )
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    certificate, key = write_pair(made, folder, "ca")
    lines = [
        f"{certificate}: the authority of cluster {arguments.cluster}; every part of the cluster needs this file",
        f"{key}: its private key; anyone who has it can enter the cluster; keep it in another place",
        "",
        f"Next, a certificate for each part: stampede certs issue{_from(folder)} --name NAME --role ROLE",
        f"(ROLE: {', '.join(Role)}; an operator adds and removes supernodes)",
    ]
    return VerbResult(lines, {"cluster": arguments.cluster, "certificate": str(certificate), "key": str(key)})


def _issue(arguments: argparse.Namespace) -> VerbResult:
    folder: Path = arguments.dir
    authority = _authority(folder)
    identity = Identity(cluster_of(authority.certificate), Role(arguments.role), arguments.name)
    addresses = tuple(arguments.address) or (_own_addresses() if identity.role in SERVICES else ())
    lifetime = arguments.ttl or timedelta(days=arguments.days or CERTIFICATE_DAYS)
    made = issue(authority, identity, addresses, now=datetime.now(UTC), lifetime=lifetime)
    out: Path = arguments.out or folder
    out.mkdir(mode=0o700, parents=True, exist_ok=True)
    certificate, key = write_pair(made, out, identity.file_stem)
    reached = f", called at {', '.join(addresses)}" if addresses else ""
    contents = describe(made.certificate)[0]
    valid_until = f"{contents.not_after:%Y-%m-%d %H:%M} UTC"
    lines = [f"{certificate}: {identity}{reached}, until {valid_until}", f"{key}: its private key", ""]
    lines += _how_to_use(identity, folder / "ca.pem", certificate, key)
    return VerbResult(lines, _facts(certificate, contents) | {"key": str(key)})


def _authority(folder: Path) -> IssuedCertificate:
    """The authority in a folder. Reads files. Raises CertificateError, OSError."""
    if not (folder / "ca.pem").exists() and not (folder / "ca.key").exists():
        raise CertificateError(
            f"there is no authority in {folder}; make one with `stampede certs init`, or name its folder with --dir"
        )
    return IssuedCertificate((folder / "ca.pem").read_bytes(), (folder / "ca.key").read_bytes())


def _renew(arguments: argparse.Namespace) -> VerbResult:
    """Renew certificates. Makes all new ones before it replaces any."""
    authority, now = _authority(arguments.dir), datetime.now(UTC)
    made = [(file, *_renewed(authority, file, now)) for file in arguments.files]
    lines, renewed = [], []
    for file, identity, issued in made:
        write_pair(issued, file.parent, file.stem)
        contents = describe(issued.certificate)[0]
        lines.append(f"{file}: {identity}, until {contents.not_after:%Y-%m-%d %H:%M} UTC")
        renewed.append(_facts(file, contents))
    return VerbResult(lines, {"certificates": renewed})


def _renewed(authority: IssuedCertificate, file: Path, now: datetime) -> tuple[Identity, IssuedCertificate]:
    """The owner of the certificate in `file`, and a new certificate for it. Raises CertificateError, OSError."""
    former = _described(file)[0]
    if former.identity is None or former.is_authority or file.suffix != ".pem":
        raise CertificateError(
            f"{file} is not the certificate of a part of a cluster; name a file NAME.pem of `stampede certs issue`"
        )
    if former.identity.cluster != cluster_of(authority.certificate):
        raise CertificateError(
            f"{file} is of cluster {former.identity.cluster}, but the authority is of cluster "
            f"{cluster_of(authority.certificate)}; name the folder of the right authority with --dir"
        )
    return former.identity, issue(authority, former.identity, former.addresses, now=now, lifetime=former.lifetime)


def _from(folder: Path) -> str:
    return "" if folder == DEFAULT_FOLDER else f" --dir {folder}"


def _how_to_use(identity: Identity, ca: Path, certificate: Path, key: Path) -> list[str]:
    if identity.role not in SERVICES:
        names = f"STAMPEDE_TLS_CA={ca} STAMPEDE_TLS_CERTIFICATE={certificate} STAMPEDE_TLS_KEY={key}"
        return [f"To use it: export {names}"]
    flag = {Role.SUPERNODE: "--id", Role.HOST: "--name"}.get(identity.role)
    named = f" {flag} {identity.name}" if flag else ""
    files = f"--tls-ca {ca} --tls-certificate {certificate} --tls-key {key}"
    use = [f"To use it: stampede {identity.role}{named} {files} ..."]
    if identity.role is Role.SUPERNODE:
        use.append(
            "The first one founds the cluster (stampede supernode init), and an operator lets in the others "
            "(stampede supernode add)."
        )
    return use


def _own_addresses() -> tuple[str, ...]:
    return tuple(dict.fromkeys((socket.gethostname(), "localhost", "127.0.0.1", "::1")))


def _show(arguments: argparse.Namespace) -> VerbResult:
    now = datetime.now(UTC)
    shown = [(file, one) for file in arguments.files for one in _described(file)]
    lines = [f"{file}: {_line(one, now)}" for file, one in shown]
    return VerbResult(lines, {"certificates": [_facts(file, one) for file, one in shown]})


def _facts(file: Path, one: CertificateContents) -> dict[str, Any]:
    return {
        "file": str(file),
        "subject": str(one.identity or one.subject),
        "role": str(one.identity.role) if one.identity else None,
        "is_authority": one.is_authority,
        "addresses": list(one.addresses),
        "not_before": round(one.not_before.timestamp()) * 10**9,
        "not_after": round(one.not_after.timestamp()) * 10**9,
        "issuer": str(one.issuer),
        "serial": serial_text(one.serial),
        "sha256": one.sha256,
    }


def _described(file: Path) -> list[CertificateContents]:
    """The contents of the certificates in `file`. Raises CertificateError, OSError."""
    try:
        return describe(file.read_bytes())
    except CertificateError as error:
        raise CertificateError(f"{file}: {error}") from error


def _revoke(arguments: argparse.Namespace) -> VerbResult:
    """Revoke the given certificates. If none is given, list all revoked serial numbers.

    The caller must prove the role `operator` by a certificate or token, or have the cluster's secret.
    """
    from stampede_rt.administration.running_cluster import reached  # not at the top: the other verbs need no gRPC

    serials = [serial_of(text) for text in arguments.credentials]
    with reached(arguments.url, None) as cluster:
        if not serials:
            listed = list(cluster.revoked_serials())
            return VerbResult(listed or ["no certificate or token is revoked"], {"revoked": listed})
        version = max([cluster.revoke(serial) for serial in serials])
        try:
            behind = [f"not in force yet at {name}: {why}" for name, why in cluster.parts_behind(version).items()]
        except PermissionDenied as own:
            behind = [own.message]
    lines = [f"{one} is revoked: the streams of its bearers end, and the services refuse it" for one in serials]
    return VerbResult(lines + behind, {"revoked": serials, "behind": behind})


def serial_of(text: str) -> str:
    """The serial number of a certificate. `text`: the number, or the file. Raises CertificateError, OSError."""
    if Path(text).is_file():
        return serial_text(_described(Path(text))[0].serial)
    # openssl prints capitals and a leading zero, and other programs print colons
    serial = text.replace(":", "").lower().lstrip("0")
    if re.fullmatch(r"[0-9a-f]{1,64}", serial) is None:
        raise CertificateError(f"{text!r} is neither a file nor a serial number in hexadecimal digits (see certs show)")
    return serial


def _line(one: CertificateContents, now: datetime) -> str:
    who = str(one.identity or one.subject)
    what = f"{who} (an authority)" if one.is_authority else who if one.identity else f"{who} (without a role)"
    where = f", called at {', '.join(one.addresses)}" if one.addresses else ""
    serial = serial_text(one.serial)
    return f"{what}{where}; {_validity(one, now)}; issued by {one.issuer}; serial {serial}; SHA-256 {one.sha256}"


def _validity(one: CertificateContents, now: datetime) -> str:
    if now < one.not_before:
        return f"NOT VALID BEFORE {one.not_before:%Y-%m-%d %H:%M} UTC"
    if now > one.not_after:
        return f"EXPIRED on {one.not_after:%Y-%m-%d %H:%M} UTC"
    soon = ", which is soon" if one.ends_soon(now, _SOON) else ""
    return f"valid until {one.not_after:%Y-%m-%d %H:%M} UTC{soon}"


def write_pair(made: IssuedCertificate, folder: Path, name: str) -> tuple[Path, Path]:
    """Write `name`.pem and `name`.key (mode 0600), each whole or not at all, and replace former files.

    Returns both paths.
    """
    certificate, key = folder / f"{name}.pem", folder / f"{name}.key"
    for path in (certificate, key):
        if path.exists() and not path.is_file():
            raise CertificateError(f"{path} is not a regular file, and `stampede certs` would replace it; move it away")
    _replace(key, made.key, 0o600)
    _replace(certificate, made.certificate, 0o644)
    return certificate, key


def _replace(path: Path, content: bytes, mode: int) -> None:
    draft = path.with_name(f".{path.name}.{secrets.token_hex(8)}")
    descriptor = os.open(draft, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode)
    try:
        with naming(draft), os.fdopen(descriptor, "wb") as file:
            file.write(content)
        os.replace(draft, path)
    except BaseException:
        draft.unlink(missing_ok=True)
        raise


RUNS = {"init": _init, "issue": _issue, "renew": _renew, "revoke": _revoke, "show": _show}
"""The function that runs each verb."""


if __name__ == "__main__":
    sys.exit(main())
