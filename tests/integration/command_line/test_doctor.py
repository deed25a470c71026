"""`stampede doctor` on real clusters with faults: its findings, its advice, and its exit status."""

from __future__ import annotations

import re
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

import stampede_rt as st
from stampede_rt.cli.main import main as stampede
from stampede_rt.security.tls import TlsReader
from stampede_rt.security.tls_diagnosis import explain_refusal
from stampede_rt_local.cluster import LocalCluster
from stampede_rt_local.process import ServiceProcess
from stampede_rt_runtime.auth import make_secret_file
from stampede_rt_runtime.identity import Role
from tests.support.cluster import cluster_fixture
from tests.support.waiting import wait_until

DAY = timedelta(days=1)
PATIENCE_SECONDS = 20.0
NOBODY = "localhost:1"  # tcpmux: nothing listens there

cluster = cluster_fixture(scope="function", hosts=1, supernodes=3, durable=False)


class Doctor:
    def __init__(self, capsys: pytest.CaptureFixture[str]) -> None:
        self._capsys = capsys

    def __call__(self, *words: str) -> tuple[int, str]:
        """Run the command. Returns its exit status and its output. pytest shows the last output if a test fails."""
        self._capsys.readouterr()
        code = stampede(["doctor", *words])
        report = self._capsys.readouterr().out
        print(report)
        return code, report


@pytest.fixture
def doctor(capsys: pytest.CaptureFixture[str]) -> Doctor:
    return Doctor(capsys)


@pytest.mark.without_rules("doctor tells an operator more")
def test_doctor_names_the_supernodes_to_start_after_a_lost_quorum_also_without_a_front_end(
    cluster: LocalCluster, doctor: Doctor
) -> None:
    code, report = doctor("--url", cluster.address)
    assert (code, "3 of 3 serve" in report, "Everything is well." in report) == (0, True, True)
    for supernode in cluster.supernodes[1:]:
        supernode.kill()
    code, report = doctor("--url", cluster.address)
    assert (code, "1 of 3 run" in report) == (1, True)
    assert "start s2 and s3 with their data folders. If the folders are lost, see the runbook: lose two" in report
    assert "Hosts cannot renew their leases: within 5 s they refuse all calls. They keep their items" in report

    cluster.frontends[0].stop()
    code, report = doctor("--url", cluster.address)
    assert (code, "0 of 1 serve" in report) == (1, True)
    assert "connected clients go on, but no new client can connect; start a front-end" in report
    assert "stampede doctor --member HOST:PORT" in report
    code, report = doctor("--url", cluster.address, "--member", cluster.supernodes[0].address)
    assert (code, "start s2 and s3" in report, "host h1" in report) == (1, True, True)
    for supernode in cluster.supernodes:
        assert supernode.address in report.partition("start a front-end: stampede frontend --supernodes ")[2]


@pytest.mark.without_rules("a client token cannot host channels")
def test_doctor_and_errors_say_who_has_the_items_of_a_recorded_channel_whose_program_has_ended(
    cluster: LocalCluster, doctor: Doctor, tmp_path: Path
) -> None:
    with st.connect(cluster.address) as other:
        with st.host(cluster.address, name="ended", archive=tmp_path, drain="0s") as rt:
            rt.channel("cam/rec", max_items=5, archive="7d").put(b"x", ack="disk")
            channel = other.channel("cam/rec", create=False)
        with pytest.raises(
            st.Unavailable, match=r"host of the recorded channel 'cam/rec' \(ended\) is unreachable; start it"
        ):
            channel.newest()
    code, report = doctor("--url", cluster.address)
    assert (code, "with its items" in report) == (1, False)
    assert "1 of 1 recorded at an absent host" in row(report, "channels")
    named = f"start host ended (archive: {tmp_path}) again"
    assert f"{named} with the same archive, which has the recorded items of cam/rec" in report


@pytest.mark.without_rules("doctor tells an operator more")
def test_doctor_reports_a_killed_host_and_its_channels_until_it_restarts(cluster: LocalCluster, doctor: Doctor) -> None:
    empty = cluster.add_host()
    with st.connect(cluster.address) as rt:
        rt.channel("cam/left", max_age="10s", host="h1").put(b"gone soon")
        rt.queue("jobs", host="h1").put(b"gone soon")
        code, report = doctor("--url", cluster.address)
        assert (code, "1, none lost" in report) == (0, True)
        for host in cluster.hosts:
            host.kill()
        wait_until(lambda: doctor("--url", cluster.address)[1].count(" ago") == 2)
    code, report = doctor("--url", cluster.address)
    assert (code, "Everything is well." in report) == (1, False)
    assert re.search(r"^host h2 +\S+ +lost \S+ m?s ago", report, re.M), "h2 held nothing, but doctor reports it, too"
    assert "channels: the items of cam/left were lost with host h1" in report
    assert "queues: the items of jobs were lost with host h1" in report
    empty.restart()
    code, report = doctor("--url", cluster.address)
    assert (code, "lost" in row(report, "host h2"), "lost" in row(report, "host h1")) == (1, False, True)
    cluster.hosts[0].restart()  # without its data folder h1 comes back as another host
    code, report = doctor("--url", cluster.address)
    assert (code, "came back without its data folder" in report) == (1, True)
    with st.connect(cluster.address) as rt:
        rt.channel("cam/left").put(b"anew")
        rt.queue("jobs").put(b"anew")
    code, report = doctor("--url", cluster.address)
    assert (code, "Everything is well." in report, row(report, "channels").split()[2]) == (0, True, "1,"), report


