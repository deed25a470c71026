"""The things that a process holds: memory, files, threads, tasks and objects, and their growth after many cycles."""

from __future__ import annotations

import asyncio
import ctypes
import gc
import json
import os
import resource
import signal
import threading
from collections import Counter
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

from stampede_rt_local.process import ServiceProcess
from tests.support.waiting import wait_until

FOLDER_VARIABLE = "CYCLES_FOLDER"
COUNT = signal.SIGUSR2
SPARE = 10  # files, threads and tasks that come and go
SPARE_OBJECTS = 60  # for each type
SPARE_BUILTINS = 300  # tuples, lists and dicts, which are also parts of objects that a service keeps for some seconds
CYCLES_FOR_AN_OBJECT = 4  # a leak of one object in four cycles is found, if there are many cycles
SPARE_BYTES, BYTES_FOR_A_CYCLE = 8 * 2**20, 512
TYPES_SHOWN = 6


@dataclass(frozen=True, kw_only=True)
class HeldResources:
    """The things that a process holds. `objects`: their number by the type's name, after a garbage collection."""

    memory_bytes: int
    files: int
    threads: int
    tasks: int
    objects: dict[str, int]

    def grown_since(self, before: HeldResources, cycles: int) -> list[str]:
        """Return the things that have grown more than they may in this number of cycles, as texts."""
        counts = {"files": SPARE, "threads": SPARE, "tasks": SPARE, "memory_bytes": SPARE_BYTES}
        counts["memory_bytes"] += cycles * BYTES_FOR_A_CYCLE
        now, then = asdict(self), asdict(before)
        found = [f"{name} +{now[name] - then[name]}" for name, most in counts.items() if now[name] - then[name] > most]
        leaked = cycles // CYCLES_FOR_AN_OBJECT
        grown = Counter({name: count - before.objects.get(name, 0) for name, count in self.objects.items()})
        return (
            found
            + [f"{name} +{more}" for name, more in grown.most_common() if more > leaked + _spare(name)][:TYPES_SHOWN]
        )


def _spare(type_name: str) -> int:
    return SPARE_BUILTINS if type_name.startswith("builtins.") else SPARE_OBJECTS


def held_here() -> HeldResources:
    """Count the things of this process."""
    gc.collect()
    ctypes.CDLL(None).malloc_trim(0)  # memory that the process could give back does not count
    objects = gc.get_objects()
    names = Counter(f"{type(one).__module__}.{type(one).__qualname__}" for one in objects)
    return HeldResources(
        memory_bytes=int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize(),
        files=len(os.listdir("/proc/self/fd")),
        threads=threading.active_count(),
        tasks=sum(isinstance(one, asyncio.Task) and not one.done() for one in objects),
        objects=dict(names),
    )


def count_on_signal() -> None:
    """From now on, write the things of this process into a file at each signal COUNT."""
    folder = Path(os.environ[FOLDER_VARIABLE])

    def write(*_: object) -> None:
        draft = folder / f"{os.getpid()}.draft"
        draft.write_text(json.dumps(asdict(held_here())))
        draft.rename(folder / f"{os.getpid()}.json")

    signal.signal(COUNT, write)


def held_by(process: ServiceProcess, folder: Path) -> HeldResources:
    """Let a service that runs as `counted_service` count its things."""
    file = folder / f"{process.pid}.json"
    file.unlink(missing_ok=True)
    os.kill(process.pid, COUNT)
    wait_until(file.exists, f"{process.name} has counted its things")
    return HeldResources(**json.loads(file.read_text()))


def settled(find: Callable[[], list[str]], tries: int = 40) -> list[str]:
    """Call `find` until it has no complaints, but at most `tries` more times. Waits half a second before each.

    Returns the last result.
    """
    pause, found = threading.Event(), find()
    for _ in range(tries):
        if not found:
            break
        pause.wait(0.5)
        found = find()
    return found
