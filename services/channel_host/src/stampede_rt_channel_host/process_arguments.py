"""The command lines of the host processes of `stampede host --processes N`. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from stampede_rt_channel_host.settings import PROCESS_MARK, HostSettings
from stampede_rt_runtime.values import Address, parse_address


def process_arguments(settings: HostSettings, words: Sequence[str], base_name: str) -> list[list[str]]:
    """The arguments of each process: `words`, the supervisor's own arguments, and then the process's own settings.

    The last flag of a name counts, and a flag overrides the environment and the settings file. `base_name`: the name of
    process 0 without its number; empty if the certificates name the processes.
    """
    return [[*words, *_own_flags(settings, base_name, number)] for number in range(settings.processes)]


def _own_flags(settings: HostSettings, base_name: str, number: int) -> list[str]:
    own: dict[str, str] = {
        "--processes": "1",
        "--memory-bytes-max": str(settings.memory_bytes_max // settings.processes),
    }
    if base_name:
        own["--name"] = f"{base_name}-{number}"
    if settings.listen:
        own["--listen"] = _with_own_port(settings.listen, number)
    if settings.metrics:
        own["--metrics"] = _with_own_port(settings.metrics, number)
    if settings.advertise:
        own["--advertise"] = _with_own_port(settings.advertise, number)
    if settings.data_port:
        own["--data-port"] = str(settings.data_port + number)
    if settings.data_dir is not None:
        own["--data-dir"] = str(settings.data_dir / f"process-{number}")
    if (folder := settings.folder_of_archive) is not None:
        flag = "--archive" if isinstance(settings.archive, Path) else "--archive-folder"
        own[flag] = str(folder / f"process-{number}")
        own["--archive-bytes-max"] = str(settings.archive_bytes_max // settings.processes)
        own["--archive-cache-bytes"] = str(settings.archive_cache_bytes // settings.processes)
    for flag, path in (("--tls-certificate", settings.tls_certificate), ("--tls-key", settings.tls_key)):
        if path is not None:
            own[flag] = str(_of_process(path, number))
    return [f"{flag}={value}" for flag, value in own.items()]


def _with_own_port(text: str, number: int) -> str:
    """The address of a process: the port is counted from the port of process 0.

    Port 0 stays, and means any free port.
    """
    base = parse_address(text)
    return str(Address(base.host, base.port + number if base.port else 0))


def _of_process(path: Path, number: int) -> Path:
    return Path(str(path).replace(PROCESS_MARK, str(number)))
