"""A rosbag2 whose metadata does not agree with its files: no message is left out in silence."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from rosbags.rosbag2 import StoragePlugin
from ruamel.yaml import YAML

from stampede_rt.files.entries import FileEntry
from stampede_rt.files.foreign import source_of
from stampede_rt.values.timeline import MAX_INSTANT, MIN_INSTANT
from tests.support.files.foreign_files import bag_of_topics
from tests.support.files.recordings import MS, START

ALL = (MIN_INSTANT, MAX_INSTANT)
TIMES = {"/a": [3, 4], "/b": [5, 6, 7]}
PLUGINS = [StoragePlugin.SQLITE3, StoragePlugin.MCAP]


def edited(bag: Path, edit: Callable[[dict[str, Any]], object]) -> Path:
    """Change the metadata of a bag."""
    yaml, path = YAML(), bag / "metadata.yaml"
    content = yaml.load(path.read_text())
    edit(content["rosbag2_bagfile_information"])
    with path.open("w") as file:
        yaml.dump(content, file)
    return bag


def played(bag: Path) -> tuple[list[str], list[str]]:
    """The topics of the items, and the losses. The source names all topics before it gives items."""
    source = source_of(bag)
    topics = {one.name for one in source.topics(lambda _: True)}
    items = [event.topic.name for _, event in source.events(lambda _: True, *ALL) if isinstance(event, FileEntry)]
    assert topics == {*items}
    damaged = [*source.damaged]
    source.close()
    return items, damaged


@pytest.mark.parametrize("plugin", PLUGINS)
def test_a_topic_without_messages_in_the_metadata_is_read(tmp_path: Path, plugin: StoragePlugin) -> None:
    def forget_counts(metadata: dict[str, Any]) -> None:
        metadata["topics_with_message_count"][0]["message_count"] = 0

    bag = edited(bag_of_topics(tmp_path / "bag", plugin, TIMES | {"/empty": []}), forget_counts)
    assert played(bag) == (["/a"] * 2 + ["/b"] * 3, [])


@pytest.mark.parametrize("plugin", PLUGINS)
def test_a_topic_and_a_file_that_the_metadata_does_not_name_are_named(tmp_path: Path, plugin: StoragePlugin) -> None:
    bag = edited(bag_of_topics(tmp_path / "bag", plugin, TIMES), lambda metadata: _forget(metadata, "/b"))
    [file] = (one for one in bag.iterdir() if one.name != "metadata.yaml")
    shutil.copy(file, bag / f"another{file.suffix}")
    items, damaged = played(bag)
    assert items == ["/a"] * 2
    assert damaged == [
        f"the messages in the file 'another{file.suffix}', which the metadata.yaml of the bag does not name",
        "3 of the 3 messages of topic '/b'",
    ]


def _forget(metadata: dict[str, Any], name: str) -> None:
    topics = metadata["topics_with_message_count"]
    metadata["topics_with_message_count"] = [one for one in topics if one["topic_metadata"]["name"] != name]


@pytest.mark.parametrize("plugin", PLUGINS)
def test_the_first_and_the_last_time_come_from_the_messages_in_all_files(tmp_path: Path, plugin: StoragePlugin) -> None:
    """The second file has earlier messages than the first one, and the metadata has no times."""
    bag = bag_of_topics(tmp_path / "bag", plugin, TIMES)
    [other] = (
        one for one in bag_of_topics(tmp_path / "other", plugin, {"/a": [1, 9]}).iterdir() if one.suffix != ".yaml"
    )
    shutil.move(other, bag)

    def join(metadata: dict[str, Any]) -> None:
        metadata["relative_file_paths"].append(other.name)
        metadata["topics_with_message_count"][0]["message_count"] += 2
        metadata["starting_time"]["nanoseconds_since_epoch"] = metadata["duration"]["nanoseconds"] = 0

    source = source_of(edited(bag, join))
    [found, _] = source.topics(lambda _: True)
    assert (found.start, found.end) == (START + MS, START + 9 * MS)
    assert source.first_time("/a", *ALL) == START + MS
    assert source.first_time("/a", START + 2 * MS, MAX_INSTANT) == START + 3 * MS
    source.close()
