"""The faults of the run: the rover's own host is drained, and the next host is killed."""

from __future__ import annotations

import threading
import time

import stampede_rt as st
from stampede_rt_demos.failures import DemoFailed
from stampede_rt_demos.rover.programme import DRAIN, KILL, RIG
from stampede_rt_demos.staging.producing import wait_until
from stampede_rt_demos.stereo.programme import Side
from stampede_rt_local.cluster import LocalCluster

SYNC_SECONDS = 60.0
LOOK_SECONDS = 0.05


class Faults:
    """Runs on a thread while the roles run. `events`: nanoseconds since the start, and a text about the event."""

    def __init__(self, cluster: LocalCluster, rt: st.Connection, start: int, length: int) -> None:
        self._cluster, self._rt = cluster, rt
        self._start, self._length = start, length
        self.events: list[tuple[int, str]] = []
        self.failure: Exception | None = None
        self._thread = threading.Thread(target=self._run, name="faults", daemon=True)

    def begin(self) -> None:
        """Start the thread."""
        self._thread.start()

    def end(self) -> None:
        """Wait for its end. Raises DemoFailed if a step did not go as planned."""
        self._thread.join(SYNC_SECONDS)
        if self.failure is not None:
            raise DemoFailed(f"a step of the run failed: {self.failure}") from self.failure

    def _run(self) -> None:
        try:
            wait_until(self._start + round(self._length * DRAIN))
            self._drain()
            wait_until(self._start + round(self._length * KILL))
            self._kill()
        except (DemoFailed, st.StampedeError, KeyError) as error:
            self.failure = error

    def _drain(self) -> None:
        """Move the channels away from the rover, and give each of them a replica."""
        drained = self._rt.drain(RIG)
        if drained.left:
            raise DemoFailed(f"the rover kept {', '.join(drained.left)}")
        self._note(f"the rover is drained: {drained.moved} channels move away")
        self._spread()
        cameras = [self._rt.channel(side.value, create=False) for side in Side]
        for camera in cameras:
            camera.configure(replicas=1, ack="replica")
        self._await_replicas()
        self._note("each has a replica in sync")

    def _kill(self) -> None:
        """Kill the host of the left camera's channel, while each channel has a replica in sync."""
        self._await_replicas()
        owner = self._rt.channel(Side.LEFT.value, create=False).host
        {f"h{number}": one for number, one in enumerate(self._cluster.hosts, 1)}[owner].kill()
        self._note(f"{owner} is killed")

    def _spread(self) -> None:
        """Give each camera's channel a host of its own: a host that stays must know the cut that readers saw."""
        owner = self._rt.channel(Side.LEFT.value, create=False).host
        other = next(host.name for host in self._rt.hosts() if host.name not in (owner, RIG))
        if self._rt.channel(Side.RIGHT.value, create=False).host == owner:
            self._rt.move(Side.RIGHT.value, other)

    def _note(self, what: str) -> None:
        self.events.append((time.time_ns() - self._start, what))

    def _await_replicas(self) -> None:
        """Wait until each channel has a replica in sync. A replica that a busy machine delays is out of sync for a
        while."""
        cameras = [self._rt.channel(side.value, create=False) for side in Side]
        deadline = time.monotonic() + SYNC_SECONDS
        while not all(any(copy.in_sync for copy in camera.stats().copies) for camera in cameras):
            if time.monotonic() > deadline:
                raise DemoFailed(f"the replicas were not in sync after {SYNC_SECONDS:.0f} s")
            time.sleep(LOOK_SECONDS)
