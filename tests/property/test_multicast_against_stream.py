"""A reader of datagrams has the items of an ordinary subscription, whatever the network and other readers do."""

from __future__ import annotations

import random
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import pytest

from stampede_rt.multicast.assembling import Assembler
from stampede_rt.multicast.encryption import DatagramOpener, Encryptor, Signer, Verifier
from stampede_rt.multicast.layout import (
    DATA_BYTES_MAX,
    DATAGRAM_BYTES_MAX,
    KEY_BYTES,
    SIGNATURE_BYTES,
    MessageKind,
    MessagePart,
    MulticastMessage,
    parts_of,
)
from stampede_rt.multicast.multicast_receiver import ASSEMBLED_BYTES_MAX, HELD_BYTES_MAX, MulticastReceiver
from stampede_rt.multicast.repair_pace import REORDERED_S, RepairStep

STEPS = 120
STREAM = b"stream-1"
HELD_ITEMS = 30  # the retention of the channel
REPAIR_ITEMS = 7


@dataclass(frozen=True, slots=True)
class NumberedItem:
    seq: int
    payload: bytes


def encoded(items: Sequence[NumberedItem]) -> bytes:
    return b"".join(one.seq.to_bytes(8, "big") + len(one.payload).to_bytes(4, "big") + one.payload for one in items)


def decoded(body: bytes) -> list[NumberedItem]:
    items, at = [], 0
    while at < len(body):
        seq, length = int.from_bytes(body[at : at + 8], "big"), int.from_bytes(body[at + 8 : at + 12], "big")
        items.append(NumberedItem(seq, body[at + 12 : at + 12 + length]))
        at += 12 + length
    return items


class SendingHost:
    """The host: the items that it holds, and the datagrams that it makes of them."""

    def __init__(self, rng: random.Random, key: bytes) -> None:
        self.rng, self.items, self.beats = rng, list[NumberedItem](), 0
        self.signer = Signer(STREAM, rng.randbytes(KEY_BYTES))
        self.encryptor = Encryptor(STREAM, 1, key)

    @property
    def next_seq(self) -> int:
        return self.items[-1].seq + 1 if self.items else 1

    @property
    def first_held(self) -> int:
        return max(1, self.next_seq - HELD_ITEMS)

    def put(self) -> Iterator[bytes]:
        """Accept a few items, and send them as one message."""
        first = self.next_seq
        for seq in range(first, first + self.rng.randrange(1, 5)):
            self.items.append(NumberedItem(seq, self.rng.randbytes(self.rng.choice((0, 9, 900, 3000)))))
        yield from self.sealed(MessageKind.ITEMS, first, self.next_seq, encoded(self.items[first - 1 :]))

    def beat(self) -> Iterator[bytes]:
        self.beats += 1
        yield from self.sealed(MessageKind.BEAT, self.next_seq, self.next_seq, self.beats.to_bytes(8, "big"))

    def sealed(self, kind: MessageKind, first: int, end: int, body: bytes) -> Iterator[bytes]:
        for part in parts_of(self.signer.sign(MulticastMessage(kind, first, end, body))):
            yield self.encryptor.encrypt(part)


class Network:
    """Loses, repeats, reorders and changes datagrams, and adds datagrams of other senders and for other readers."""

    def __init__(self, rng: random.Random, key: bytes) -> None:
        self.rng, self.key = rng, key
        self.under_way, self.seen = list[bytes](), list[bytes]()
        self.loss = rng.choice((0.0, 0.05, 0.3))

    def carry(self, datagrams: Iterator[bytes]) -> None:
        for one in datagrams:
            assert len(one) <= DATAGRAM_BYTES_MAX
            self.seen.append(one)
            if self.rng.random() >= self.loss:
                self.under_way.append(one)

    def attack(self, next_seq: int) -> None:
        match self.rng.randrange(5):
            case 0 if self.seen:
                self.under_way.append(self.rng.choice(self.seen))  # an old datagram again
            case 1 if self.seen:
                changed = bytearray(self.rng.choice(self.seen))
                changed[self.rng.randrange(len(changed))] ^= 1 << self.rng.randrange(8)
                self.under_way.append(bytes(changed))
            case 2:
                self.under_way.append(self.rng.randbytes(self.rng.randrange(DATAGRAM_BYTES_MAX)))
            case 3:
                self.under_way += SendingHost(self.rng, self.rng.randbytes(KEY_BYTES)).put()  # a sender without the key
            case _:
                self.under_way += self.of_other_reader(next_seq)

    def of_other_reader(self, next_seq: int) -> Iterator[bytes]:
        """Items by a reader of the channel, who has the key, but cannot sign."""
        encryptor = Encryptor(STREAM, 1, self.key)
        encryptor._number = self.rng.randrange(2**40, 2**41)
        body = self.rng.randbytes(SIGNATURE_BYTES) + encoded([NumberedItem(next_seq, b"false")])
        for part in parts_of(MulticastMessage(MessageKind.ITEMS, next_seq, next_seq + 1, body)):
            yield encryptor.encrypt(part)

    def arriving(self) -> list[bytes]:
        arrive = [one for one in self.under_way if self.rng.random() < 0.7]
        self.under_way = [one for one in self.under_way if one not in arrive]
        self.rng.shuffle(arrive)
        return arrive


