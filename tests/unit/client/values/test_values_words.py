"""The types of the public arguments: they have names, and allow exactly the accepted words."""

from __future__ import annotations

import inspect
import typing

import pytest

import stampede_rt as st
from stampede_rt.errors import InvalidArgument
from stampede_rt.values import codecs, grouping, model, policy, queueing, reading, timeline

WORDS = [
    (timeline.Bounds, lambda word: timeline.parse_interval(0, 1, word)),
    (typing.get_args(timeline.MatchLike)[0], timeline.parse_match),
    (model.OnFull, lambda word: policy.parse_policy(on_full=word)),
    (model.OnFull, lambda word: queueing.parse_queue_policy(on_full=word)),
    (grouping.GroupBound, grouping.parse_group_bound),
    (typing.get_args(codecs.CodecLike)[0], lambda word: codecs.HandleCodec.parse(word, "a channel")),
]
TYPED = [
    (st.Connection.channel, "on_full", "OnFull | None"), (st.Connection.channel, "codec", "CodecLike | None"),
    (st.Connection.queue, "on_full", "OnFull | None"), (st.Connection.group, "bound", "GroupBound"),
    (st.Connection.cross_section, "over", "Over"), (st.Channel.get, "bounds", "Bounds"),
    (st.Channel.get, "match", "MatchLike"), (st.Channel.subscribe, "mode", "SubscribeMode"),
    (st.Channel.on_item, "mode", "SubscribeMode"), (st.Group.get, "match", "MatchLike"),
    (st.Group.get, "bounds", "Bounds"), (st.Channel.configure, "on_full", "OnFull | None"),
]  # fmt: skip


def test_the_kinds_of_arguments_can_be_named() -> None:
    named = ("BoundLike", "Bounds", "CodecLike", "DurationLike", "InstantLike", "MatchLike", "OnFull", "SubscribeMode")
    assert set(named) <= set(st.__all__)
    assert all(getattr(st, name) is not None for name in named)


@pytest.mark.parametrize(("words", "parse"), WORDS)
def test_only_the_words_of_a_type_are_accepted(words: object, parse: typing.Callable[[str], object]) -> None:
    for word in typing.get_args(words):
        parse(word)
    with pytest.raises(InvalidArgument):
        parse("another word")


def test_both_modes_of_subscriptions_have_a_type() -> None:
    from stampede_rt.wire import subscribing

    assert set(typing.get_args(reading.SubscribeMode)) == set(subscribing._MODES)


@pytest.mark.parametrize(("function", "argument", "annotation"), TYPED)
def test_the_annotation_of_an_argument_lists_the_words_that_it_accepts(
    function: object, argument: str, annotation: str
) -> None:
    assert inspect.signature(function).parameters[argument].annotation == annotation  # type: ignore[arg-type]


def test_a_group_has_only_attributes_for_its_users() -> None:
    shown = {name for name in dir(st.Group) if not name.startswith("_")}
    assert shown == {
        "add", "channels", "delete", "get", "incarnation", "info", "match", "name", "newest", "refresh", "remove",
        "status", "subscribe",
    }  # fmt: skip
