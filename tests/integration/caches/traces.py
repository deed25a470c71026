"""Records the entries that clients drop from their caches, and the parties that they ask then. Also reads the
rows of the table in docs/connections.md.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import pytest

from stampede_rt._async import directory_client as async_directory
from stampede_rt._async import queue_locator as async_queues
from stampede_rt._async import reads as async_reads
from stampede_rt._async import session as async_session
from stampede_rt._sync import directory_client as sync_directory
from stampede_rt._sync import queue_locator as sync_queues
from stampede_rt._sync import reads as sync_reads
from stampede_rt._sync import session as sync_session
from stampede_rt.errors import StampedeError, Unavailable
from stampede_rt.transports import grpc_async, grpc_sync

PAGE = Path(__file__).parents[3] / "docs/connections.md"
HEADER = "| a kept entry | is stale after | its use fails with | the client then asks |"
UNREACHABLE = "no connection"
NOTHING = "nothing"
# The parties that answer a request, by the type of the request.
ANSWERERS = {
    "BindChannelRequest": "gatekeeper",
    "ResolveChannelRequest": "supernode",
    "OpenChannelRequest": "supernode",
    "ResolveQueueRequest": "supernode",
    "OpenQueueRequest": "supernode",
    "ListHostsRequest": "supernode",
    "BindRequest": "front-end",
}


class Row(NamedTuple):
    """One row of the table: an entry, the cause that makes it stale, the failure of its use, and the parties asked
    then.
    """

    entry: str
    stale_after: str
    failure: str
    parties: str


def documented() -> list[Row]:
    """Return the rows of the page's table."""
    lines = PAGE.read_text().split(HEADER + "\n")[1].splitlines()[1:]
    end = next(at for at, line in enumerate(lines) if not line.startswith("|"))
    return [Row(*(cell.strip().replace("`", "") for cell in line.strip("|").split("|"))) for line in lines[:end]]


class Trace:
    """The events of one connection: failures that dropped an entry, and requests that look for something."""

    def __init__(self) -> None:
        self._events: list[tuple[str, str]] = []

    def note(self, kind: str, what: str) -> None:
        self._events.append((kind, what))

    def clear(self) -> None:
        self._events.clear()

    def failed(self, kind: str) -> str:
        """The first failure of an entry of this kind since `clear`."""
        return next((what for one, what in self._events if one == kind), NOTHING)

    def parties(self, kind: str) -> str:
        """Return the parties that the client asked after that failure, each once, in order."""
        failed = next((at for at, (one, _) in enumerate(self._events) if one == kind), -1)
        return ", ".join(dict.fromkeys(what for one, what in self._events[failed + 1 :] if one == "asked"))


class Traces:
    """The traces of all connections. After `install` both clients add their events to these traces."""

    def __init__(self) -> None:
        self._by_metadata: dict[int, Trace] = {}

    def of(self, session: Any) -> Trace:
        """The trace of a connection."""
        return self._of(session.endpoints.metadata)

    def install(self, patch: pytest.MonkeyPatch) -> None:
        for transport in (grpc_async, grpc_sync):
            self._note_requests(patch, transport.ServerEndpoint)
        for session in (async_session, sync_session):
            self._note_drops(patch, session.ChannelLocator, "forget", lambda one: one.session, "channel")
        for queues in (async_queues, sync_queues):
            self._note_drops(patch, queues.QueueLocator, "forget", lambda one: one._session, "queue")
        for directory in (async_directory, sync_directory):
            self._note_demotions(patch, directory.DirectoryClient)
        for reads in (async_reads, sync_reads):
            self._note_refusals(patch, reads)

    def _of(self, metadata: object) -> Trace:
        return self._by_metadata.setdefault(id(metadata), Trace())

    def _note_requests(self, patch: pytest.MonkeyPatch, endpoint: Any) -> None:
        whole = endpoint.call

        def call(one: Any, method: Any, request: Any, *args: Any, **named: Any) -> Any:
            answerer = ANSWERERS.get(type(request).__name__)
            if answerer is not None:
                self._of(one._metadata).note("asked", answerer)
            return whole(one, method, request, *args, **named)

        patch.setattr(endpoint, "call", call)

    def _note_drops(self, patch: pytest.MonkeyPatch, locator: Any, name: str, session_of: Any, kind: str) -> None:
        whole = getattr(locator, name)

        def forget(one: Any, error: StampedeError | None = None) -> None:
            if error is not None:
                self.of(session_of(one)).note(kind, failure(error))
            whole(one, error)

        patch.setattr(locator, name, forget)

    def _note_demotions(self, patch: pytest.MonkeyPatch, client: Any) -> None:
        whole = client.demote

        def demote(one: Any, target: str, error: StampedeError) -> None:
            self._of(one._endpoints.metadata).note("supernode", failure(error))
            whole(one, target, error)

        patch.setattr(client, "demote", demote)

    def _note_refusals(self, patch: pytest.MonkeyPatch, reads: Any) -> None:
        whole = reads.note_refusal

        def note_refusal(session: Any, state: Any, error: StampedeError) -> None:
            self.of(session).note("proxy", failure(error))
            whole(session, state, error)

        patch.setattr(reads, "note_refusal", note_refusal)


def failure(error: StampedeError) -> str:
    """The reason that a service gave; UNREACHABLE if the client raised the error because no service answered."""
    own = isinstance(error, Unavailable) and error.reason == Unavailable.reason and not error.from_service
    return UNREACHABLE if own else error.reason
