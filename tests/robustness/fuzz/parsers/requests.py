"""Requests, as hosts and supernodes read them once gRPC has handed the bytes over."""

from __future__ import annotations

from google.protobuf.message import DecodeError

from stampede_rt.errors import StampedeError
from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt.v1 import group_pb2, item_pb2, queue_pb2, raw_run_pb2
from stampede_rt.v1 import queue_service_pb2 as queue_pb
from stampede_rt.wire.run_slices import RunSlicer
from stampede_rt.wire.runs import parse_run, seal_run, select_items
from stampede_rt.wire.stream_frames import FrameKind, FrameReader, frame_of
from stampede_rt_channel_host.channels import requests
from stampede_rt_channel_host.channels.puts import put_requests
from stampede_rt_channel_host.cluster.cut_floors import floor_from_message, floor_to_message
from stampede_rt_channel_host.cluster.records import recorded_group
from stampede_rt_channel_host.groups.messages import times_from_message
from stampede_rt_channel_host.queues.incoming import enqueue_of
from stampede_rt_channel_host.queues.incoming import read_request as read_enqueues
from stampede_rt_channel_host.queues.requests import page_size_of, settlements_of, taker_of
from tests.robustness.fuzz.drawing import ByteSource
from tests.robustness.fuzz.messages import KnownValues, drawn_message, drawn_request
from tests.robustness.fuzz.parsers.target import Target

KNOWN = KnownValues()
KNOWN.add("delivery_id", 1, 2)
KNOWN.add("taker_id", 1, 2)
KNOWN.add("queue_id", b"q" * 16)
SEQ = 7


def item_run(source: ByteSource) -> None:
    """An accepted run is stored, cut and sent on: all readers must find the same items in it."""
    raw = drawn_request(source, item_pb2.ItemRun.DESCRIPTOR, KNOWN) if source.chance(80) else source.rest()
    columns = parse_run(raw)
    stamped = None if columns.times is not None else [5] * len(columns.lengths)
    sealed = seal_run(raw, SEQ, stamped)
    _check_slices(sealed)
    kept = [place for place in range(len(columns.lengths)) if source.chance(50)]
    if kept:
        _check_slices(seal_run(select_items(raw, kept), SEQ, None if stamped is None else stamped[: len(kept)]))


def _check_slices(sealed: bytes) -> None:
    whole, slicer = item_pb2.ItemRun.FromString(sealed), RunSlicer(sealed)
    items = len(whole.payload_length_bytes)
    assert len(whole.time_unix_nano) == items, "each item has a time once it is stored"
    parts = [item_pb2.ItemRun.FromString(slicer.cut(place, place + 1)) for place in range(items)]
    assert b"".join(part.payloads for part in parts) == whole.payloads
    assert [part.first_seq for part in parts] == [SEQ + place for place in range(items)]
    assert [time for part in parts for time in part.time_unix_nano] == list(whole.time_unix_nano)
    assert [time for part in parts for time in part.duration_nanos] == list(whole.duration_nanos)
    assert all(part.attributes == whole.attributes for part in parts)
    assert all(part.content_type == whole.content_type for part in parts)
    bare = item_pb2.ItemRun.FromString(slicer.cut(0, items, without_payloads=True))
    assert (bare.payloads, list(bare.payload_length_bytes)) == (b"", list(whole.payload_length_bytes))


def put_frames(source: ByteSource) -> None:
    """The runs that a host finds in a request. Both forms of the message must give the same runs."""
    raw = drawn_request(source, pb.PutRequest.DESCRIPTOR, KNOWN)
    request = put_requests.read_request(raw)
    known = requests.parse(raw_run_pb2.RawPutRequest, raw, "PutRequest")
    assert [bytes(put.run) for put in request.puts] == [put.run for put in known.puts]
    assert [put.first_number for put in request.puts] == [put.first_number for put in known.puts]
    for put in request.puts:
        parse_run(put.run)
        assert item_pb2.ItemRun.FromString(bytes(put.run)) is not None


