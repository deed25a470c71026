"""The bodies of runs that refer to the object that a program put."""

from __future__ import annotations

from stampede_rt.wire.runs import encode_run, run_parts, seal_run
from stampede_rt_channel_host.core.channel import ReferencedBody


def test_a_body_built_of_views_has_the_bytes_of_an_encoded_run() -> None:
    payload, labels = b"payload" * 100, {"lens": "wide"}
    parts = run_parts((payload,), times=None, durations=(5,), content_type="image/raw", attributes=labels)
    body = ReferencedBody(parts, payload, labels, "image/raw").followed_by(seal_run(b"", 7, (1234,)))
    encoded = encode_run((payload,), times=None, durations=(5,), content_type="image/raw", attributes=labels)
    assert bytes(body) == seal_run(encoded, 7, (1234,))
    assert len(body) == len(bytes(body))
    assert body.payload is payload
