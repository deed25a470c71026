"""The examples in docs/wire.md agree with the contract."""

from __future__ import annotations

import re

import grpc

from stampede_rt.errors import NotLeader, StaleBinding, WrongCluster, error_for
from stampede_rt.status import code_for
from stampede_rt.v1 import error_pb2, item_pb2
from tests.polyglot.toolchains import PROTO, ROOT

REPEATABLE = (
    grpc.StatusCode.UNAVAILABLE,
    grpc.StatusCode.RESOURCE_EXHAUSTED,
    grpc.StatusCode.DATA_LOSS,
    grpc.StatusCode.OUT_OF_RANGE,
)
WIRE = (ROOT / "docs" / "wire.md").read_text()
HEX_LINE = re.compile(r"^((?:[0-9a-f]{2} )+ +)", re.MULTILINE)


def shown_bytes() -> list[bytes]:
    """The bytes of each block of hexadecimal numbers, in the order of the page."""
    blocks = re.findall(r"^```\n(.*?)^```", WIRE, re.MULTILINE | re.DOTALL)
    shown = ["".join(HEX_LINE.findall(block)) for block in blocks]
    return [bytes.fromhex(text) for text in shown if text]


def test_the_run_in_the_picture_is_a_run_and_the_host_appends_its_seq() -> None:
    producer, host, _ = shown_bytes()
    run = item_pb2.ItemRun.FromString(producer)
    assert len(producer) == 45
    assert (list(run.time_unix_nano), list(run.duration_nanos)) == ([1_760_000_000_000_000_000], [33_000_000])
    assert (list(run.payload_length_bytes), run.content_type, run.payloads) == ([5], "text/plain", b"hello")
    assert (run.first_seq, item_pb2.ItemRun.FromString(producer + host).first_seq) == (0, 41)


def test_the_run_of_two_in_the_picture_has_two_items() -> None:
    *_, shown = shown_bytes()
    run = item_pb2.ItemRun.FromString(shown)
    first, second = run.time_unix_nano
    assert (len(shown), second - first) == (37, 33_000_000)
    assert (list(run.payload_length_bytes), run.payloads) == ([5, 2], b"hellohi")


def test_the_page_names_every_service_of_the_contract() -> None:
    services = {
        name
        for source in PROTO.rglob("*.proto")
        for name in re.findall(r"^service (\w+)", source.read_text(), re.MULTILINE)
    }
    assert services
    assert {name for name in services if f"`{name}`" not in WIRE} == set()


def test_the_page_gives_advice_for_every_repeatable_reason() -> None:
    known = {name.removeprefix("ERROR_REASON_") for name in error_pb2.ErrorReason.DESCRIPTOR.values_by_name}
    repeatable = {name for name in known if code_for(name) in REPEATABLE or is_about_another_server(name)}
    table = WIRE.split("What to do with a reason:")[1].split("A newer server")[0]
    named = set(re.findall(r"`([A-Z_]+)`", table))
    assert repeatable <= named <= known


def is_about_another_server(reason: str) -> bool:
    """Whether the request is right, but the caller has sent it to the wrong server."""
    return isinstance(error_for(reason, ""), StaleBinding | NotLeader | WrongCluster)