def put_until_refused(handle: st.Channel | st.Queue) -> None:
    """Put once. The client repeats the put for some seconds. Put again if a busy host did not answer the last try."""
    refusal: st.StampedeError | None = None
    while not isinstance(refusal, st.Overloaded):
        with pytest.raises((st.Overloaded, st.Unavailable)) as raised:
            handle.put(bytes(200_000), timeout=2)
        refusal = raised.value


def test_puts_that_a_full_host_refuses_are_counted_logged_and_reported(cluster: LocalCluster, doctor: Doctor) -> None:
    words = ["--frontend", cluster.address, "--name", "small", "--memory-bytes-max", "1MiB"]
    words += ["--secret-file", str(cluster.secret_file)]
    small = ServiceProcess("host small", "stampede_rt_channel_host", words)
    small.start()
    try:
        small.wait_ready(PATIENCE_SECONDS)
        with st.connect(cluster.address) as rt:
            channel = rt.channel("big", max_age="1h", host="small")
            jobs = rt.queue("big-jobs", host="small")
            channel.put(bytes(900_000))
            with ThreadPoolExecutor(2) as pool:
                for refusing in [pool.submit(put_until_refused, one) for one in (channel, jobs)]:
                    refusing.result()
            refused = [one.stats().rejected["overloaded"] for one in (channel, jobs)]
            assert min(refused) > 1, "each try counts"
        code, report = doctor("--url", cluster.address)
        assert (code, f"{sum(refused)} puts refused" in row(report, "host small")) == (1, True)
        assert re.search(r"refused puts as Overloaded, the last one \S+ m?s ago; it holds \S+ KiB of 1.0 MiB", report)
        refusal_lines = [line for line in small.last_lines if "puts are refused" in line]
        assert 1 <= len(refusal_lines) < sum(refused), (
            "the host logs the first refusal immediately, and then one line for many"
        )
        assert "last_for=big" in refusal_lines[0] or "big-jobs" in refusal_lines[0]
    finally:
        small.stop()


def test_doctor_does_not_report_a_front_end_as_down_if_its_seeds_do_not_answer(
    doctor: Doctor, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("STAMPEDE_SECRET_FILE", str(make_secret_file(tmp_path / "secret").path))
    words = ["--listen", "localhost:0", "--supernodes", NOBODY, "--secret-file", str(tmp_path / "secret")]
    lost = ServiceProcess("front-end lost", "stampede_rt_frontend", words)
    lost.start()
    try:
        lost.wait_ready(PATIENCE_SECONDS)
        code, report = doctor("--url", lost.address)
    finally:
        lost.stop()
    assert (code, "no supernode" in report) == (1, True)
    assert f"no supernode answers this front-end ({NOBODY}" in report
    assert "they run, but reach no supernode" in report


def test_doctor_names_the_service_to_start_where_nothing_listens(doctor: Doctor) -> None:
    code, report = doctor("--url", NOBODY)
    assert (code, f"front-end {NOBODY}" in report, "start a front-end: stampede frontend" in report) == (1, True, True)


@pytest.fixture
def secured(monkeypatch: pytest.MonkeyPatch) -> Iterator[LocalCluster]:
    monkeypatch.delenv("STAMPEDE_SECRET_FILE", raising=False)
    with LocalCluster(tls=True, hosts=0, supernodes=1, durable=False) as made:
        yield made


def row(report: str, part: str) -> str:
    """The line of the table about that part."""
    return next((line for line in report.splitlines() if line.startswith(f"{part} ")), "")


def use(files: st.TlsFiles, patch: pytest.MonkeyPatch) -> None:
    for variable, path in zip(("CA", "CERTIFICATE", "KEY"), files.paths(), strict=True):
        patch.setenv(f"STAMPEDE_TLS_{variable}", str(path))


def test_certificates_that_end_soon_or_have_ended_are_reported_with_their_owners(
    secured: LocalCluster, doctor: Doctor, monkeypatch: pytest.MonkeyPatch
) -> None:
    certificates = secured.certificates
    assert certificates is not None
    soon = certificates.issue(Role.CLIENT, "soon", begins=datetime.now(UTC) - 27 * DAY, lifetime=30 * DAY)
    use(soon, monkeypatch)
    code, report = doctor("--url", secured.address)
    assert (code, f"this caller {soon.certificate}: its certificate ends in 3.0 days; issue it anew" in report) == (
        1,
        True,
    )

    certificates.issue(Role.FRONTEND, "1", begins=datetime.now(UTC) - 2 * DAY, lifetime=DAY)
    well = certificates.issue(Role.CLIENT, "well")
    use(well, monkeypatch)
    wait_until(lambda: explain_refusal(secured.address, TlsReader(well)) is not None)
    code, report = doctor("--url", secured.address)
    assert (code, f"the certificate of {secured.address} has expired; issue it anew" in report) == (1, True)

    use(certificates.issue(Role.CLIENT, "late", begins=datetime.now(UTC) - 2 * DAY, lifetime=DAY), monkeypatch)
    code, report = doctor("--url", secured.address)
    assert (code, "has expired; issue it anew (stampede certs issue)" in report) == (1, True)
