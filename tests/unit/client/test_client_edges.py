"""Checks of arguments at the edge; caches and retries; errors on the wire."""

from __future__ import annotations

from pathlib import Path

import pytest

import stampede_rt as st
from stampede_rt import errors, status
from stampede_rt.cluster.addresses import parse_addresses
from stampede_rt.cluster.binding import Binding, BindingCache, Owner, order_by_round_trip
from stampede_rt.cluster.connecting import parse_target
from stampede_rt.errors import InvalidArgument, InvalidName, PermissionDenied
from stampede_rt.pacing.retry import DELAY_S_MAX, Backoff
from stampede_rt.security.credentials import read_secret
from stampede_rt.v1 import error_pb2
from stampede_rt.values.payloads import check_attributes, check_payload
from stampede_rt.values.policy import parse_name, parse_policy
from stampede_rt.values.reading import ReadQuery, Wait, parse_limit
from stampede_rt.values.timeline import last, parse_interval
from stampede_rt.wire.batching import RunBuilder
from stampede_rt.wire.delivered import RUN_ITEMS_MAX
from stampede_rt.wire.runs import RUN_BYTES_MAX, parse_run


@pytest.mark.parametrize(
    ("url", "targets"),
    [
        ("rig", ("rig:7580",)),
        ("a:1,b:2", ("a:1", "b:2")),
        ("stampede://a:1", ("a:1",)),
        ("[::1]:80", ("[::1]:80",)),
        ("::1", ("[::1]:7580",)),
        ("unix:/tmp/s", ("unix:/tmp/s",)),
    ],
)
def test_addresses_are_hosts_and_ports(url: str, targets: tuple[str, ...]) -> None:
    assert parse_addresses(url) == targets


@pytest.mark.parametrize("url", ["", "a:0", "a:99999", "a:b", ":80", ",".join("abcdefghijklmnopqrstu")])
def test_a_wrong_address_is_named(url: str) -> None:
    with pytest.raises(InvalidArgument, match="address"):
        parse_addresses(url)


def test_an_address_that_is_no_text_is_named() -> None:
    with pytest.raises(InvalidArgument, match="7580; give it as text"):
        parse_addresses(7580)  # type: ignore[arg-type]


def test_a_name_that_is_empty_is_refused_and_not_left_out() -> None:
    with pytest.raises(InvalidName, match="not allowed; use"):
        parse_target("rig", name="", secret=None, zone=None)


@pytest.mark.parametrize("name", ["a", "A", "LSL/EEG_Amp-1", "cam/left", "0-9._/-", "a" * 128])
def test_names_within_the_grammar_are_accepted(name: str) -> None:
    assert parse_name(name) == name


@pytest.mark.parametrize("name", ["", "/a", "a b", "a" * 129, "cam\n", "ü", None])
def test_a_name_outside_the_grammar_is_refused(name: object) -> None:
    with pytest.raises(InvalidName, match="not allowed; use"):
        parse_name(name)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("argument", "value"),
    [
        ("max_age", 10), ("max_age", "0s"), ("max_age", "-1s"), ("max_items", 0), ("max_items", 1.5), ("max_bytes", -1),
        ("max_items", True), ("on_full", "wait"), ("max_future", "-1s"), ("content_type", ""), ("consumers", "two"),
        ("content_type", 3),
    ],
)  # fmt: skip
def test_a_wrong_policy_names_the_argument(argument: str, value: object) -> None:
    with pytest.raises(InvalidArgument, match=argument):
        parse_policy(**{argument: value})  # type: ignore[arg-type]


@pytest.mark.parametrize("timeout", [-1, float("nan"), float("inf"), "1", True])
def test_a_wrong_timeout_is_refused(timeout: object) -> None:
    with pytest.raises(InvalidArgument, match="timeout"):
        Wait.parse(timeout)  # type: ignore[arg-type]


@pytest.mark.parametrize("limit", [0, -1, 1.5, 2**32, True])
def test_a_wrong_limit_is_refused(limit: object) -> None:
    with pytest.raises(InvalidArgument, match="limit"):
        parse_limit(limit)  # type: ignore[arg-type]


@pytest.mark.parametrize("flag", ["newest_first", "payloads", "complete"])
def test_a_value_that_is_no_flag_is_refused(flag: str) -> None:
    """In an earlier version, the text "no" counted as yes, or failed inside protobuf."""
    with pytest.raises(InvalidArgument, match=f"{flag} is 'no'; write True or False"):
        ReadQuery(parse_interval(1, 2), **{flag: "no"})  # type: ignore[arg-type]


def test_last_refuses_a_negative_duration() -> None:
    with pytest.raises(InvalidArgument, match="leave the minus out"):
        last("-5s")


def test_anything_with_a_buffer_is_a_payload_but_text_is_not() -> None:
    assert check_payload(bytearray(b"x")) == check_payload(memoryview(b"x")) == b"x"
    with pytest.raises(InvalidArgument, match="encode"):
        check_payload("x")


@pytest.mark.parametrize("attributes", [{"a": 1}, {1: "a"}, ["a"], "a", {"a": "\ud800"}])
def test_attributes_must_be_text(attributes: object) -> None:
    with pytest.raises(InvalidArgument, match="attributes"):
        check_attributes(attributes)  # type: ignore[arg-type]


def test_delays_double_up_to_a_bound_and_end_at_the_deadline() -> None:
    backoff = Backoff(deadline_s=100.0)
    delays = [backoff.next_delay_s(0.0, 0.999) for _ in range(12)]
    assert delays == sorted(delays)  # type: ignore[type-var]
    assert max(delays) <= DELAY_S_MAX  # type: ignore[type-var, operator]
    assert backoff.next_delay_s(99.9999, 0.5) == pytest.approx(0.0001)
    assert backoff.next_delay_s(100.0, 0.5) is None


