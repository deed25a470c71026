"""The settings of each host process of one machine."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from stampede_rt_channel_host.process_arguments import process_arguments
from stampede_rt_channel_host.settings import PROCESSES_MAX, HostSettings, parse_processes
from stampede_rt_runtime.settings import SettingsError, load_settings


def settings_of(*words: str) -> HostSettings:
    return load_settings(HostSettings, service="host", argv=words, environ={})


def each(*words: str, base_name: str = "h") -> list[HostSettings]:
    """The settings that the processes of this command line read."""
    return [settings_of(*own) for own in process_arguments(settings_of(*words), words, base_name)]


def test_each_process_has_a_name_ports_and_a_folder_of_its_own() -> None:
    words = ["--processes", "3", "--name", "h", "--listen", "localhost:7590", "--advertise", "rig:8000"]
    found = each(*words, "--metrics", "localhost:9464", "--data-dir", "/data", "--zone", "lab")
    assert [one.metrics for one in found] == ["localhost:9464", "localhost:9465", "localhost:9466"]
    assert [one.name for one in found] == ["h-0", "h-1", "h-2"]
    assert [one.listen for one in found] == ["localhost:7590", "localhost:7591", "localhost:7592"]
    assert [one.advertise for one in found] == ["rig:8000", "rig:8001", "rig:8002"]
    assert [one.data_dir for one in found] == [Path(f"/data/process-{number}") for number in range(3)]
    assert {(one.processes, one.zone) for one in found} == {(1, "lab")}


def test_port_0_stays_port_0_for_each_process() -> None:
    assert [one.listen for one in each("--processes", "2", "--listen", "localhost:0")] == ["localhost:0"] * 2
    assert [one.listen for one in each("--processes", "2")] == [""] * 2


def test_the_processes_share_the_memory_of_the_machine() -> None:
    assert [one.memory_bytes_max for one in each("--processes", "4", "--memory-bytes-max", "1GiB")] == [2**28] * 4


def test_each_process_has_a_certificate_of_its_own() -> None:
    words = ["--tls-ca", "ca.pem", "--tls-certificate", "host-h-{process}.pem", "--tls-key", "host-h-{process}.key"]
    found = each("--processes", "2", *words, base_name="")
    assert [str(one.tls_certificate) for one in found] == ["host-h-0.pem", "host-h-1.pem"]
    assert [str(one.tls_key) for one in found] == ["host-h-0.key", "host-h-1.key"]
    assert [one.name for one in found] == ["", ""], "the certificates name the hosts"


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (["--listen", "localhost:65535"], "--listen localhost:65535 leaves no ports for 2 processes"),
        (["--memory-bytes-max", "1MiB"], "--memory-bytes-max leaves each of 2 processes less than"),
        (["--name", "n" * 127], "too long for a name of each process"),
        (["--tls-certificate", "host-h.pem"], "a certificate names one host; issue one for each"),
    ],
)
def test_settings_that_several_processes_cannot_share_are_refused(words: list[str], why: str) -> None:
    with pytest.raises(SettingsError, match=why):
        settings_of("--processes", "2", *words)
    settings_of(*words)


@pytest.mark.parametrize("text", ["0", "-1", "257", "two", "1.5"])
def test_a_number_of_processes_out_of_range_is_refused(text: str) -> None:
    with pytest.raises(SettingsError, match=f"--processes: '{text}' cannot be used"):
        settings_of(f"--processes={text}")


def test_auto_means_one_process_for_each_core() -> None:
    assert parse_processes("auto") == min(len(os.sched_getaffinity(0)), PROCESSES_MAX)


@pytest.mark.parametrize("url", ["s3://key:topsecret@b/rig", "az://c/rig?sig=topsecret"])
def test_the_error_for_a_url_with_credentials_does_not_repeat_them(url: str) -> None:
    with pytest.raises(SettingsError, match="without credentials") as caught:
        settings_of("--archive", url)
    assert "topsecret" not in str(caught.value)
    assert "//" in str(caught.value)


def test_the_processes_share_an_object_store_and_each_has_its_own_folder_and_part_of_the_cache() -> None:
    words = ["--processes", "2", "--archive", "s3://b/rig", "--archive-cache-bytes", "2 GiB"]
    found = each(*words, "--data-dir", "/data")
    assert [one.archive for one in found] == ["s3://b/rig"] * 2
    assert [one.folder_of_archive for one in found] == [Path(f"/data/archive/process-{at}") for at in range(2)]
    assert [one.archive_cache_bytes for one in found] == [2**30] * 2
