"""Encrypts and decrypts datagrams, and signs and checks messages. Pure, but needs the library `cryptography`.

All readers of a channel have one key. The host gives the key only to readers that have the right to read. The key
cannot prove that the host has sent a datagram, because each reader could make one. Therefore the host also signs each
message.
"""

from __future__ import annotations

from enum import Enum

from stampede_rt.errors import InvalidArgument
from stampede_rt.multicast.layout import (
    HEAD,
    MARK,
    SIGNATURE_BYTES,
    MessagePart,
    MulticastMessage,
    parse_head,
    parse_part,
    signed_bytes,
)

try:
    from cryptography.exceptions import InvalidSignature, InvalidTag
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey
    from cryptography.hazmat.primitives.ciphers.aead import AESGCM
except ImportError as missing:
    raise InvalidArgument(
        "multicast needs the library cryptography, which is not installed; run: pip install 'stampede-rt[multicast]'"
    ) from missing


class RejectReason(Enum):
    """Why a reader drops a datagram."""

    FOREIGN = "foreign"
    """The datagram belongs to another channel, host or program."""
    OTHER_KEY = "other_key"
    """The datagram names another key: the host has a new key, or the datagram is forged."""
    FORGED = "forged"
    """The datagram was changed on the way, or its sender does not have the key."""


class Encryptor:
    """Encrypts the parts of one stream with one key.

    `key` has KEY_BYTES random bytes, and only this object encrypts with it.
    """

    def __init__(self, stream_id: bytes, key_number: int, key: bytes) -> None:
        self._stream_id, self._key_number, self._cipher = stream_id, key_number, AESGCM(key)
        self._number = 0

    def encrypt(self, part: bytes) -> bytes:
        """The encrypted datagram of an encoded part."""
        self._number += 1  # the nonce: no two datagrams under one key have the same number
        head = HEAD.pack(MARK, self._stream_id, self._key_number, self._number)
        return head + self._cipher.encrypt(_nonce(self._number), part, head)


class DatagramOpener:
    """Opens the datagrams of one stream under one key."""

    def __init__(self, stream_id: bytes, key_number: int, key: bytes) -> None:
        self._stream_id, self.key_number, self._cipher = stream_id, key_number, AESGCM(key)

    def open(self, datagram: bytes) -> MessagePart | RejectReason:
        """Return the part of the datagram, or the reason to drop the datagram."""
        head = parse_head(datagram)
        if head is None or head.stream_id != self._stream_id:
            return RejectReason.FOREIGN
        if head.key_number != self.key_number:
            return RejectReason.OTHER_KEY
        try:
            opened = self._cipher.decrypt(_nonce(head.number), datagram[HEAD.size :], datagram[: HEAD.size])
        except InvalidTag:
            return RejectReason.FORGED
        return parse_part(opened) or RejectReason.FORGED


class Signer:
    """Signs the messages of one stream. `seed` has KEY_BYTES random bytes, which only the host knows."""

    def __init__(self, stream_id: bytes, seed: bytes) -> None:
        self._stream_id, self._key = stream_id, Ed25519PrivateKey.from_private_bytes(seed)

    @property
    def public_key(self) -> bytes:
        """The key with which readers check the messages."""
        return self._key.public_key().public_bytes_raw()

    def sign(self, message: MulticastMessage) -> MulticastMessage:
        """The message with the signature before its body."""
        return message._replace(body=self._key.sign(signed_bytes(self._stream_id, message)) + message.body)


class Verifier:
    """Checks the messages of one stream."""

    def __init__(self, stream_id: bytes, public_key: bytes) -> None:
        """Raises InvalidArgument if `public_key` is not a valid public key."""
        self._stream_id = stream_id
        try:
            self._key = Ed25519PublicKey.from_public_bytes(public_key)
        except ValueError as error:
            raise InvalidArgument("the host has sent bytes that are no public key") from error

    def verify(self, message: MulticastMessage) -> MulticastMessage | None:
        """Return the message without its signature; None if the host has not signed it."""
        bare = message._replace(body=message.body[SIGNATURE_BYTES:])
        try:
            self._key.verify(message.body[:SIGNATURE_BYTES], signed_bytes(self._stream_id, bare))
        except InvalidSignature:
            return None
        return bare


def _nonce(number: int) -> bytes:
    return number.to_bytes(12, "big")
