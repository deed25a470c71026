"""Making and showing certificates, and the files that hold them."""

from __future__ import annotations

import os
import stat
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from stampede_rt.cli.main import main as stampede
from stampede_rt.errors import InvalidArgument, PermissionDenied
from stampede_rt.security.tls import TlsFiles, TlsReader, check_files, files_from_environment
from stampede_rt.security.tls_diagnosis import check_own_certificate
from stampede_rt_local.certificates import ClusterCertificates
from stampede_rt_runtime.certificates import CertificateError, describe, issue, make_authority
from stampede_rt_runtime.identity import Identity, Role
from stampede_rt_runtime.service_settings import ServiceSettings
from stampede_rt_runtime.settings import SettingsError
from stampede_rt_runtime.tls import load_tls

NOW = datetime(2026, 5, 1, tzinfo=UTC)
DAY = timedelta(days=1)
HOST = Identity("lab", Role.HOST, "h1")


@pytest.fixture
def made(tmp_path: Path) -> ClusterCertificates:
    return ClusterCertificates(tmp_path / "certs")


def test_a_certificate_holds_its_name_its_addresses_and_its_end() -> None:
    authority = make_authority("lab", now=NOW, lifetime=10 * DAY)
    one = issue(authority, HOST, ("rig", "10.0.0.1", "[::1]"), now=NOW, lifetime=DAY)
    (contents,) = describe(one.certificate)
    assert contents.identity == HOST
    assert contents.addresses == ("rig", "10.0.0.1", "::1")
    assert contents.not_before < NOW
    assert contents.not_after == NOW + DAY
    assert not contents.is_authority
    assert describe(authority.certificate)[0].is_authority
    assert b"PRIVATE" not in repr(one).encode()


def test_a_certificate_ends_with_its_authority() -> None:
    authority = make_authority("lab", now=NOW, lifetime=10 * DAY)
    one = issue(authority, HOST, ("rig",), now=NOW, lifetime=99 * DAY)
    assert describe(one.certificate)[0].not_after == NOW + 10 * DAY
    with pytest.raises(CertificateError, match="authority has expired"):
        issue(authority, HOST, ("rig",), now=NOW + 11 * DAY, lifetime=DAY)


def test_a_service_needs_addresses_and_a_client_none() -> None:
    authority = make_authority("lab", now=NOW, lifetime=DAY)
    with pytest.raises(CertificateError, match="needs the addresses"):
        issue(authority, HOST, (), now=NOW, lifetime=DAY)
    assert issue(authority, Identity("lab", Role.CLIENT, "cam"), (), now=NOW, lifetime=DAY)


