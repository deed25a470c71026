"""Names the topics of messages whose channel records were in a damaged chunk, by the facts of their own chunk. Pure.

A writer names a topic once, in the chunk with its first message. The last message of each chunk has the facts of all
messages of channels of Stampede RT, with the names of these channels.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

from stampede_rt.files.entries import FACTS_TOPIC, FACTS_VERSION, SEQUENCE_MASK, Topic, encoding_of
from stampede_rt.files.json_text import read_json
from stampede_rt.values.recording import incarnation_of, whole_number


def topics_of(
    unnamed: Mapping[int, Sequence[int]], named: Mapping[tuple[str, int | None], Collection[int]], facts: bytes
) -> dict[int, Topic]:
    """Return the topics by their numbers, as far as the `facts` of the chunk name them.

    `unnamed` has for each number of a topic that the file does not name the sequences of its messages in the chunk, in
    the order of the first messages. `named` has the sequences of the other messages of the chunk by the name and the
    incarnation of their topics. Messages of other programs have no facts, so their topics are not found. If such
    messages have the sequences of a channel, nobody knows which of them are its items: then neither is found.
    """
    runs = _runs_of(unnamed, named, facts)
    found: dict[int, Topic] = {}
    for wanted in {tuple(sequences) for sequences in unnamed.values()}:
        numbers = [number for number, sequences in unnamed.items() if tuple(sequences) == wanted]
        topics = [topic for topic, sequences in runs.items() if tuple(sequences) == wanted]
        if len(numbers) == len(topics):
            found |= zip(numbers, topics, strict=True)  # both have the order of the first messages
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


def _runs_of(
    unnamed: Mapping[int, Sequence[int]], named: Mapping[tuple[str, int | None], Collection[int]], facts: bytes
) -> dict[Topic, list[int]]:
    """Return for each topic of the facts the sequences of its messages that are not `named`; none if they are damaged.

    The topics have the order of their first items. A channel has a topic for each of its content types.
    """
    found: dict[Topic, list[int]] = {}
    messages_max = sum(map(len, unnamed.values())) + sum(map(len, named.values()))
    try:
        for run in read_json(facts)["runs"]:
            name, incarnation = str(run["topic"]), incarnation_of(run["incarnation"])
            first_seq, count = whole_number(run["first_seq"]), whole_number(run["count"])
            if count > messages_max:  # more items than the chunk has messages
                return {}
            known = named.get((name, incarnation), ())
            sequences = ((first_seq + at) & SEQUENCE_MASK for at in range(count))
            if rest := [one for one in sequences if one not in known]:
                topic = Topic(name, encoding_of(str(run["content_type"])), incarnation)
                found.setdefault(topic, []).extend(rest)
                messages_max -= len(rest)
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return {}
    return found
