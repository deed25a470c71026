"""Errors of a host inside a program name the arguments of `stampede_rt.host`, not the flags of `stampede host`."""

from __future__ import annotations

import pytest

from stampede_rt_channel_host.embedded_settings import cannot_host
from stampede_rt_runtime.settings import SettingsError


@pytest.mark.parametrize(
    ("of_the_command", "of_the_argument"),
    [
        ("--archive: no room; see --archive-folder", "archive: no room; see archive_folder"),
        ("more than --archive-bytes-max, --memory-bytes-max", "more than max_archive, max_memory"),
        ("give certificates (--tls-ca and the others)", "give certificates (tls)"),
        ("start it with the --data-dir of host h", "start it with the --data-dir of host h"),
        ("issue it with `stampede certs issue --role host`", "issue it with `stampede certs issue --role host`"),
    ],
)
def test_flags_become_arguments_unless_there_is_no_such_argument(of_the_command: str, of_the_argument: str) -> None:
    error = cannot_host(SettingsError(of_the_command))
    assert error.message == f"this process cannot host channels: {of_the_argument}"