def test_the_commands_make_files_that_work_together(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = str(tmp_path / "ca")
    assert stampede(["certs", "init", folder, "--cluster", "lab"]) == 0
    words = ["certs", "issue", "--dir", folder, "--name", "s1", "--role", "supernode", "--address", "s1", "10.0.0.1"]
    assert stampede(words) == 0
    ca, certificate, key = (Path(folder) / one for one in ("ca.pem", "supernode-s1.pem", "supernode-s1.key"))
    for secret in (key, Path(folder) / "ca.key"):
        assert stat.S_IMODE(secret.stat().st_mode) == 0o600
    tls = load_tls(TlsFiles(ca=ca, certificate=certificate, key=key), Role.SUPERNODE)
    assert tls.identity == Identity("lab", Role.SUPERNODE, "s1")
    printed = capsys.readouterr().out
    assert f"stampede certs issue --dir {folder} --name NAME" in printed
    assert f"stampede supernode --id s1 --tls-ca {ca} --tls-certificate {certificate} --tls-key {key}" in printed
    assert stampede(["certs", "show", str(certificate), str(ca)]) == 0
    printed = capsys.readouterr().out
    assert "supernode s1 of cluster lab, called at s1, 10.0.0.1; valid until" in printed
    assert "(an authority)" in printed


def test_names_that_differ_in_case_or_in_a_slash_have_files_of_their_own(tmp_path: Path) -> None:
    names = ("robot-arm", "Robot-Arm", "robot/arm", "Robot/arm")
    assert stampede(["certs", "init", str(tmp_path)]) == 0
    for name in names:
        assert stampede(["certs", "issue", "--dir", str(tmp_path), "--name", name, "--role", "client"]) == 0
    files = [file.name for file in tmp_path.glob("client-*.pem")]
    assert len({file.lower() for file in files}) == len(names)
    found = [describe((tmp_path / file).read_bytes())[0].identity for file in files]
    assert {one.name for one in found if one} == set(names)
    assert "client-robot-arm.pem" in files


def test_a_certificate_for_other_addresses_is_noticed_by_the_service_itself(made: ClusterCertificates) -> None:
    tls = load_tls(made.issue(Role.HOST, "h1"), Role.HOST)
    for target in ("localhost:1", "LocalHost:1", "127.0.0.1:1", "[::1]:1", "unix:/run/h1", "0.0.0.0:1"):
        tls.require_address(target)
    with pytest.raises(
        PermissionDenied,
        match=r"others call this service at h1\.lab, .*issue it with `stampede certs issue --address h1\.lab`",
    ):
        tls.require_address("h1.lab:7600")


def test_a_second_init_does_not_replace_the_authority(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert stampede(["certs", "init", str(tmp_path)]) == 0
    before = (tmp_path / "ca.pem").read_bytes()
    assert stampede(["certs", "init", str(tmp_path)]) == 1
    assert "already has the key of an authority" in capsys.readouterr().err
    assert (tmp_path / "ca.pem").read_bytes() == before


@pytest.mark.parametrize(
    ("words", "status", "complaint"),
    [
        (["issue", "--name", "n", "--role", "king"], 2, "invalid choice"),
        (["issue", "--name", "N O", "--role", "client"], 2, "the name is 'N O'"),
        (["init", "x", "--cluster", "A B"], 2, "the cluster's name is 'A B'"),
        (["init", "x", "--days", "0"], 2, "allowed: 1 to 36500"),
        (["issue", "--dir", "nowhere", "--name", "n", "--role", "client"], 1, "no authority in nowhere; make one with"),
        (["issue", "--dir", "certs", "--name", "n", "--role", "host", "--address", "h.lab:7"], 1, "without a port"),
        (["issue", "--dir", "certs", "--name", "n", "--role", "host", "--address", "a b"], 1, "is not the name or IP"),
        (["show", "ca.key"], 1, "holds no certificate"),
    ],
)
def test_a_wrong_command_prints_one_sentence(
    words: list[str],
    status: int,
    complaint: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    stampede(["certs", "init", "certs"])
    (tmp_path / "ca.key").write_bytes((tmp_path / "certs" / "ca.key").read_bytes())
    capsys.readouterr()
    assert stampede(["certs", *words]) == status
    error_output = capsys.readouterr().err
    assert complaint in error_output
    assert "Traceback" not in error_output


def test_show_reports_an_expired_certificate(made: ClusterCertificates, capsys: pytest.CaptureFixture[str]) -> None:
    files = made.issue(Role.CLIENT, "late", begins=datetime.now(UTC) - 2 * DAY, lifetime=DAY)
    assert stampede(["certs", "show", str(files.certificate)]) == 0
    assert "EXPIRED on" in capsys.readouterr().out


def test_certificates_are_renewed_in_their_files_for_the_same_identity_addresses_and_lifetime(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, parts = str(tmp_path / "ca"), tmp_path / "parts"
    assert stampede(["certs", "init", folder, "--cluster", "lab"]) == 0
    issued = ["certs", "issue", "--dir", folder, "--out", str(parts), "--ttl", "12h"]
    assert stampede([*issued, "--name", "h1", "--role", "host", "--address", "h1.lab", "10.0.0.1"]) == 0
    assert stampede([*issued, "--name", "cam", "--role", "client"]) == 0
    files = sorted(parts.glob("*.pem"))
    before = [describe(file.read_bytes())[0] for file in files]
    assert stampede(["certs", "renew", "--dir", folder, *map(str, files)]) == 0
    after = [describe(file.read_bytes())[0] for file in files]
    for one, other in zip(before, after, strict=True):
        assert (one.identity, one.addresses, one.lifetime) == (other.identity, other.addresses, other.lifetime)
        assert one.serial != other.serial
        assert one.lifetime == timedelta(hours=12)
    own = TlsFiles(ca=Path(folder) / "ca.pem", certificate=parts / "host-h1.pem", key=parts / "host-h1.key")
    assert load_tls(own, Role.HOST).addresses == ("h1.lab", "10.0.0.1")
    assert "host h1 of cluster lab, until" in capsys.readouterr().out


def test_no_certificate_is_renewed_if_one_of_the_files_cannot_be_used(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    ours, others = tmp_path / "ours", tmp_path / "others"
    for folder, cluster in ((ours, "lab"), (others, "far")):
        assert stampede(["certs", "init", str(folder), "--cluster", cluster]) == 0
        assert stampede(["certs", "issue", "--dir", str(folder), "--name", "cam", "--role", "client"]) == 0
    before = (ours / "client-cam.pem").read_bytes()
    for wrong, why in (
        (others / "client-cam.pem", "is of cluster far, but the authority is of cluster lab"),
        (ours / "ca.pem", "is not the certificate of a part of a cluster"),
        (ours / "ca.key", "the file holds no certificate in PEM form"),
        (ours / "absent.pem", "cannot be used: No such file"),
    ):
        assert stampede(["certs", "renew", "--dir", str(ours), str(ours / "client-cam.pem"), str(wrong)]) == 1
        assert why in capsys.readouterr().err
    assert (ours / "client-cam.pem").read_bytes() == before


@pytest.mark.parametrize(
    ("lifetime", "left", "soon"),
    [(365 * DAY, 15 * DAY, False), (365 * DAY, 13 * DAY, True), (DAY, DAY / 2, False), (DAY, DAY / 4, True)],
)
def test_a_certificate_is_due_for_renewal_two_weeks_before_its_end_or_when_a_third_of_its_lifetime_is_left(
    lifetime: timedelta, left: timedelta, soon: bool
) -> None:
    authority = make_authority("lab", now=NOW, lifetime=999 * DAY)
    [contents] = describe(issue(authority, HOST, ("rig",), now=NOW, lifetime=lifetime).certificate)
    assert contents.ends_soon(NOW + lifetime - left, 14 * DAY) is soon


def test_a_service_does_not_start_with_an_invalid_certificate(made: ClusterCertificates, tmp_path: Path) -> None:
    late = made.issue(Role.HOST, "late", begins=datetime.now(UTC) - 2 * DAY, lifetime=DAY)
    with pytest.raises(PermissionDenied, match="has expired; issue it anew"):
        load_tls(late, Role.HOST)
    good = made.issue(Role.HOST, "h1")
    with pytest.raises(PermissionDenied, match="belongs to host h1 of cluster local, but this service is a supernode"):
        load_tls(good, Role.SUPERNODE)
    foreign = ClusterCertificates(tmp_path / "foreign")
    with pytest.raises(PermissionDenied, match="is not of an authority in"):
        load_tls(TlsFiles(ca=foreign.ca, certificate=good.certificate, key=good.key), Role.HOST)


def test_the_error_names_each_unusable_file(made: ClusterCertificates, tmp_path: Path) -> None:
    one, two = made.issue(Role.CLIENT, "one"), made.issue(Role.CLIENT, "two")
    with pytest.raises(PermissionDenied, match=r"client-one\.pem and the private key .*client-two\.key cannot be used"):
        TlsReader(TlsFiles(ca=one.ca, certificate=one.certificate, key=two.key))
    with pytest.raises(PermissionDenied, match="absent cannot be read: No such file"):
        TlsReader(TlsFiles(ca=tmp_path / "absent", certificate=one.certificate, key=one.key))
    with pytest.raises(PermissionDenied, match="holds no certificate of an authority"):
        TlsReader(TlsFiles(ca=one.key, certificate=one.certificate, key=one.key))
    Path(one.key).chmod(0o644)
    with pytest.raises(PermissionDenied, match="can be read by every user; run: chmod 600"):
        TlsReader(one)


def test_a_reader_returns_new_files_and_waits_until_broken_ones_are_whole(
    made: ClusterCertificates, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("stampede_rt.security.tls.LOOK_EVERY_S", 0.0)
    files = made.issue(Role.CLIENT, "cam")
    reader = TlsReader(files)
    first = reader.current()
    assert reader.current() is first
    made.issue(Role.CLIENT, "cam")
    second = reader.current()
    assert second is not first
    assert second.certificate != first.certificate
    right_key = Path(files.key).read_bytes()
    Path(files.key).write_bytes(Path(made.issue(Role.CLIENT, "other").key).read_bytes())
    assert reader.current() is second
    Path(files.key).unlink()
    assert reader.current() is second
    Path(files.key).write_bytes(right_key)
    Path(files.key).chmod(0o600)
    third = reader.current()
    assert third is not second
    assert third.key == second.key


def test_a_reader_retries_if_a_replacement_of_the_files_ends_while_it_reads(
    made: ClusterCertificates, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In an earlier version, the reader noted the second file as refused, too, and never read the whole pair."""
    monkeypatch.setattr("stampede_rt.security.tls.LOOK_EVERY_S", 0.0)
    files = made.issue(Role.CLIENT, "cam")
    reader = TlsReader(files)
    _, certificate, key = files.paths()
    newer = made.issue(Role.CLIENT, "newer").paths()
    os.replace(newer[2], key)  # the certificate does not belong to this key yet

    def check_and_end(given: TlsFiles) -> None:
        try:
            check_files(given)
        finally:
            if newer[1].exists():
                os.replace(newer[1], certificate)

    monkeypatch.setattr("stampede_rt.security.tls.check_files", check_and_end)
    reader.current()
    assert reader.current().certificate == certificate.read_bytes()


def test_the_standard_library_shows_our_own_certificate(made: ClusterCertificates) -> None:
    own = check_own_certificate(TlsReader(made.issue(Role.CLIENT, "cam")))
    assert ("URI", "stampede://local/client/cam") in own["subjectAltName"]  # type: ignore[operator]


def test_the_environment_names_all_three_files_or_none(made: ClusterCertificates) -> None:
    assert files_from_environment({}) is None
    files = made.issue(Role.CLIENT, "cam")
    environ = {"STAMPEDE_TLS_CA": str(files.ca), "STAMPEDE_TLS_CERTIFICATE": str(files.certificate)}
    with pytest.raises(InvalidArgument, match=r"^\$STAMPEDE_TLS_KEY must be set, too"):
        files_from_environment(environ)
    found = files_from_environment(environ | {"STAMPEDE_TLS_KEY": str(files.key)})
    assert found is not None
    assert found.paths() == files.paths()


def test_the_error_names_the_missing_flag(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match="--tls-certificate and --tls-key must be given, too"):
        ServiceSettings(tls_ca=tmp_path / "ca.pem").load_tls(Role.HOST)


def test_with_certificates_the_secret_of_the_user_is_not_needed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    place = tmp_path / "config" / "stampede" / "secret"
    place.parent.mkdir(parents=True)
    place.write_text("s3cret")
    place.chmod(0o600)
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    monkeypatch.delenv("STAMPEDE_SECRET_FILE", raising=False)
    assert ServiceSettings().load_secret() is not None
    assert ServiceSettings(tls_ca=tmp_path).load_secret() is None
    assert ServiceSettings(tls_ca=tmp_path, secret_file=place).load_secret() is not None
