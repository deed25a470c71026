"""Readers of recordings: MCAP files that are damaged, foreign or hostile."""

from __future__ import annotations

import json
import tempfile
from functools import cache
from pathlib import Path

from stampede_rt.errors import FileError
from stampede_rt.files.cells import cells_of
from stampede_rt.files.editing import recover, verify
from stampede_rt.files.entries import FileAdvance, ReadFacts, Topic, item_entry
from stampede_rt.files.sources import McapSource
from stampede_rt.values.timeline import MAX_INSTANT, MIN_INSTANT
from tests.robustness.fuzz import hostile_values
from tests.robustness.fuzz.drawing import ByteSource
from tests.robustness.fuzz.parsers.files import content
from tests.robustness.fuzz.parsers.target import Target
from tests.support.files.recordings import INCARNATION, START, entries, gap, item, topic, write


@cache
def sound(compression: str) -> bytes:
    """A recording with each kind of part."""
    with tempfile.TemporaryDirectory() as folder:
        last = item_entry(topic(), item(13, b"{}", duration=3, k="v", content_type="application/json"))
        events = [*entries("cam", range(1, 11)), gap("cam", 11, 12), last, FileAdvance("cam", INCARNATION, START, 13)]
        return write(Path(folder, "a.mcap"), events, chunk_items=4, compression=compression).read_bytes()


def recording(source: ByteSource) -> None:
    """The readers read or refuse any file. Now and then the function also checks that a recovered file is intact."""
    with tempfile.TemporaryDirectory() as folder:
        path, saved = Path(folder, "a.mcap"), Path(folder, "b.mcap")
        path.write_bytes(content(source, sound(source.choice(("none", "zstd", "lz4")))))
        verify(path)
        if source.chance(2):
            recover(path, saved)
            assert verify(saved).intact
        _play(path)


def facts(source: ByteSource) -> None:
    """Facts with a right checksum and wrong JSON."""
    run = {"topic": "cam", "incarnation": "1", "first_seq": 1, "count": 2, "content_type": "", "attributes": {}}
    good = {"version": 1, "runs": [run], "gaps": [gap("cam", 3, 4).to_json()], "advances": []}
    found = ReadFacts.decode([content(source, json.dumps(good).encode())])
    for sequence in (1, 2, 3):
        item_facts = found.of(Topic("cam", "", 1), sequence)
        assert item_facts is None or item_facts.seq & 0xFFFFFFFF == sequence


def cells(source: ByteSource) -> None:
    """Payloads as cells of a table."""
    kind = source.choice(("application/json", "application/x-npy", "", hostile_values.text(source)))
    cells_of(content(source, b'{"a":[1,2.5],"b":{"c":"x"}}'), kind)


def _play(path: Path) -> None:
    source = McapSource(path)
    try:
        for _ in source.events(lambda _: True, MIN_INSTANT, MAX_INSTANT):
            pass
    finally:
        source.close()


TARGETS = (
    Target("recording", recording, (FileError,)),
    Target("recording_facts", facts, (ValueError,)),
    Target("recording_cells", cells, (FileError,)),
)
