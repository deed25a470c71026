"""Makes and reads recordings without a cluster."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from stampede_rt.files.chunk_content import ChunkContent, Event
from stampede_rt.files.editing import finish_with
from stampede_rt.files.entries import FileAdvance, FileEntry, Topic, item_entry
from stampede_rt.files.file_tally import FileTally
from stampede_rt.files.framing import Damage
from stampede_rt.files.reading import FileReader
from stampede_rt.files.writing import FileWriter
from stampede_rt.values.model import Item
from stampede_rt.values.recording import RecordingGap

START = 1_769_860_800_000_000_000
MS = 1_000_000
INCARNATION = 2**63 + 17


def topic(name: str = "cam", encoding: str = "application/octet-stream") -> Topic:
    return Topic(name, encoding, INCARNATION)


def item(seq: int, payload: bytes = b"x", *, time: int | None = None, duration: int | None = None, **rest: str) -> Item:
    time = START + seq * MS if time is None else time
    kind = rest.pop("content_type", "")
    return Item(time, None, duration, seq, payload, rest, kind, len(payload), INCARNATION)


def entries(name: str, seqs: Iterable[int], payload: bytes = b"x") -> list[FileEntry]:
    return [item_entry(topic(name), item(seq, payload + b"%d" % seq)) for seq in seqs]


def gap(name: str, first: int, last: int) -> RecordingGap:
    return RecordingGap(
        channel=name, incarnation=INCARNATION, reason="COLLECTED", detail="too slow", first_seq=first, last_seq=last,
        items=last - first + 1,
    )  # fmt: skip


def write(path: Path, events: Iterable[Event], *, chunk_items: int = 10, finish: bool = True, **settings: str) -> Path:
    """Write a file with a chunk for each `chunk_items` events."""
    writer, tally = FileWriter(path, **settings), FileTally()
    for number, event in enumerate(events):
        tally.add(event)
        if isinstance(event, FileEntry):
            writer.add((event,))
        elif isinstance(event, FileAdvance):
            writer.add_advance(event)
        else:
            writer.add_gap(event)
        if number % chunk_items == chunk_items - 1:
            writer.flush()
    if finish:
        finish_with(writer, tally.summary(str(path)))
    else:
        writer.flush()
        writer.abandon()
    return path


def read(path: Path) -> tuple[list[Event], list[Damage]]:
    """All events of a file, and its damages."""
    events: list[Event] = []
    damages: list[Damage] = []
    with FileReader(path) as reader:
        for part in reader.contents():
            if isinstance(part, ChunkContent):
                events += part.in_host_order()
            elif isinstance(part, Damage):
                damages.append(part)
    return events, damages


def seqs_of(events: Sequence[Event], name: str = "cam") -> list[int | None]:
    return [event.seq for event in events if isinstance(event, FileEntry) and event.topic.name == name]
