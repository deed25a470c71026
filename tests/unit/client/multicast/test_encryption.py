"""The layout of docs/wire.md, taken apart by hand, and datagrams that a reader must drop."""

from __future__ import annotations

import struct

import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey
from cryptography.hazmat.primitives.ciphers.aead import AESGCM

from stampede_rt.errors import InvalidArgument
from stampede_rt.multicast.encryption import DatagramOpener, Encryptor, RejectReason, Signer, Verifier
from stampede_rt.multicast.layout import (
    DATAGRAM_BYTES_MAX,
    MessageKind,
    MessagePart,
    MulticastMessage,
    parse_part,
    parts_of,
)

STREAM, KEY, SEED = b"12345678", bytes(range(32)), bytes(32)
BODY = bytes(range(256)) * 20
MESSAGE = MulticastMessage(MessageKind.ITEMS, 5, 9, BODY)


def datagrams() -> list[bytes]:
    encryptor = Encryptor(STREAM, 3, KEY)
    return [encryptor.encrypt(part) for part in parts_of(Signer(STREAM, SEED).sign(MESSAGE))]


def test_datagrams_have_the_documented_layout() -> None:
    data = []
    for number, datagram in enumerate(datagrams()):
        assert len(datagram) <= DATAGRAM_BYTES_MAX
        assert struct.unpack(">4s8sHQ", datagram[:22]) == (b"SRM1", STREAM, 3, number + 1)
        part = AESGCM(KEY).decrypt((number + 1).to_bytes(12, "big"), datagram[22:], datagram[:22])
        assert struct.unpack(">BQQHH", part[:21]) == (1, 5, 9, number, 4)
        data.append(part[21:])
    assert [len(one) for one in data[:-1]] == [1341] * 3
    whole = b"".join(data)
    public = Ed25519PublicKey.from_public_bytes(Signer(STREAM, SEED).public_key)
    public.verify(whole[:64], b"stampede multicast 1" + STREAM + struct.pack(">BQQ", 1, 5, 9) + whole[64:])
    assert whole[64:] == BODY


def test_changed_and_foreign_datagrams_are_dropped() -> None:
    first, opener = datagrams()[0], DatagramOpener(STREAM, 3, KEY)
    assert isinstance(opener.open(first), MessagePart)
    for at in (12, 14, 21, 22, 60, len(first) - 1):
        changed = bytearray(first)
        changed[at] ^= 1
        assert opener.open(bytes(changed)) in (RejectReason.FORGED, RejectReason.OTHER_KEY)
    assert opener.open(b"X" + first[1:]) is RejectReason.FOREIGN
    assert opener.open(first[:40]) is RejectReason.FOREIGN
    assert opener.open(first + bytes(1000)) is RejectReason.FOREIGN
    assert DatagramOpener(b"87654321", 3, KEY).open(first) is RejectReason.FOREIGN
    assert DatagramOpener(STREAM, 4, KEY).open(first) is RejectReason.OTHER_KEY
    assert DatagramOpener(STREAM, 3, bytes(32)).open(first) is RejectReason.FORGED


def test_a_message_that_another_reader_signs_is_dropped() -> None:
    signed = Signer(STREAM, SEED).sign(MESSAGE)
    verifier = Verifier(STREAM, Signer(STREAM, SEED).public_key)
    assert verifier.verify(signed) == MESSAGE
    assert verifier.verify(signed._replace(end_seq=10)) is None
    assert verifier.verify(signed._replace(kind=MessageKind.BEAT)) is None
    assert verifier.verify(Signer(STREAM, b"x" * 32).sign(MESSAGE)) is None
    assert Verifier(b"87654321", Signer(STREAM, SEED).public_key).verify(signed) is None
    assert verifier.verify(MESSAGE._replace(body=b"short")) is None


def test_an_invalid_public_key_is_refused() -> None:
    with pytest.raises(InvalidArgument, match="public key"):
        Verifier(STREAM, b"short")


@pytest.mark.parametrize(
    "fields", [(0, 1, 2, 0, 1), (4, 1, 2, 0, 1), (1, 0, 2, 0, 1), (1, 3, 2, 0, 1), (1, 2, 2, 0, 1), (2, 1, 2, 0, 1),
               (1, 1, 2, 1, 1), (1, 1, 2, 0, 60_000), (1, 1, 2, 0, 2)],
)  # fmt: skip
def test_a_part_that_no_host_makes_is_dropped(fields: tuple[int, ...]) -> None:
    assert parse_part(struct.pack(">BQQHH", *fields) + b"data") is None
