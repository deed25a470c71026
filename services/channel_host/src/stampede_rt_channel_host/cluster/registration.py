"""Keeps this host in the directory (paper, section 4.3).

Registers the host, renews its lease, and registers it again after the lease has ended. The host stops serving before
its lease ends.
"""

from __future__ import annotations

import asyncio
import logging
import random
import secrets
import time
from collections.abc import Awaitable, Callable
from typing import NoReturn

from stampede_rt.cluster.directory_call import may_pass
from stampede_rt.cluster.registration_epoch import RegistrationEpoch
from stampede_rt.errors import (
    HostExists,
    HostNotFound,
    LeaseExpired,
    StaleRegistration,
    StampedeError,
    Unavailable,
    VersionMismatch,
    WrongCluster,
)
from stampede_rt.transports.machine import machine_id
from stampede_rt.v1 import directory_pb2, directory_service_pb2
from stampede_rt.values.peering import ClockOffset
from stampede_rt_channel_host.cluster.host_lease import RENEWALS_PER_TTL, HostLease
from stampede_rt_channel_host.cluster.identity import HomeCluster, HostIdentity
from stampede_rt_channel_host.cluster.supernodes import Supernodes
from stampede_rt_runtime.clock import HostClock
from stampede_rt_runtime.version import PROTOCOL_VERSION, software_version

logger = logging.getLogger(__name__)

START_SECONDS_MAX = 60.0
LEAVE_SECONDS_MAX = 1.5
REGISTER_SECONDS_MAX = 4.0
_PAUSE_SECONDS_MIN, _PAUSE_SECONDS_MAX = 0.05, 1.0

RegisterHostResponse = directory_service_pb2.RegisterHostResponse
RenewHostLeaseResponse = directory_service_pb2.RenewHostLeaseResponse