def get(source: ByteSource) -> None:
    request = requests.parse(pb.GetRequest, drawn_request(source, pb.GetRequest.DESCRIPTOR, KNOWN), "GetRequest")
    requests.query_of(request)
    requests.wait_nanos_of(request)
    requests.group_of(request)


def subscribe(source: ByteSource) -> None:
    raw = drawn_request(source, pb.SubscribeRequest.DESCRIPTOR, KNOWN)
    opened = requests.opening_of(raw, pb.SubscribeRequest, "SubscribeRequest").open
    requests.is_newest(opened)
    begun = requests.beginning_of(opened)
    if "saved" in begun:
        read_back = requests.saved_of(requests.saved_to(begun["saved"]))
        assert read_back == begun["saved"], "a host understands the cursor that it gave to a reader"


def enqueue(source: ByteSource) -> None:
    raw = drawn_request(source, queue_pb.EnqueueRequest.DESCRIPTOR, KNOWN)
    for message in read_enqueues(raw).runs:
        run = enqueue_of(message, 1, 0.0)
        sealed = run.seal(1, range(len(run.lengths)), 5 if run.is_stamped else None)
        assert len(item_pb2.ItemRun.FromString(sealed).payload_length_bytes) == len(run.lengths)


def take(source: ByteSource) -> None:
    request = requests.parse(queue_pb.TakeRequest, drawn_request(source, queue_pb.TakeRequest.DESCRIPTOR, KNOWN), "")
    if request.HasField("open"):
        taker_of(request.open)
    settlements_of(request.settlements)


def pending(source: ByteSource) -> None:
    page_size_of(drawn_message(source, queue_pb.ListPendingRequest.DESCRIPTOR, KNOWN))  # type: ignore[arg-type]
    settlements_of([drawn_message(source, queue_pb2.Settlement.DESCRIPTOR, KNOWN)])  # type: ignore[list-item]


def group_definition(source: ByteSource) -> None:
    recorded_group(drawn_message(source, group_pb2.GroupRecord.DESCRIPTOR, KNOWN))  # type: ignore[arg-type]
    floor = drawn_message(source, group_pb2.CutFloor.DESCRIPTOR, KNOWN)
    floor_to_message(floor_from_message(floor))  # type: ignore[arg-type]
    times_from_message(drawn_message(source, group_pb2.ChannelTimes.DESCRIPTOR, KNOWN))  # type: ignore[arg-type]


REFUSED = (StampedeError,)


def stream_frames(source: ByteSource) -> None:
    """The reader finds the same frames wherever their bytes are cut, and loses no byte."""
    limits = {FrameKind.OPENING: 64, FrameKind.MESSAGE: 300, FrameKind.END: 0}
    stream = b"".join(
        frame_of(source.choice(tuple(limits)), source.take(source.below(40))) for _ in range(source.below(6))
    )
    stream += source.take(source.below(20))
    whole, found, reader = FrameReader(limits).feed(stream), [], FrameReader(limits)
    at = 0
    while at < len(stream):
        size = 1 + source.below(9)
        found += reader.feed(stream[at : at + size])
        at += size
    assert found == whole
    kept = reader.unfinished_bytes
    assert b"".join(frame_of(FrameKind(kind), body) for kind, body in found) == stream[: len(stream) - kept]


TARGETS = (
    Target("stream_frames", stream_frames, REFUSED),
    Target("item_run", item_run, REFUSED),
    Target("put_frames", put_frames, REFUSED),
    Target("get", get, REFUSED),
    Target("subscribe", subscribe, REFUSED),
    Target("enqueue", enqueue, REFUSED),
    Target("take", take, REFUSED),
    Target("pending", pending, REFUSED),
    Target("group_definition", group_definition, (*REFUSED, DecodeError)),
)