def test_the_nearest_supernode_comes_first_and_the_silent_ones_last() -> None:
    assert order_by_round_trip(["a", "b", "c", "d"], {"c": 0.1, "a": 0.2}) == ["c", "a", "b", "d"]
    assert order_by_round_trip(["a", "b", "c"], {"c": 0.1, "a": 0.2}, {"c", "b"}) == ["a", "c", "b"]


def test_a_stale_binding_is_forgotten_for_every_thread() -> None:
    cache = BindingCache()
    cache.learn_owner(b"c", Owner(host_id=b"h", epoch=1, spec_version=1), ["h:1"])
    binding = Binding(subject_id=b"c", target="h:1", epoch=1, incarnation=1)
    cache.learn_binding(binding, 1)
    cache.learn_binding(binding, 2)
    assert cache.binding(b"c", 2) is binding
    cache.forget(b"c")
    assert (cache.binding(b"c", 1), cache.binding(b"c", 2), cache.owner(b"c")) == (None, None, None)
    assert cache.gatekeepers(b"h") == ()


def test_a_run_holds_as_many_items_as_fit_and_the_next_run_continues_their_numbers() -> None:
    builder = RunBuilder()
    for number in range(RUN_ITEMS_MAX):
        assert builder.has_room(1)
        builder.add((b"x", number, None, None, ""), 1)
    assert not builder.has_room(1)
    run = builder.cut()
    assert run == builder.cut(), "the items wait until the caller drops them"
    builder.add((b"x", None, 5, {"a": "b"}, ""), 1)  # as a signal handler may add one
    builder.drop(run)
    assert (run.first_number, run.items, builder.next_number) == (1, RUN_ITEMS_MAX, RUN_ITEMS_MAX + 1)
    assert parse_run(b"".join(run.encoded)).durations is None
    assert not builder.has_room(RUN_BYTES_MAX)
    assert parse_run(b"".join(builder.cut().encoded)).durations == [5]


def test_items_that_do_not_fit_together_come_into_runs_of_their_own() -> None:
    builder = RunBuilder()
    kinds: list[tuple[int | None, dict[str, str] | None, str]] = [
        (None, None, ""), (1, None, ""), (1, {"a": "b"}, ""), (1, {"a": "c"}, ""), (1, {"a": "c"}, "text/plain"),
    ]  # fmt: skip
    for time, attributes, content_type in kinds:
        for _ in range(2):
            builder.add((b"x", time, None, attributes, content_type), 1)
    long = bytes(RUN_BYTES_MAX)
    for _ in range(2):
        builder.add((long, None, None, None, ""), len(long))
    runs = []
    while len(builder):
        runs.append(builder.cut())
        builder.drop(runs[-1])
    assert [(run.first_number, run.items) for run in runs] == [(1, 2), (3, 2), (5, 2), (7, 2), (9, 2), (11, 1), (12, 1)]
    assert builder.length_bytes == 0


@pytest.mark.parametrize("reason", [name.removeprefix("ERROR_REASON_") for name in error_pb2.ErrorReason.keys()[1:]])
def test_every_reason_and_its_metadata_are_the_same_after_encoding_and_decoding(reason: str) -> None:
    error = errors.error_for(reason, "what happened", {"channel": "cam"})
    found = status.from_error_message(status.to_error_message(error))
    assert (type(found), found.reason, found.message, found.metadata) == (
        type(error),
        reason,
        "what happened",
        {"channel": "cam"},
    )
    assert status.code_for(reason).name != "UNKNOWN"
    assert reason == "INTERNAL" or status.code_for(reason).name != "INTERNAL"


def test_the_users_secret_is_sent_only_to_this_machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("STAMPEDE_SECRET_FILE", raising=False)
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    secret = tmp_path / "stampede" / "secret"
    secret.parent.mkdir()
    secret.write_text("s3cret\n")
    secret.chmod(0o600)
    assert parse_target("localhost:1", name=None, secret=None, zone=None).credentials.present_secret() == "s3cret"
    assert parse_target("elsewhere:1", name=None, secret=None, zone=None).credentials.present_secret() is None
    monkeypatch.setenv("STAMPEDE_SECRET_FILE", str(secret))
    assert parse_target("elsewhere:1", name=None, secret=None, zone=None).credentials.present_secret() == "s3cret"


def test_a_secret_that_everyone_may_read_is_refused(tmp_path: Path) -> None:
    secret = tmp_path / "secret"
    secret.write_text("s3cret")
    secret.chmod(0o644)
    with pytest.raises(PermissionDenied, match="chmod 600"):
        read_secret(secret)
    assert read_secret(tmp_path / "absent") is None


@pytest.mark.parametrize("text", [None, ""])
def test_a_named_secret_file_must_hold_a_secret(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, text: str | None
) -> None:
    secret = tmp_path / "secret"
    if text is not None:
        secret.touch(0o600)
    monkeypatch.setenv("STAMPEDE_SECRET_FILE", str(secret))
    with pytest.raises(PermissionDenied, match=f"names {secret}, where there is no secret"):
        parse_target("localhost:1", name=None, secret=None, zone=None)


def test_the_public_names_are_the_listed_ones() -> None:
    for name in st.__all__:
        assert getattr(st, name) is not None
    public = {name for name in vars(st) if not name.startswith("_")}
    modules = {name for name in public if type(getattr(st, name)).__name__ == "module"}
    assert public - modules - {"annotations"} == set(st.__all__) - {"__version__"}
