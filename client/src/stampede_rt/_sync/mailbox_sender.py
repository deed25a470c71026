# Generated from ../_async by tools/generate.py; do not edit.
"""Sends messages to the mailboxes of other peers."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from stampede_rt._sync.peer_locator import PeerLocator
from stampede_rt._sync.puts import ProducerNumbers, Puts, SingleItem, enqueued
from stampede_rt._sync.session import Session
from stampede_rt.transports.concurrency_sync import Mutex
from stampede_rt.transports.grpc_sync import ServerEndpoint
from stampede_rt.values.codecs import CodecLike, HandleCodec
from stampede_rt.values.queueing import Enqueued
from stampede_rt.values.reading import Wait

PEERS_MAX = 256  # mailboxes with put streams that stay open


class MailboxSender:
    """Sends messages to mailboxes, and keeps open put streams to the 256 mailboxes that it used last."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._numbers = ProducerNumbers()
        self._puts_by_peer: dict[str, Puts] = {}
        self._mutex = Mutex()

    def send(
        self,
        peer: str,
        payload: Any,
        timeout: float | None,
        attributes: Mapping[str, str] | None,
        content_type: str | None,
        codec: CodecLike | None,
        message_id: str | None,
    ) -> Enqueued:
        """Put one message. See `Connection.send`."""
        self._session.check()
        coding = HandleCodec.parse(codec, f"the message to {peer!r}", content_type)
        item = SingleItem.parse(coding, payload, None, None, attributes, content_type, message_id)
        return enqueued(self._puts_to(peer).put(self._numbers.put_of(item), Wait.parse(timeout)))

    def _puts_to(self, peer: str) -> Puts:
        with self._mutex:
            puts = self._puts_by_peer.pop(peer, None)
            if puts is None:
                puts = Puts(self._session, PeerLocator(self._session, peer), ServerEndpoint.enqueues)
            self._puts_by_peer[peer] = puts  # the most recently used mailbox is the last in the order
            if len(self._puts_by_peer) > PEERS_MAX:
                # The streams of the removed mailbox close after their last put.
                self._puts_by_peer.pop(next(iter(self._puts_by_peer)))
        return puts
