"""Texts that people, programs and other machines write: addresses, times, names, patterns, tokens."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from stampede_rt.cli.arguments import parse_attribute, parse_bound_text, parse_time
from stampede_rt.cluster.addresses import is_loopback, parse_addresses
from stampede_rt.cluster.request_age import METADATA_KEY, request_age_nanos
from stampede_rt.errors import InvalidArgument, StampedeError
from stampede_rt.values import policy, queueing, timeline
from stampede_rt_runtime import identity, values
from stampede_rt_runtime.roles import roles_for
from stampede_rt_supernode.core import page_tokens
from stampede_rt_supernode.core.glob import fixed_prefix, matcher
from stampede_rt_supernode.joining.join_tokens import JoinTokens, log_cluster_of
from stampede_rt_supernode.replication import Member
from tests.robustness.fuzz import hostile_values
from tests.robustness.fuzz.drawing import ByteSource
from tests.robustness.fuzz.parsers.target import Target

PIECES = ("localhost", "127.0.0.1", "[::1]", ":", ",", "7580", "0", "%", ".", "-", "+", "now", "newest", "oldest", "s")
DIGITS = "1" * 5000


def composed(source: ByteSource) -> str:
    """A text made of pieces that some parser knows, and of hostile texts."""
    count = source.choice((1, 3, 2, 5, 8))
    pieces = [source.choice(PIECES) if source.chance(60) else hostile_values.text(source) for _ in range(count)]
    return DIGITS if source.chance(1) else "".join(pieces)


def _each(*parsers: Callable[[str], Any]) -> Callable[[ByteSource], None]:
    """Return a function that calls one of the parsers. The input chooses the parser."""

    def parse(source: ByteSource) -> None:
        source.choice(parsers)(composed(source))

    return parse


def _duration(text: str) -> None:
    nanos = timeline.parse_duration(text)
    timeline.format_duration(nanos)
    timeline.parse_item_duration(nanos) if nanos >= 0 else None


def _addresses(text: str) -> None:
    for address in parse_addresses(text):
        is_loopback(address)
        assert address.startswith("unix:") or address.isprintable(), address
        assert address.startswith("unix:") or values.parse_target(address), "the services take the same addresses"


def _time(text: str) -> None:
    timeline.format_instant(parse_time(text))


def _identity(text: str) -> None:
    found = identity.identity_among([f"{identity.SCHEME}{text}"])
    if found is not None:
        assert identity.parse_identity(str(found)) == found
        assert "/" not in found.file_stem


def page_token(source: ByteSource) -> None:
    """Check that a page token gives back the position in it, and that any other text is read or refused."""
    name, token = composed(source), composed(source)
    assert page_tokens.read_name(page_tokens.write_name(name)) == name
    for read in (page_tokens.read_name, page_tokens.read_host):
        read(token)
    listing = composed(source)
    page_tokens.read_listing(token, listing)
    page_tokens.read_position(token, listing)
    page_tokens.read_peer(token, listing)


def glob(source: ByteSource) -> None:
    """Check that a pattern matches only names with its fixed prefix. Slow patterns are findings, too."""
    pattern, name = composed(source), composed(source)
    matches = matcher(pattern)
    matches(name)
    matches("a" * 128)
    assert not matches(name) or name.startswith(fixed_prefix(pattern)) or pattern in ("", "*")


def join_token(source: ByteSource) -> None:
    """Check that only the token itself is accepted, and that every other text is refused with a documented error."""
    tokens, newcomer = JoinTokens(b"k" * 32), Member(member_id="s9", address="localhost:1")
    real = tokens.make(b"r" * 16, newcomer, valid_until_unix_nano=10**18, log_cluster_id=composed(source))
    assert tokens.check(real, newcomer, now_unix_nano=1)
    at = source.below(len(real))
    forged = composed(source) if source.chance(30) else real[:at] + composed(source) + real[at + source.below(3) :]
    if forged != real:
        log_cluster_of(forged)
        tokens.check(forged, newcomer, now_unix_nano=1)
        raise AssertionError(f"a forged token was accepted: {forged!r}")


def request_age(source: ByteSource) -> None:
    assert request_age_nanos([(METADATA_KEY, composed(source))]) >= 0


def role(source: ByteSource) -> None:
    assert not roles_for(composed(source)) & roles_for("/stampede_rt.v1.RaftService/Exchange")


REFUSED = (StampedeError,)
TARGETS = (
    Target("duration", _each(_duration), REFUSED),
    Target("time", _each(_time, parse_bound_text), REFUSED),
    Target("addresses", _each(_addresses), (InvalidArgument,)),
    Target("name", _each(policy.parse_name, policy.content_type_of, queueing.parse_message_id), REFUSED),
    Target("attribute", _each(parse_attribute), REFUSED),
    Target(
        "setting",
        _each(values.parse_address_text, values.parse_duration, values.parse_size, values.parse_int, values.parse_bool),
        (ValueError,),
    ),
    Target("identity", _each(_identity), ()),
    Target("page_token", page_token, (InvalidArgument,)),
    Target("glob", glob, (InvalidArgument,)),
    Target("join_token", join_token, REFUSED),
    Target("request_age", request_age, (InvalidArgument,)),
    Target("role", role, ()),
)