class Registration:
    """One host's place in the directory.

    `on_registered` gets the directory's answer to every registration. The host serves nothing under the registration
    before `on_registered` has returned. `on_lease` gets True when the host has got the lease, and False when the lease
    has ended. While `has_hung` returns True, the host serves nothing, and `keep` does not renew the lease. `home` is
    the cluster of the host; before its first registration, the host may enter any cluster. Each renewal reports the
    load that `measure_load` returns.

    Call `enter`, `keep` and `leave` in this order, all on one event loop. Any thread may call `lease_held`.
    """

    def __init__(
        self,
        identity: HostIdentity,
        supernodes: Supernodes,
        clock: HostClock,
        *,
        on_registered: Callable[[RegisterHostResponse], Awaitable[None]],
        on_lease: Callable[[bool], None],
        has_hung: Callable[[], bool] = lambda: False,
        home: HomeCluster | None = None,
        measure_load: Callable[[], directory_pb2.HostLoad] | None = None,
    ) -> None:
        self._identity = identity
        self._supernodes = supernodes
        self._clock = clock
        self._on_registered = on_registered
        self._on_lease = on_lease
        self._has_hung = has_hung
        self._home = home or HomeCluster()
        self._measure_load = measure_load
        self._epoch = RegistrationEpoch()
        self._lease = HostLease()
        self._reported_held = False  # the value that on_lease got last
        self._unrenewed_since_s: float | None = None  # when renewals began to fail; None: they succeed
        self._has_ended = False  # whether the lease has ended and the host has not registered since
        self._registered_index = 0  # the log position of the registration that the host knows
        self._target = ""
        self._has_left = False
        self.clock: ClockOffset | None = None
        """How far this host's clock is ahead of the leader's, as of the last renewal."""
        self._fence: asyncio.TimerHandle | None = None  # runs `_check_fence` when the lease has run out

    def lease_held(self) -> bool:
        """Whether the host may serve its channels now."""
        return self._lease.is_held(self._clock.boottime_nanos())

    def fenced_in_nanos(self) -> int:
        """The time in nanoseconds that the host may still serve without a renewal; 0 if it may not serve."""
        return self._lease.fenced_in_nanos(self._clock.boottime_nanos())

    def fence_boottime(self) -> int:
        """Until when the host may serve, in nanoseconds of CLOCK_BOOTTIME; 0 if it may not."""
        now = self._clock.boottime_nanos()
        return now + self._lease.fenced_in_nanos(now) if self._lease.is_held(now) else 0

    async def enter(self, target: str, timeout_s: float = START_SECONDS_MAX) -> None:
        """Register for the first time, with a gatekeeper at `target`.

        Tries for `timeout_s`, even while another live host has the name: that host may be the predecessor of this host,
        and its lease ends by itself. Raises the last failure. If a retry cannot help, raises the failure without
        another try.
        """
        self._target = target
        deadline_s = time.monotonic() + timeout_s
        pause_s = _PAUSE_SECONDS_MIN
        while True:  # ends with the deadline
            try:
                return await self._register(max(0.1, min(REGISTER_SECONDS_MAX, deadline_s - time.monotonic())))
            except StampedeError as error:
                stays = isinstance(error, WrongCluster) or not (may_pass(error) or isinstance(error, HostExists))
                if stays or time.monotonic() + pause_s > deadline_s:
                    raise
                logger.warning(
                    "cannot register yet",
                    extra={"event": "registration_failed", "host": self._identity.name, "why": str(error)},
                )
            pause_s = await _pause(pause_s)

    async def keep(self) -> NoReturn:
        """Renew the lease for as long as the host lives. Register again when the directory has ended the lease."""
        pause_s = _PAUSE_SECONDS_MIN
        while True:  # paced by the lease, or by the pause after failures
            await asyncio.sleep(self._lease.renewal_in_nanos(self._clock.boottime_nanos()) / 1e9)
            try:
                if self._has_hung():
                    raise Unavailable(
                        "the event loop that serves channels has stopped; the directory may give them to other hosts"
                    )
                await self._renew_or_register()
                self._note_renewed()
                pause_s = _PAUSE_SECONDS_MIN
            except StampedeError as error:
                self._note_unrenewed(error)
                pause_s = await _pause(pause_s)

    def _note_unrenewed(self, error: StampedeError) -> None:
        """Log one warning when renewals begin to fail. `_note_renewed` logs when they succeed again."""
        if self._unrenewed_since_s is None:
            self._unrenewed_since_s = time.monotonic()
            logger.warning(
                "the lease could not be renewed; trying again",
                extra={"event": "lease_renewal_failed", "host": self._identity.name, "why": str(error)},
            )
        else:
            logger.debug(
                "the lease still cannot be renewed; trying again",
                extra={"event": "lease_renewal_failed", "host": self._identity.name, "why": str(error)},
            )

    def _note_renewed(self) -> None:
        if self._unrenewed_since_s is not None:
            after = f"{time.monotonic() - self._unrenewed_since_s:.1f}"
            logger.warning(
                "the lease is renewed again",
                extra={"event": "lease_renewed", "host": self._identity.name, "after_s": after},
            )
            self._unrenewed_since_s = None

    async def leave(self) -> None:
        """Deregister, so that other hosts may get the channels without a wait for the end of the lease.

        If the directory cannot be reached, other hosts may get them as soon as the lease has ended by itself.
        """
        self._has_left = True
        if self._fence is not None:
            self._fence.cancel()
        self._lease.give_up()
        request = directory_service_pb2.DeregisterHostRequest(
            request_id=secrets.token_bytes(16),
            host_id=self._identity.host_id,
            boot_incarnation=self._identity.boot_incarnation,
        )
        try:
            await self._supernodes.call("DeregisterHost", request, LEAVE_SECONDS_MAX)
        except StampedeError as error:
            # A host that never entered has nothing to leave.
            level = logging.WARNING if self._lease.ttl_nanos else logging.DEBUG
            logger.log(
                level,
                "left without deregistering",
                extra={"event": "left_without_deregistering", "host": self._identity.name, "why": str(error)},
            )

    async def aclose(self) -> None:
        """Close the connections to the directory."""
        await self._supernodes.aclose()

    async def _renew_or_register(self) -> None:
        """Renew the lease; after its end, register until an answer has come.

        The directory may have registered the host although the answer was lost. Then a renewal would succeed, and the
        host would serve channels that other hosts own.
        """
        if not self._has_ended:
            try:
                return await self._renew()
            except (LeaseExpired, HostNotFound) as error:
                self._note_ended(error)
        await self._register()

    def _note_ended(self, error: StampedeError) -> None:
        """Stop serving: the directory has ended the lease."""
        logger.warning(
            "the lease has ended",
            extra={"event": "lease_ended", "host": self._identity.name, "why": str(error)},
        )
        self._lease.give_up()
        self._check_fence()
        self._has_ended = True

    async def _renew(self) -> None:
        request = directory_service_pb2.RenewHostLeaseRequest(
            host_id=self._identity.host_id,
            boot_incarnation=self._identity.boot_incarnation,
            load=None if self._measure_load is None else self._measure_load(),
            registered_index=self._registered_index,
        )
        sent, sent_unix_nano = self._clock.boottime_nanos(), self._clock.time_unix_nano()
        timeout_s = self._lease.ttl_nanos / RENEWALS_PER_TTL / 1e9
        response = await self._supernodes.call("RenewHostLease", request, timeout_s)
        if response.time_unix_nano:
            self.clock = ClockOffset.measured(
                sent_unix_nano=sent_unix_nano,
                took_nanos=self._clock.boottime_nanos() - sent,
                told_unix_nano=response.time_unix_nano,
                supernode="leader",
            )
        await self._note_cluster(response)
        self._grant(sent, response.lease_ttl_nanos)

    async def _register(self, timeout_s: float = REGISTER_SECONDS_MAX) -> None:
        """Register with a higher registration epoch than every other process of this host.

        Raises StaleRegistration if a newer process of the same host is alive. Then two processes use one data folder.
        """
        deadline_s = time.monotonic() + timeout_s
        while True:  # tries again after each process that has registered meanwhile; ends with the deadline
            try:
                return await self._register_once(deadline_s - time.monotonic())
            except StaleRegistration as error:
                if not self._epoch.may_overtake(error) or time.monotonic() >= deadline_s:
                    raise

    async def _register_once(self, timeout_s: float) -> None:
        """Send one registration, always with the same boot incarnation.

        So the items that this host holds stay valid, in all channels that no other host took meanwhile.
        """
        one = self._identity
        request = directory_service_pb2.RegisterHostRequest(
            request_id=secrets.token_bytes(16),
            host_id=one.host_id,
            name=one.name,
            gatekeepers=[directory_pb2.Endpoint(target=self._target, zone=one.zone)],
            boot_incarnation=one.boot_incarnation,
            version=software_version(),
            protocol_version=PROTOCOL_VERSION,
            registration_epoch=self._epoch.value,
            has_archive=one.has_archive,
            continues_boot_incarnation=one.continues,
            move_key=one.move_key,
            private=one.is_private,
            machine=machine_id(),
            archive_wait_nanos=one.archive_wait_nanos,
            archive_place=one.archive_place,
        )
        sent = self._clock.boottime_nanos()
        response: RegisterHostResponse = await self._supernodes.call("RegisterHost", request, timeout_s)
        if response.protocol_version not in (0, PROTOCOL_VERSION):
            raise VersionMismatch(
                f"the directory speaks protocol {response.protocol_version}, this host {PROTOCOL_VERSION} (version "
                f"{software_version()}); install the same release on both"
            )
        self._epoch.note_registered()
        await self._note_cluster(response)
        # Before the grant, so that the host serves no channel that another host owns.
        await self._on_registered(response)
        self._registered_index = response.registered_index
        self._grant(sent, response.lease_ttl_nanos)
        self._note_registered(len(response.channels))

    async def _note_cluster(self, response: RegisterHostResponse | RenewHostLeaseResponse) -> None:
        """Note the cluster of the directory that answered. It may have replaced this host's former cluster."""
        if not self._home.is_noted(response.cluster_id):
            await asyncio.to_thread(self._home.note, response.cluster_id, response.former_cluster_ids)

    def _note_registered(self, channels: int) -> None:
        """Log the registration: as a warning if the host had lost its lease, otherwise as information."""
        level, text = (logging.WARNING, "registered again") if self._has_ended else (logging.INFO, "registered")
        facts = {"event": "registered", "host": self._identity.name, "channels": channels}
        logger.log(level, text, extra=facts)
        self._has_ended = False

    def _grant(self, sent: int, ttl_nanos: int) -> None:
        if self._has_left:
            return  # an answer that came while the host left
        self._lease.granted(sent_nanos=sent, ttl_nanos=ttl_nanos)
        self._check_fence()

    def _check_fence(self) -> None:
        """Report to `on_lease` if the lease has begun or ended, and set the timer for the fence anew.

        Call this at every grant, and whenever the lease may have ended.
        """
        if self._fence is not None:
            self._fence.cancel()
            self._fence = None
        lease_nanos_left = self._lease.fenced_in_nanos(self._clock.boottime_nanos())
        if lease_nanos_left:
            # The timer fires a little late, when the clock has passed the fence. Each request checks the clock itself.
            self._fence = asyncio.get_running_loop().call_later(lease_nanos_left / 1e9 + 0.001, self._check_fence)
        self._report_lease(held=lease_nanos_left > 0)

    def _report_lease(self, *, held: bool) -> None:
        if held is not self._reported_held:
            self._reported_held = held
            if not held:
                text = (
                    "fenced: the lease was not renewed in time; this host refuses all calls until the lease is renewed"
                )
                logger.warning(text, extra={"event": "fenced", "host": self._identity.name})
            self._on_lease(held)


async def _pause(pause_s: float) -> float:
    """Wait a random time between half of `pause_s` and `pause_s`. Returns the next, longer pause."""
    await asyncio.sleep(pause_s * (0.5 + random.random() / 2))
    return min(2 * pause_s, _PAUSE_SECONDS_MAX)