class DatagramReader:
    """The reader. It asks the host for missing items as a subscription does."""

    def __init__(self, host: SendingHost, key: bytes) -> None:
        self.host, self.now_s = host, 0.0
        self.got, self.dropped = list[NumberedItem](), 0
        verifier = Verifier(STREAM, host.signer.public_key)
        self.receiving = MulticastReceiver(DatagramOpener(STREAM, 1, key), verifier, 0.0, decoded)

    def step(self, datagrams: list[bytes]) -> None:
        self.now_s += REORDERED_S / 3
        items = self.receiving.take(datagrams, self.now_s)
        self.got += items
        if items:
            return
        step, _ = self.receiving.pace.next_step(self.now_s, is_missing=self.receiving.merge.is_missing)
        if step is RepairStep.REPAIR:
            self.repair()

    def repair(self) -> None:
        merge = self.receiving.merge
        first = merge.next_seq
        if first < self.host.first_held:
            held = merge.take_up_to(self.host.first_held)
            self.dropped += self.host.first_held - first - len(held)
            self.got += held
            first = self.host.first_held
        answer = self.host.items[first - 1 : first - 1 + REPAIR_ITEMS]
        self.got += merge.fill(answer)
        if answer:
            merge.pass_to(answer[-1].seq + 1)
        self.got += merge.take()
        self.receiving.pace.note_request()


@pytest.mark.parametrize("seed", range(40))
def test_each_item_comes_once_in_order_and_unchanged_or_is_counted_as_dropped(seed: int) -> None:
    rng = random.Random(seed)
    key = rng.randbytes(KEY_BYTES)
    host, network = SendingHost(rng, key), Network(rng, key)
    reader = DatagramReader(host, key)
    for _ in range(STEPS):
        network.carry(host.put() if rng.random() < 0.5 else host.beat())
        if rng.random() < 0.4:
            network.attack(rng.randrange(1, host.next_seq + 3))
        reader.step(network.arriving())
    network.loss = 0.0
    while reader.receiving.merge.next_seq < host.next_seq:
        network.carry(host.beat())
        reader.step(network.arriving())
    seqs = [one.seq for one in reader.got]
    assert seqs == sorted(set(seqs))
    assert all(host.items[one.seq - 1] == one for one in reader.got)
    assert len(seqs) + reader.dropped == host.next_seq - 1
    assert reader.receiving.merge.held_bytes == 0
    if network.loss == 0.0 and not reader.receiving.pace.repairs:
        assert reader.dropped == 0


def test_a_reader_that_gets_nothing_but_first_parts_keeps_a_bounded_amount() -> None:
    rng = random.Random(1)
    key = rng.randbytes(KEY_BYTES)
    host = SendingHost(rng, key)
    reader = DatagramReader(host, key).receiving
    body = rng.randbytes(8 * DATA_BYTES_MAX)
    for number in range(1, 2000):
        first = 1 + number * 10
        parts = [*host.sealed(MessageKind.ITEMS, first, first + 1, body)]
        reader.take_datagrams(parts[:-1], 0.0)
    assert reader._assembler.kept_bytes <= ASSEMBLED_BYTES_MAX
    assert reader._assembler.given_up > 0


def test_a_reader_that_gets_small_parts_of_many_messages_counts_the_messages_too() -> None:
    assembler = Assembler(ASSEMBLED_BYTES_MAX)
    for seq in range(1, 20_000):
        assembler.add(MessagePart(MessageKind.ITEMS, seq, seq + 1, 1, 2, b"x"))
    assert assembler.kept_bytes <= ASSEMBLED_BYTES_MAX
    assert len(assembler._parts) < 10_000


def test_a_reader_counts_the_memory_of_held_items_without_payloads() -> None:
    rng = random.Random(3)
    key = rng.randbytes(KEY_BYTES)
    host = SendingHost(rng, key)
    reader = DatagramReader(host, key).receiving
    empty = encoded([NumberedItem(seq, b"") for seq in range(2, 130)])
    reader.take_datagrams(host.sealed(MessageKind.ITEMS, 2, 130, empty), 0.0)
    assert reader.merge.held_bytes > 128 * 200


def test_a_reader_that_lacks_one_item_keeps_a_bounded_amount_of_later_ones() -> None:
    rng = random.Random(2)
    key = rng.randbytes(KEY_BYTES)
    host = SendingHost(rng, key)
    reader = DatagramReader(host, key).receiving
    for seq in range(2, 1200):
        item = encoded([NumberedItem(seq, bytes(8000))])
        reader.take_datagrams(host.sealed(MessageKind.ITEMS, seq, seq + 1, item), 0.0)
    assert 0 < reader.merge.held_bytes <= HELD_BYTES_MAX
    assert reader.merge.announced_seq == 1200
