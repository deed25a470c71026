"""Names the topics of messages whose channel records were in a damaged chunk, by the facts of their own chunk. Pure.

A writer names a topic once, in the chunk with its first message. The last message of each chunk has the facts of all
messages of channels of Stampede RT, with the names of these channels.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from typing import NamedTuple

from stampede_rt.files.entries import FACTS_TOPIC, FACTS_VERSION, Topic, encoding_of
from stampede_rt.files.json_text import read_json
from stampede_rt.values.recording import incarnation_of, whole_number


class UnnamedMessages(NamedTuple):
    """The messages of a chunk whose topic the file does not name, under one `number`."""

    number: int
    first_sequence: int
    messages: int


def topics_of(unnamed: Iterable[UnnamedMessages], facts: bytes, named: Collection[Topic]) -> dict[int, Topic]:
    """Return the topics by their numbers, as far as the `facts` of the chunk name them.

    `unnamed`: in the order of their first messages, without the message of the facts. `named`: the topics that the file
    names. Messages of other programs have no facts, so their topics are not found.
    """
    known = {(one.name, one.incarnation) for one in named}
    runs = [one for one in _runs_of(facts) if (one.topic.name, one.topic.incarnation) not in known]
    found: dict[int, Topic] = {}
    for one in unnamed:  # the runs have the same order
        if runs and (runs[0].first_seq & 0xFFFFFFFF, runs[0].items) == (one.first_sequence, one.messages):
            found[one.number] = runs.pop(0).topic
    return found


def facts_topic() -> Topic:
    """Return the topic of the facts."""
    return Topic(FACTS_TOPIC, "json")


def is_facts(data: bytes) -> bool:
    """Whether a message has the facts of a chunk."""
    try:
        value = read_json(data)
    except (ValueError, RecursionError):
        return False
    return isinstance(value, dict) and value.get("version") == FACTS_VERSION and {"runs", "gaps"} <= value.keys()


class _RunsOfTopic(NamedTuple):
    topic: Topic
    first_seq: int
    items: int


def _runs_of(facts: bytes) -> list[_RunsOfTopic]:
    """Return the topics of the facts with their items, in the order of their first items; none if they are damaged."""
    found: dict[tuple[str, int], _RunsOfTopic] = {}
    try:
        for run in read_json(facts)["runs"]:
            name, incarnation = str(run["topic"]), incarnation_of(run["incarnation"])
            topic = Topic(name, encoding_of(str(run["content_type"])), incarnation)
            first = found.setdefault((name, incarnation), _RunsOfTopic(topic, whole_number(run["first_seq"]), 0))
            found[name, incarnation] = first._replace(items=first.items + whole_number(run["count"]))
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return []
    return [*found.values()]
